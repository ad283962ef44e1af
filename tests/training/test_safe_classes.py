r"""A checkpoint, or a configuration beside one, runs nothing and builds only what it may."""

import contextlib
import copy
import inspect
import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
import yaml

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.nn.models import GraspGCN
from torch_geometric_tactile.reports.run_data import load_data, open_predictor
from torch_geometric_tactile.training import AtomicCheckpointIO, TactileModule, safe_classes
from torch_geometric_tactile.training.safe_classes import DENIED, PACKAGES, safe_section

LINEAR = {"class_path": "torch.nn.Linear", "init_args": {"in_features": 2, "out_features": 2}}
FAKE = {
    "class_path": "torch_geometric_tactile.datasets.FakeTactileDataset",
    "init_args": {
        "num_samples": 40,
        "pre_transform": {
            "class_path": "torch_geometric_tactile.transforms.KNNGraph",
            "init_args": {"k": 2},
        },
    },
}
CONFIG = {
    "model": {"model": {"class_path": "torch_geometric_tactile.nn.models.GraspGCN"}},
    "data": {"dataset": FAKE, "test": 0.25, "split": "frame"},
    "trainer": {
        "max_epochs": 1,
        "accelerator": "cpu",
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "logger": False,
    },
}


class OwnNet(torch.nn.Module):
    def __init__(self, width: int = 3):
        super().__init__()
        self.width = width


def payload(mark):
    return {
        "class_path": "torch.fx.graph_module.reduce_graph_module",
        "init_args": {
            "body": {"_code": "pass", "__dict__": {}},
            "import_block": f"import pathlib\npathlib.Path({str(mark)!r}).touch()\n",
        },
    }


def hidden(mark):
    """The payload in each place and form in which a parser may find it."""
    call = payload(mark)
    text = str(call).replace("'", '"')
    nested = copy.deepcopy(LINEAR)
    nested["init_args"]["bias"] = call
    listed = copy.deepcopy(LINEAR)
    listed["init_args"]["bias"] = [{"a": [call]}]
    unknown = {**LINEAR, "dict_kwargs": {"bias": call}}
    return {
        "model": {"model": call},
        "nested": {"model": nested},
        "list": {"model": listed},
        "dict_kwargs": {"model": unknown},
        "optimizer": {"model": LINEAR, "optimizer": call},
        "scheduler": {"model": LINEAR, "lr_scheduler": call},
        "other": {"model": LINEAR, "class_weights": call},
        "text": {"model": text},
        "optimizer text": {"model": LINEAR, "optimizer": text},
        "nested text": {"model": {"class_path": "torch.nn.Linear", "init_args": {"bias": text}}},
        "escaped text": {
            "model": {
                "class_path": "torch.nn.Linear",
                "init_args": {"bias": text.replace("class_path", "class\\u005fpath")},
            }
        },
        "dotted key": {"model": LINEAR, "optimizer.class_path": call["class_path"]},
        "dotted key inside": {"model": {**LINEAR, "init_args.bias.class_path": "os.getcwd"}},
        "added key": {"model": LINEAR, "lr_scheduler+": call},
        "class": {"_class_path": call["class_path"], **call["init_args"]},
        "instantiator": {"model": LINEAR, "_instantiator": call["class_path"]},
    }


@pytest.fixture
def checkpoint(tmp_path):
    """Writes a checkpoint of a linear layer with other arguments."""

    def write(settings):
        state = {"model.weight": torch.zeros(2, 2), "model.bias": torch.zeros(2)}
        settings = {"_instantiator": "lightning.pytorch.cli.instantiate_module", **settings}
        content = {
            "pytorch-lightning_version": L.__version__,
            "state_dict": state,
            "hyper_parameters": settings,
            "epoch": 0,
            "global_step": 0,
        }
        torch.save(content, tmp_path / "some.ckpt")
        return tmp_path / "some.ckpt"

    return write


def test_size_beyond_the_weights_takes_no_memory(checkpoint):
    large = {
        "class_path": "torch.nn.Linear",
        "init_args": {"in_features": 2, "out_features": 10**9},
    }
    path = checkpoint({"model": large})
    with pytest.raises(ValueError, match="the model must not be larger than its weights in the"):
        TactileModule.load_from_checkpoint(path)


