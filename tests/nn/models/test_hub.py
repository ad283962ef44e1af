import copy
import json

import pytest
import torch
from torch_geometric.nn import Linear, model_hub
from torch_geometric.nn.model_hub import PyGModelHubMixin

from torch_geometric_tactile.nn.conv import EdgePatchEncoder
from torch_geometric_tactile.nn.models import (
    MTCNN,
    MTGCN,
    GraspGCN,
    HandCNN,
    TactileFNN,
    TactileGCN,
)
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(2, 3, pitch=0.004)
EDGE_INDEX = LAYOUT.edge_index("original")
SMALL = {"head_widths": (6,), "head_pools": (2,)}
NARROW = {"widths": [4, 8], "pools": [1, 2]}
MODELS = {
    "gcn": lambda: TactileGCN(
        6, 3, inputs=["tactile", "edge"], num_edges=14, num_joints=2, **NARROW, **SMALL
    ),
    # The keys are not in alphabetical order, which a sorted file would lose.
    "mtgcn": lambda: MTGCN(
        6,
        3,
        inputs=["tactile", "edge", "absolute"],
        threads={"tactile": NARROW, "edge": {"adjacency": EDGE_INDEX, **NARROW}, "absolute": None},
        encoder="message",
        **SMALL,
    ),
    "named_adjacency": lambda: MTGCN(
        LAYOUT, inputs=["tactile"], threads={"tactile": {"adjacency": "dense"}}, **SMALL
    ),
    "segmented": lambda: TactileGCN(LAYOUT, segments="patch", channels={"tactile": 1}, **SMALL),
    "fnn": lambda: TactileFNN(6, inputs=("position",), widths=(8,), pools=(2,)),
    "cnn": lambda: HandCNN(LAYOUT, **NARROW, **SMALL),
    "mtcnn": lambda: MTCNN(LAYOUT, threads={"tactile": NARROW, "absolute": {}}, **SMALL),
    "grasp": lambda: GraspGCN(6, hidden_channels=4, fusion=None, finger=2, dropout=0.5),
}


def output(model):
    draw = torch.Generator().manual_seed(0)
    x = torch.randn(2, 6, getattr(model, "channels", {"tactile": 3})["tactile"], generator=draw)
    sizes = {"edge_attr": (2, 14, 4), "joint": (2, 2), "absolute": (2, 6, 4), "pos": (2, 6, 3)}
    others = {name: torch.randn(size, generator=draw) for name, size in sizes.items()}
    return model(x, EDGE_INDEX, **{name: others[name] for name in getattr(model, "modalities", ())})


@pytest.fixture
def hub():
    return pytest.importorskip("huggingface_hub")


@pytest.mark.parametrize("name", MODELS)
def test_hub_round_trip(name, hub, tmp_path):
    model = MODELS[name]().eval()
    assert isinstance(model, PyGModelHubMixin)
    assert model.save_pretrained(tmp_path / "model") is None
    again = type(model).from_pretrained(tmp_path / "model")
    assert type(again) is type(model)
    assert not again.training
    assert str(again) == str(model)
    assert torch.equal(output(again), output(model))
    again.save_pretrained(tmp_path / "again")
    first, second = (
        json.loads((tmp_path / x / "config.json").read_text()) for x in ("model", "again")
    )
    assert first == second


def test_hub_files(hub, tmp_path):
    MODELS["mtgcn"]().save_pretrained(str(tmp_path))
    assert {path.name for path in tmp_path.iterdir()} == {"README.md", "config.json", "model.pth"}
    config = json.loads((tmp_path / "config.json").read_text())
    assert config == {
        "layout": 6,
        "out_channels": 3,
        "inputs": ["tactile", "edge", "absolute"],
        "threads": {
            "tactile": NARROW,
            "edge": {"adjacency": EDGE_INDEX.tolist(), **NARROW},
            "absolute": None,
        },
        "num_edges": None,
        "num_joints": 0,
        "head_widths": [6],
        "head_pools": [2],
        "encoder": "message",
        "channels": None,
        "fast": True,
    }
    assert list(config["threads"]) == ["tactile", "edge", "absolute"]
    weights = torch.load(tmp_path / "model.pth", weights_only=True)
    assert weights.keys() == MODELS["mtgcn"]().state_dict().keys()
    assert "MTGCN.from_pretrained" in (tmp_path / "README.md").read_text()


def test_hub_layout(hub, tmp_path):
    TactileGCN(LAYOUT, segments="patch").save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["layout"] == LAYOUT.to_dict()


def test_hub_arguments_on_loading(hub, tmp_path):
    model = GraspGCN(6, hidden_channels=4)
    model.save_pretrained(tmp_path)
    again = GraspGCN.from_pretrained(tmp_path, dropout=0.25, map_location="cpu")
    assert again.dropout.p == 0.25
    with pytest.raises(ValueError, match=r"is no GraspGCN that can be read: .*size mismatch"):
        GraspGCN.from_pretrained(tmp_path, hidden_channels=5)


def test_hub_strict(hub, tmp_path):
    model = GraspGCN(6, hidden_channels=4)
    model.save_pretrained(tmp_path)
    torch.save({"lin.bias": torch.zeros(2)}, tmp_path / "model.pth")
    with pytest.raises(ValueError, match="Missing key"):
        GraspGCN.from_pretrained(tmp_path)


@pytest.mark.parametrize(
    "text", ["{", '{"in_channels": [1]}', '{"in_channels": 1e999}', "[" * 100000, "[]", "3"]
)
def test_hub_damaged_configuration(hub, tmp_path, text):
    GraspGCN(6, hidden_channels=4).save_pretrained(tmp_path)
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(ValueError, match=f"'{tmp_path}' is no GraspGCN that can be read"):
        GraspGCN.from_pretrained(tmp_path)


