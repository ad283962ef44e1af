import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import json

from torch_geometric_tactile.nn.models import GraspGCN, GraspLSTM, TemporalTaxelNet
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.sensors import biotac
from torch_geometric_tactile.training import classifier_from_config
from torch_geometric_tactile.training._config import load_config
from torch_geometric_tactile.training._config_files import expand_template
from torch_geometric_tactile.training._sizes import DataSizes, fill_sizes

OURS = {"temporal", "temporal_weights", "temporal_threshold"}


def sizes(num_frames=60, channels=3, **changes):
    given = {"num_outputs": 2, "num_edges": 40, "num_joints": 0, "num_frames": num_frames}
    width = channels * (num_frames or 1)
    return DataSizes(biotac(), width, channels={"tactile": width}, **{**given, **changes})


@pytest.mark.parametrize(
    ("table", "template"), [("p3", "p3_table2"), ("p3-k", "p3_k"), ("p3-picks", "p3_picks")]
)
def test_each_experiment_of_the_template_has_one_place(table, template):
    cells = load_table(table).cells
    names = [cell.experiment for cell in cells if cell.estimator is None]
    assert sorted(names) == sorted(expand_template(template))
    assert len({(cell.row, cell.column) for cell in cells}) == len(cells)


def scaled_readings(transform):
    *selected, scale = transform["init_args"].get("transforms", [transform])
    assert scale == {
        "class_path": "torch_geometric_tactile.transforms.ZScore",
        "init_args": {"per": "signal"},
    }
    return [part["init_args"]["channels"] for part in selected]


@pytest.mark.parametrize("name", ["p3", "p3-k", "p3-picks"])
def test_tables_train_as_their_configurations(name):
    table = load_table(name)
    for cell in table.cells:
        if cell.estimator is not None:
            finger = {"left": [[0, 1, 2]], "right": [[3, 4, 5]]}.get(cell.column, [])
            assert scaled_readings(cell.transform) == (finger if name == "p3-picks" else [])
            continue
        config = cell.configuration
        dataset = config["data"]["dataset"]
        assert dataset["class_path"] == table.data.class_path
        for key in ("ragged", "pre_transform"):
            assert dataset["init_args"][key] == table.data.arguments[key]
        if cell.experiment in OURS:
            scheduler = config["model"]["lr_scheduler"]
            assert scheduler == {"class_path": "torch_geometric_tactile.training.CosineAnnealing"}
            continue
        optimizer = config["model"]["optimizer"]
        assert (optimizer["class_path"], optimizer["init_args"]["lr"]) == ("torch.optim.Adam", 1e-3)
        assert (config["trainer"]["max_epochs"], config["data"]["batch_size"]) == (100, 32)


def test_published_numbers_of_the_table():
    cells = {cell.experiment: cell.published for cell in load_table("p3").cells}
    assert cells["svm_f"] == {"accuracy": 85.50, "f1": 84.97}
    assert cells["lstm_m"] == {"accuracy": 84.68, "f1": 84.36}
    assert cells["gcn_df"] == {"accuracy": 90.33, "f1": 90.08}
    assert cells["gcn_ff"] == {"accuracy": 89.13, "f1": 88.79}
    assert sum(bool(published) for published in cells.values()) == 13
    assert load_table("p3").seeds == load_table("p3-k").seeds == 10


def test_paper_protocol_is_the_first():
    first, *_ = load_table("p3").protocols
    assert (first.protocol.by, first.protocol.val, first.protocol.test) == ("frame", 0.0, 0.2)


def test_columns_along_k_are_the_neighbours():
    table = load_table("p3-k")
    assert table.axis
    for cell in table.cells:
        graph, _ = cell.configuration["data"]["transform"]["init_args"]["transforms"]
        assert graph["init_args"]["k"] == int(cell.column)
        fusion = cell.configuration["model"]["model"]["init_args"]["fusion"]
        assert fusion == {"GCN-DF": "data", "GCN-FF": "feature"}[cell.row]