def test_what_the_attack_does(tmp_path):
    reduce = sys.modules["torch.fx.graph_module"].reduce_graph_module
    arguments = payload(tmp_path / "mark")["init_args"]
    with contextlib.suppress(Exception):
        reduce(**arguments)
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize("place", hidden(""))
def test_checkpoint_runs_nothing(checkpoint, tmp_path, place):
    path = checkpoint(hidden(tmp_path / "mark")[place])
    with pytest.raises(ValueError, match=r"some\.ckpt' cannot be used: '[\w.\[\]]*' (must|names)"):
        TactileModule.load_from_checkpoint(path)
    assert not (tmp_path / "mark").exists()


def test_plain_checkpoint_is_loaded(checkpoint):
    settings = {
        "model": LINEAR,
        "optimizer": "Adam",
        "lr_scheduler": {
            "class_path": "lightning.pytorch.cli.ReduceLROnPlateau",
            "init_args": {"monitor": "a"},
        },
    }
    module = TactileModule.load_from_checkpoint(checkpoint(settings))
    assert isinstance(module.model, torch.nn.Linear)
    assert module.model.weight.eq(0).all()
    (optimizer,) = (module.optimizer(module.parameters()),)
    assert isinstance(optimizer, torch.optim.Adam)
    assert module.lr_scheduler(optimizer).monitor == "a"


def test_checkpoint_without_arguments_is_loaded_with_a_model(checkpoint):
    settings = {"model": payload("mark"), "task": "multilabel"}
    model = torch.nn.Linear(2, 2)
    module = TactileModule.load_from_checkpoint(checkpoint(settings), model=model)
    assert (type(module.model), module.task) == (torch.nn.Linear, "multilabel")


@pytest.mark.parametrize("option", [{"weights_only": False}, {"hparams_file": "a.yaml"}])
def test_options_that_run_code_are_refused(checkpoint, option):
    with pytest.raises(ValueError, match="must be left out, since it may run code"):
        TactileModule.load_from_checkpoint(checkpoint({"model": LINEAR}), **option)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("os.system", r"names 'os\.system'"),
        ("torch.fx.GraphModule", r"names 'torch\.fx\.GraphModule'"),
        ("torch.nn.functional.relu", "must name a class, not a function"),
        ("torch.nn.modules.module.torch", r"names 'torch\.nn\.modules\.module\.torch'"),
        ("torch_geometric_tactile.files.os", r"names 'torch_geometric_tactile\.files\.os'"),
        ("torch_geometric_tactile.files.os.system", "must be a class"),
        ("torch_geometric_tactile.files.zipfile.ZipFile", "must be a class"),
        ("torch_geometric_tactile.files.Path", r"names 'pathlib(\._local)?\.Path'"),
        ("torch_geometric_tactile.__main__.main", "must be an import path"),
        ("torch_geometric_tactile..files.os", "must be an import path"),
        ("torch_geometric.nn.Sequential", r"names 'torch_geometric\.nn\.sequential\.Sequential'"),
        ("torch.nn.quantized.Linear", r"names 'torch\.ao\."),
        ("torch.nn.parallel.DataParallel", r"names 'torch\.nn\.parallel\.DataParallel'"),
        ("torch.optim.Adam", r"must be a Module \(got 'torch\.optim\.Adam'\)"),
        ("torch_geometric_tactile.sensors.TaxelLayout", "must be a Module"),
        ("lightning.pytorch.cli.ReduceLROnPlateau", "must be a Module"),
        ("Nothing", "names 'Nothing'"),
        (3, r"'model\.model\.class_path' must be a text \(got int\)"),
    ],
)
def test_classes_that_a_file_may_not_name(path, message):
    before = set(sys.modules)
    with pytest.raises(ValueError, match=f"'a.ckpt' cannot be used: .*{message}"):
        safe_section("model", {"model": {"class_path": path}}, "a.ckpt")
    with pytest.raises(ValueError, match=r"'a\.ckpt' cannot be used"):
        safe_section("model", {"model": path}, "a.ckpt")
    new = {name for name in set(sys.modules) - before if not name.startswith((*PACKAGES, "torch."))}
    assert not new