def test_hub_configuration_that_names_a_missing_file(hub, tmp_path):
    TactileGCN(LAYOUT, segments="patch").save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**config, "layout": "gone/away.json"}))
    with pytest.raises(ValueError, match=rf"'{tmp_path}' is no TactileGCN .*gone/away\.json"):
        TactileGCN.from_pretrained(tmp_path)


def test_hub_size_beyond_the_weights_takes_no_memory(hub, tmp_path):
    GraspGCN(6, hidden_channels=4).save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**config, "out_channels": 10**7}))
    with pytest.raises(ValueError, match="the model must not be larger than its weights in the"):
        GraspGCN.from_pretrained(tmp_path)


def test_hub_loads_weights_only(hub, tmp_path):
    GraspGCN(6, hidden_channels=4).save_pretrained(tmp_path)
    torch.save({"lin": Linear(1, 1)}, tmp_path / "model.pth")
    with pytest.raises(ValueError, match=r"model\.pth' must hold plain data and tensors only"):
        GraspGCN.from_pretrained(tmp_path)


def test_hub_module_must_be_given_again(hub, tmp_path):
    encoder = EdgePatchEncoder([0, 0, 0, 1, 1, 1])
    model = TactileGCN(6, 3, inputs=("tactile", "edge"), encoder=encoder, **NARROW, **SMALL).eval()
    model.save_pretrained(tmp_path)
    with pytest.raises(ValueError, match=r"'encoder' must be .* \(got .*EdgePatchEncoder"):
        TactileGCN.from_pretrained(tmp_path)
    again = TactileGCN.from_pretrained(tmp_path, encoder=EdgePatchEncoder([0, 0, 0, 1, 1, 1]))
    assert torch.equal(output(again), output(model))


def test_hub_keeps_subclasses(hub, tmp_path):
    class Wide(TactileGCN):
        def __init__(self, *args, scale=2, **kwargs):
            super().__init__(*args, **kwargs)
            self.scale = scale

    model = Wide(layout=6, scale=3, **NARROW, **SMALL)
    model.save_pretrained(tmp_path)
    again = Wide.from_pretrained(tmp_path)
    assert (again.scale, again.num_nodes, again.thread.widths) == (3, 6, (4, 8))


def test_hub_copies_keep_arguments(hub, tmp_path):
    model = copy.deepcopy(MODELS["gcn"]()).eval()
    model.save_pretrained(tmp_path)
    assert torch.equal(output(TactileGCN.from_pretrained(tmp_path)), output(model))


def test_hub_bad_argument(hub, tmp_path):
    model = TactileFNN(6, widths=(8,), pools=(2,), channels={"tactile": torch.Size([3])[0]})
    model._hub_arguments["channels"] = {"tactile": {3}}
    with pytest.raises(ValueError, match=r"'channels' must be plain values, .* \(got set\)"):
        model.save_pretrained(tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_hub_empty_folder(hub, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"model\.pth' is missing: write it with"):
        TactileGCN.from_pretrained(tmp_path)


def test_hub_missing(monkeypatch, tmp_path):
    monkeypatch.setattr(model_hub, "hf_hub_download", None)
    for call in (GraspGCN(6, hidden_channels=4).save_pretrained, GraspGCN.from_pretrained):
        with pytest.raises(ImportError, match=r'pip install "torch-geometric-tactile\[hub\]"'):
            call(tmp_path)


def test_hub_folder_of_an_older_version(hub, tmp_path):
    # `huggingface_hub` itself would leave out what it does not know, and make another model.
    MODELS["gcn"]().save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    config["num_nodes"] = config.pop("layout")
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(ValueError, match=r"TactileGCN has no argument 'num_nodes', only \[.*older"):
        TactileGCN.from_pretrained(tmp_path)
    MODELS["gcn"]().save_pretrained(tmp_path)
    with pytest.raises(ValueError, match=r"TactileGCN has no argument 'depth', only \["):
        TactileGCN.from_pretrained(tmp_path, depth=3)


def test_hub_unknown_argument_of_a_subclass(hub, tmp_path):
    class Wide(TactileGCN):
        def __init__(self, *args, scale=2, **kwargs):
            super().__init__(*args, **kwargs)

    Wide(layout=6, **NARROW, **SMALL).save_pretrained(tmp_path)
    with pytest.raises(ValueError, match=r"Wide has no argument 'num_nodes', only \[.*'scale'"):
        Wide.from_pretrained(tmp_path, num_nodes=6)


def test_hub_layout_file(hub, tmp_path):
    # The file is of this machine only: its contents are saved.
    for path in (tmp_path / "own.json", str(tmp_path / "own.json")):
        LAYOUT.save(path)
        model = TactileGCN(path, segments="patch", **SMALL).eval()
        (tmp_path / "own.json").unlink()
        model.save_pretrained(tmp_path / "model")
        again = TactileGCN.from_pretrained(tmp_path / "model")
        assert torch.equal(output(again), output(model))


def test_hub_layout_name(hub, tmp_path):
    TactileGCN("biotac_sp", **SMALL).save_pretrained(tmp_path)
    assert json.loads((tmp_path / "config.json").read_text())["layout"] == "biotac_sp"


def test_weights_of_a_folder_stay_when_writing_new_ones_fails(tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub")
    GraspGCN().save_pretrained(tmp_path)
    before = (tmp_path / "model.pth").read_bytes()

    def full(content, file):
        file.write(b"half")
        raise OSError("full")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(OSError, match="full"):
        GraspGCN().save_pretrained(tmp_path)
    assert (tmp_path / "model.pth").read_bytes() == before
    assert not list(tmp_path.glob(".*"))