@pytest.mark.parametrize("name", list(expand_template("p3_table2")))
def test_sizes_are_those_of_the_window(name):
    num_joints = 12 if name.endswith(("joint", "wrench")) else 0
    config = load_config(f"p3_table2/{name}")["model"]
    model = classifier_from_config(fill_sizes(config, sizes(num_joints=num_joints))).model
    assert getattr(model, "num_joints", 0) == num_joints
    if name.startswith("gcn"):
        assert isinstance(model, GraspGCN)
        assert (model.in_channels, model.num_fingers, model.hidden_channels) == (60, 3, 64)
        finger = "lmr".find(name[-1]) if len(name) == 5 else None
        assert model.finger == finger
    elif name.startswith("lstm"):
        assert isinstance(model, GraspLSTM)
        assert (model.num_fingers, model.hidden_channels) == (3, 128)
    else:
        assert isinstance(model, TemporalTaxelNet)
        assert (model.in_channels, model.num_nodes) == (3, 19)


@pytest.mark.parametrize("name", list(expand_template("p3_picks")))
def test_models_of_picks_take_two_fingers_with_three_axes(name):
    config = load_config(f"p3_picks/{name}")
    model = classifier_from_config(fill_sizes(config["model"], sizes(channels=6))).model
    if name in ("gcn_l", "gcn_r", "gcn_ff"):
        assert (model.in_channels, model.num_fingers) == (180, 2)
        assert (model.fusion, model.finger) == {
            "gcn_l": (None, 0), "gcn_r": (None, 1), "gcn_ff": ("feature", None)
        }[name]  # fmt: skip
    elif name.startswith("gcn"):
        assert (model.in_channels, model.num_fingers, model.fusion) == (60, 6, "data")
    elif name.startswith("lstm"):
        finger = {"l": [[0, 1, 2]], "r": [[3, 4, 5]], "f": []}[name[-1]]
        assert scaled_readings(config["data"]["transform"]) == finger
        assert model.num_fingers == (3 if finger else 6)
    else:
        assert (model.in_channels, model.num_nodes) == (6, 19)


def test_fingers_are_never_guessed_from_sizes_that_agree():
    config = {"model": {"class_path": "GraspGCN"}}
    of_one = fill_sizes(config, sizes(channels=1))["model"]["init_args"]  # 60 is 3 x 20, too
    assert (of_one["num_fingers"], of_one["in_channels"]) == (1, 60)
    config = {"model": {"class_path": "GraspGCN", "init_args": {"num_fingers": 3}}}
    match = r"'num_fingers' of GraspGCN must be 1, as in the data \(got 3\)"
    with pytest.raises(ValueError, match=match):
        fill_sizes(config, sizes(channels=1))
    two = {"model": {"class_path": "GraspGCN", "init_args": {"num_fingers": 2}}}
    of_two = fill_sizes(two, sizes(channels=6))["model"]["init_args"]  # three axes each
    assert (of_two["num_fingers"], of_two["in_channels"]) == (2, 180)
    single = fill_sizes(config, sizes(num_frames=None))["model"]["init_args"]
    assert (single["num_fingers"], single["in_channels"]) == (3, 1)


def test_channels_of_a_frame_are_never_those_of_a_window():
    config = {"model": {"class_path": "TemporalTaxelNet"}}
    assert fill_sizes(config, sizes())["model"]["init_args"]["in_channels"] == 3
    config["model"]["init_args"] = {"in_channels": 180}
    with pytest.raises(ValueError, match=r"'in_channels' of TemporalTaxelNet must be 3.*got 180"):
        fill_sizes(config, sizes())


def test_templates_type_no_size():
    for template in ("p3_table2", "p3_k"):  # p3_picks says how many channels make a finger
        assert "num_fingers" not in json.dumps(expand_template(template))