def test_nothing_is_imported_to_check_a_name(tmp_path, monkeypatch):
    (tmp_path / "own_effects.py").write_text("from pathlib import Path; Path('mark').touch()")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for value in ("own_effects.Net", [{"class_path": "own_effects.Net"}], {"a": "own_effects.b"}):
        settings = {"model": {**LINEAR, "init_args": {"bias": value}}}
        with pytest.raises(ValueError, match=r"names 'own_effects\.\w+'.* --allow own_effects"):
            safe_section("model", settings, "a.ckpt")
    assert not (tmp_path / "mark").exists()
    assert "own_effects" not in sys.modules


def test_names_get_their_full_paths():
    settings = {
        "model": {
            "class_path": "TactileGCN",
            "init_args": {"act": {"class_path": "ReLU"}, "b": None},
        },
        "optimizer": {"class_path": "torch.optim.SGD", "init_args": {"lr": 0.1}},
        "lr_scheduler": "StepLR",
        "num_classes": 3,
    }
    found = safe_section("model", settings, "a.ckpt")
    gcn = "torch_geometric_tactile.nn.models.tactile_gcn.TactileGCN"
    relu = "torch.nn.modules.activation.ReLU"
    assert found == {
        "model": {"class_path": gcn, "init_args": {"act": {"class_path": relu}, "b": None}},
        "optimizer": {"class_path": "torch.optim.sgd.SGD", "init_args": {"lr": 0.1}},
        "lr_scheduler": {"class_path": "torch.optim.lr_scheduler.StepLR"},
        "num_classes": 3,
    }
    assert safe_section("model", found, "a.ckpt") == found


def test_texts_that_mean_nothing_else_are_kept(tmp_path):
    (tmp_path / "pad.json").write_text("{}")
    texts = ["relu", "mean", "biotac_sp", "a b: c", "torch.float64", "v1.2", "torch.nn.ReLU", ""]
    values = {"a": texts, "b": (1, 2.5, True), "layout": str(tmp_path / "pad.json")}
    found = safe_section("model", {"model": {**LINEAR, "init_args": values}}, "a.ckpt")
    assert found["model"]["init_args"] == {**values, "b": [1, 2.5, True]}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("http://127.0.0.1/a.yaml", "must be no file or address"),
        ("zip::a.yaml", "must be no file or address"),
        (__file__, "must be no file or address"),
        ("/dev/null", "must be no file or address"),
        ("os.system", r"names 'os\.system'"),
        ("subprocess.run", r"names 'subprocess\.run'"),
        ("torch.load", r"names 'torch\.load'"),
        ("torch.nn.functional.relu", "must name a class, not a function"),
        ("OwnNet", r"names '[\w.]*OwnNet'"),
        ({1: {"class_path": "os.system"}}, r"names 'os\.system'"),
        ({"class_path": ["os.system"]}, "must be a text"),
        ({"class_path": "torch.nn.ReLU", "init_args": [1]}, "must be a mapping"),
        ({"class_path": "torch.nn.ReLU", "call": 1}, "must have the keys"),
        ({(1, 2): 3}, "must have names as keys"),
        ({1}, r"must be plain data \(got set\)"),
    ],
)
def test_values_that_a_file_may_not_hold(value, message):
    settings = {"model": {"class_path": "torch.nn.Linear", "init_args": {"a": value}}}
    with pytest.raises(
        ValueError, match=rf"'a\.ckpt' cannot be used: 'model\.model\.a.*' {message}"
    ):
        safe_section("model", settings, "a.ckpt")


def test_settings_without_end_are_refused():
    endless = []
    endless.append(endless)
    many = [0] * 400
    for _ in range(3):
        many = [many] * 400
    for value in (endless, many):
        with pytest.raises(ValueError, match=r"must hold at most 100000 values, nested 50 deep"):
            safe_section("model", {"model": LINEAR, "class_weights": value}, "a.ckpt")
    for settings in (3, [LINEAR], None):
        with pytest.raises(ValueError, match=r"'model' must be a mapping"):
            safe_section("model", settings, "a.ckpt")
    with pytest.raises(ValueError, match=r"'model\.model' must have a 'class_path'"):
        safe_section("model", {"model": {"in_features": 1}}, "a.ckpt")


def test_limits_of_settings(monkeypatch):
    monkeypatch.setattr(safe_classes, "_MAX_VALUES", 7)
    safe_section("model", {"task": "multiclass", "other": [1, 2, [3, 4]]}, "a.ckpt")  # seven
    with pytest.raises(ValueError, match=r"'model.other\[3\]' must hold at most 7 values"):
        safe_section("model", {"task": "multiclass", "other": [1, 2, [3, 4], 5]}, "a.ckpt")
    monkeypatch.setattr(safe_classes, "_MAX_DEPTH", 2)
    safe_section("model", {"other": [[1]]}, "a.ckpt")
    with pytest.raises(ValueError, match=r"must hold at most 7 values, nested 2 deep"):
        safe_section("model", {"other": [[[1]]]}, "a.ckpt")


def test_own_classes_are_allowed_by_name(tmp_path):
    settings = {"model": {"class_path": f"{__name__}.OwnNet"}}
    for allow in ([__name__], [f"{__name__}.OwnNet"]):
        found = safe_section("model", settings, "a.ckpt", allow)
        assert found == settings
    for allow in (["os"], [__name__[:-1]]):
        with pytest.raises(ValueError, match=rf"allow=\['{__name__}\.OwnNet'\] in Python"):
            safe_section("model", settings, "a.ckpt", allow)
    with pytest.raises(ValueError, match="must name a class, not a function"):
        safe_section("model", {"model": f"{__name__}.payload"}, "a.ckpt", [__name__])
    # What she allows is not what her module has from elsewhere.
    with pytest.raises(ValueError, match=r"names 'pathlib"):
        safe_section("model", {"model": f"{__name__}.Path"}, "a.ckpt", [__name__])
    with pytest.raises(ValueError, match="'allow' must be a list of packages"):
        safe_section("model", settings, "a.ckpt", __name__)


SUSPICIOUS = re.compile(
    r"\beval_type\(|(?<![.\w])(?<!def )(eval|exec|open)\(|import_module\(|__import__\(|"
    r"torch\.load\(|\bsubprocess\b|os\.system|pickle\.load|\bhub\.load"
)
# Looked at by hand: none does so in a constructor, or by a text that it is given.
REVIEWED = {
    "torch.nn.functional",
    "torch.optim.optimizer",
    "torch_geometric.nn.conv.utils.cheatsheet",
    "torch_geometric.nn.models.dimenet",
    "torch_geometric.nn.models.gpse",
    "torch_geometric.nn.models.schnet",
}


@pytest.mark.parametrize("package", [p for p in PACKAGES if p != "torch_geometric_tactile"])
def test_allowed_packages_evaluate_no_text(package):
    (folder,) = find_spec(package).submodule_search_locations
    found = set()
    for path in Path(folder).rglob("*.py"):
        relative = path.relative_to(folder).with_suffix("").parts
        name = ".".join([package, *(part for part in relative if part != "__init__")])
        denied = any(name == entry or name.startswith(f"{entry}.") for entry in DENIED)
        if not denied and SUSPICIOUS.search(path.read_text(encoding="utf-8")):
            found.add(name)
    assert found <= REVIEWED


def test_sequential_of_pyg_would_evaluate_a_text(tmp_path):
    from torch_geometric.nn import Sequential

    code = f"x: __import__('pathlib').Path({str(tmp_path / 'mark')!r}).touch()"
    if "eval_type" in inspect.getsource(sys.modules[Sequential.__module__]):
        with contextlib.suppress(Exception):
            Sequential(code, [(torch.nn.ReLU(), "x -> x")])
        assert (tmp_path / "mark").exists()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A short run of 'tactile fit' with its configuration."""
    folder = tmp_path_factory.mktemp("run")
    config = {**CONFIG, "trainer": {**CONFIG["trainer"], "logger": True}}
    config["trainer"]["default_root_dir"] = str(folder)
    (folder / "my.yaml").write_text(yaml.safe_dump(config))
    assert main(["fit", "--config", str(folder / "my.yaml")]) == 0
    (last,) = folder.rglob("last.ckpt")
    return last


def attacked(run, folder, settings):
    """A copy of the run whose model is not built by name, with another configuration."""
    content = torch.load(run, weights_only=True)
    content["predictor"]["header"]["model"] = {"own": "OwnNet", "text": "OwnNet()"}
    path = folder / "checkpoints" / "last.ckpt"
    path.parent.mkdir()
    torch.save(content, path)
    (folder / "config.yaml").write_text(yaml.safe_dump(settings))
    return path


def test_configuration_beside_a_checkpoint_runs_nothing(run, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    mark = tmp_path / "mark"
    for i, (name, section) in enumerate([("dataset", "data"), ("model", "model")]):
        folder = tmp_path / str(i)
        folder.mkdir()
        settings = copy.deepcopy(CONFIG)
        settings[section][name] = payload(mark)
        path = attacked(run, folder, settings)
        for verb in (
            ["predict", path, "--out", tmp_path / "a.csv"],
            ["analyze", path, "--out", tmp_path],
        ):
            assert main([str(word) for word in verb]) == 1
            said = capsys.readouterr().err
            assert f"config.yaml' cannot be used: '{section}.{name}' names 'torch.fx" in said
            assert "--allow torch.fx.graph_module.reduce_graph_module" in said
        with pytest.raises(ValueError, match=r"config\.yaml' cannot be used"):
            open_predictor(path)
    assert not mark.exists()
    with pytest.raises(ValueError, match=r"config\.yaml' cannot be used"):
        load_data(tmp_path / "0" / "checkpoints" / "last.ckpt")
    assert not mark.exists()


def test_configuration_beside_a_checkpoint_is_used(run):
    assert len(load_data(run).dataset) == 40


def test_own_model_beside_a_checkpoint_is_allowed_by_name(run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "my_nets.py").write_text(
        "from torch_geometric_tactile.nn.models import GraspGCN\nclass OwnNet(GraspGCN): pass"
    )
    settings = copy.deepcopy(CONFIG)
    settings["model"]["model"] = {"class_path": "my_nets.OwnNet"}
    path = attacked(run, tmp_path, settings)
    assert main(["predict", str(path)]) == 1
    assert "'model.model' names 'my_nets.OwnNet'" in capsys.readouterr().err
    assert main(["predict", str(path), "--allow", "my_nets"]) == 0
    # A configuration that is given is one's own.
    assert main(["predict", str(path), "--config", "config.yaml"]) == 0


def test_fit_test_and_validate_build_nothing_of_a_checkpoint(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = torch.load(run, weights_only=True)
    config = run.parent.parent / "config.yaml"
    places = hidden(tmp_path / "mark")
    for i, settings in enumerate(places[name] for name in ("model", "optimizer", "list")):
        content["hyper_parameters"] = {**content["hyper_parameters"], **settings}
        path = tmp_path / f"{i}.ckpt"
        torch.save(content, path)
        verb = ("test", "validate", "fit")[i % 3]
        main([verb, "--config", str(config), "--ckpt_path", str(path)])
        assert not (tmp_path / "mark").exists()


def test_other_model_in_the_checkpoint_is_an_error(run, tmp_path, monkeypatch, capsys, caplog):
    monkeypatch.chdir(tmp_path)
    config = yaml.safe_load((run.parent.parent / "config.yaml").read_text())
    config["model"]["optimizer"]["init_args"]["lr"] = 0.25
    config["trainer"]["logger"] = False
    Path("a.yaml").write_text(yaml.safe_dump(config))
    assert main(["test", "--config", "a.yaml", "--ckpt_path", str(run)]) == 0
    assert "taken from the configuration, not" in caplog.text
    assert "'model.optimizer.init_args.lr' is 0.25, in the checkpoint 0.001" in caplog.text
    config["model"]["model"]["init_args"]["hidden_channels"] = 5
    Path("a.yaml").write_text(yaml.safe_dump(config))
    capsys.readouterr()
    assert main(["test", "--config", "a.yaml", "--ckpt_path", str(run)]) == 1
    said = capsys.readouterr().err
    assert "last.ckpt' must be of the model of the configuration" in said
    assert "'model.model.init_args.hidden_channels' is 5, in the checkpoint " in said


class Touch:
    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (Path(self.mark),)


def test_trainer_reads_checkpoints_as_plain_data(checkpoint, tmp_path):
    path = checkpoint({"model": LINEAR})
    content = torch.load(path, weights_only=True)
    torch.save({**content, "more": Touch(tmp_path / "mark")}, path)
    with pytest.raises(ValueError, match=r"some\.ckpt' must hold plain data and tensors only"):
        AtomicCheckpointIO().load_checkpoint(path)
    with pytest.raises(ValueError, match=r"some\.ckpt' must hold plain data and tensors only"):
        TactileModule.load_from_checkpoint(path, model=GraspGCN())
    assert not (tmp_path / "mark").exists()
    AtomicCheckpointIO().load_checkpoint(path, weights_only=False)
    assert (tmp_path / "mark").exists()
