r"""A checkpoint, or a configuration beside one, runs nothing."""

import contextlib
import copy
import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
import yaml
from fake_configs import fake_config
from hostile_pickle import Touch
from hostile_settings import hidden, payload, small_checkpoint

from torch_geometric_tactile import datasets, training
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Trials, Windows
from torch_geometric_tactile.nn.models import GraspGCN, TactileFNN
from torch_geometric_tactile.reports import _run_data as run_data
from torch_geometric_tactile.reports._run_data import load_data
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.training._checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training._config import config_names, load_config
from torch_geometric_tactile.training._config_files import TEMPLATES, expand_template

CONFIG = fake_config("GraspGCN", 40, test=0.25, split="frame")


@pytest.fixture
def checkpoint(tmp_path):
    """Writes a checkpoint of a small module with other contents."""

    def write(**change):
        torch.save({**small_checkpoint(), **change}, tmp_path / "some.ckpt")
        return tmp_path / "some.ckpt"

    return write


def test_size_beyond_the_weights_takes_no_memory(checkpoint):
    entry = small_checkpoint()["module"]
    entry["description"]["arguments"]["widths"] = [10**8]
    with pytest.raises(ValueError, match="the model must not be larger than its weights in the"):
        TactileModule.load_from_checkpoint(checkpoint(module=entry))


def test_what_the_attack_does(tmp_path):
    reduce = sys.modules["torch.fx.graph_module"].reduce_graph_module
    arguments = payload(tmp_path / "mark")["init_args"]
    with contextlib.suppress(Exception):
        reduce(**arguments)
    assert (tmp_path / "mark").exists()


@pytest.mark.full
@pytest.mark.parametrize("place", hidden(""))
def test_import_paths_in_a_checkpoint_mean_nothing(checkpoint, tmp_path, place):
    settings = hidden(tmp_path / "mark")[place]
    settings = {"_instantiator": "lightning.pytorch.cli.instantiate_module", **settings}
    more = {"hyper_parameters": settings, "hparams_name": "kwargs", "config": settings}
    module = TactileModule.load_from_checkpoint(checkpoint(**more))
    assert isinstance(module.model, TactileFNN)
    assert "hyper_parameters" not in module.state_dict()
    # Nor do they where names and values are expected.
    for value in settings.values():
        for entry in ("arguments", "description"):
            content = small_checkpoint()["module"]
            content[entry] = value if entry == "description" else {"model": value, "loss": value}
            with pytest.raises(ValueError, match=r"some\.ckpt"):
                TactileModule.load_from_checkpoint(checkpoint(module=content))
        for name in ("activation", "inputs", "layout", "channels"):
            content = small_checkpoint()["module"]
            content["description"]["arguments"][name] = value
            with contextlib.suppress(ValueError):
                TactileModule.load_from_checkpoint(checkpoint(module=content))
    assert not (tmp_path / "mark").exists()


@pytest.mark.parametrize("option", [{"weights_only": False}, {"hparams_file": "a.yaml"}])
def test_options_that_run_code_are_refused(checkpoint, option):
    with pytest.raises(ValueError, match="must be left out, because it may run code"):
        TactileModule.load_from_checkpoint(checkpoint(), **option)


def test_data_are_not_built_from_a_checkpoint(checkpoint, tmp_path):
    call = payload(tmp_path / "mark")
    instantiator = "lightning.pytorch.cli.instantiate_module"
    settings = {"_instantiator": instantiator, "dataset": call, "transform": call}
    path = checkpoint(datamodule_hyper_parameters=settings, datamodule_hparams_name="kwargs")
    with pytest.raises(ValueError, match="'TactileDataModule' must be built from its data set"):
        TactileDataModule.load_from_checkpoint(path)
    assert not (tmp_path / "mark").exists()


def test_given_model_is_of_the_class_that_was_trained(checkpoint):
    path = checkpoint()
    model = TactileFNN(4, 2, widths=(3,), pools=(1,))
    module = TactileModule.load_from_checkpoint(path, model=model, optimizer=torch.optim.SGD)
    assert module.optimizer is torch.optim.SGD
    assert not any(value.any() for value in module.model.parameters())
    with pytest.raises(ValueError, match=r"'model' must be of class TactileFNN \(got Linear\)"):
        TactileModule.load_from_checkpoint(path, model=torch.nn.Linear(2, 2))


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


def beside(run, folder, settings, own=False):
    """A copy of the run with another configuration; its model may be one not built by name."""
    content = torch.load(run, weights_only=True)
    if own:
        content["predictor"]["header"]["model"] = {"own": "OwnNet", "text": "OwnNet()"}
    path = folder / "checkpoints" / "last.ckpt"
    path.parent.mkdir()
    torch.save(content, path)
    (folder / "config.yaml").write_text(yaml.safe_dump(settings))
    return path


def evil_texts(path):
    """A text in forms that a parser may follow to the function that it names."""
    text = hidden(path)["folded text d"]["model"]["init_args"]["encoder"]
    plain = ["evil.f", " evil.f", "'evil.f'", "[evil.f]", "- evil.f", '{"class_path": "evil.f"}']
    return [text, *plain, [text], ["evil.f"], ["[evil.f]"], payload(path), [payload(path)]]


@pytest.mark.parametrize(
    "place",
    [
        *("dataset", "transform"),
        *(pytest.param(p, marks=pytest.mark.full) for p in ("compose", "pre_transform", "split")),
    ],
)
def test_configuration_beside_a_checkpoint_runs_nothing(run, tmp_path, monkeypatch, capsys, place):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    mark = tmp_path / "mark"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    code = f"import pathlib; pathlib.Path({str(mark)!r}).touch()\ndef f(*args, **kwargs): 1 / 0\n"
    (tmp_path / "evil.py").write_text(code)
    compose = "torch_geometric.transforms.Compose"
    for i, value in enumerate(evil_texts(mark)):
        settings = copy.deepcopy(CONFIG)
        data = settings["data"]
        data["transform"] = value  # not looked at: the predictor has the fitted one
        inside = {"class_path": compose, "init_args": {"transforms": value}}
        if place in ("transform", "pre_transform", "compose"):
            name = place if place != "compose" else "transform"
            arguments = {name: inside if place == "compose" else value}
            data["dataset"]["init_args"] = {"num_samples": 40, **arguments}
        else:
            data[place] = value
        folder = tmp_path / str(i)
        folder.mkdir()
        path = beside(run, folder, settings)
        statuses = [main(["predict", str(path), "--out", "a.csv"])]
        statuses += [main(["analyze", str(path), "--out", "page"])]
        with contextlib.suppress(ValueError):
            load_data(path)
        assert not mark.exists(), value
        if place not in ("transform", "compose"):  # which the predictor has, so none is called
            assert statuses == [1, 1]
            assert "config.yaml' cannot be used: " in capsys.readouterr().err


@pytest.mark.parametrize("place", hidden(""))
def test_own_model_is_not_built_from_the_configuration_beside(run, tmp_path, place, capsys):
    mark = tmp_path / "mark"
    settings = {**CONFIG, "model": {**CONFIG["model"], **hidden(mark)[place]}}
    path = beside(run, tmp_path, settings, own=True)
    for verb in (["predict", path, run], ["export", path, tmp_path / "a.onnx"], ["predict", path]):
        assert main([str(word) for word in verb]) == 1
        error = capsys.readouterr().err
        assert (
            "cannot be built from the file; pass its configuration with '--config FILE'" in error
            or ("needs the extra" in error)
        )
    assert not mark.exists()


def test_configuration_beside_a_checkpoint_is_used(run):
    assert len(load_data(run).dataset) == 40


def test_configuration_beside_a_checkpoint_writes_in_the_working_directory(
    run, tmp_path, monkeypatch
):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    settings = copy.deepcopy(CONFIG)
    name = "torch_geometric_tactile.datasets.BioTacSP"
    for root in (str(tmp_path), "../elsewhere", "~", "data/../../x"):
        settings["data"]["dataset"] = {"class_path": name, "init_args": {"root": root}}
        folder = tmp_path / "run"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        path = beside(run, folder, settings)
        with pytest.raises(ValueError, match=rf"'root' must lie in the working .*got '{root}'"):
            load_data(path)


def keep(self, **kwargs):
    self.given = kwargs


def test_every_shipped_data_section_is_a_plain_description(monkeypatch, tmp_path):
    seen = []

    class Noted:
        def __init__(self, **kwargs):
            seen.append(kwargs)

        def setup(self):
            pass

    for name in datasets.__all__:
        if isinstance(cls := getattr(datasets, name), type):
            monkeypatch.setattr(
                datasets, name, type(name, (), {"__init__": keep, "__module__": cls.__module__})
            )
    for cls in (Trials, Windows):
        stand_in = type(cls.__name__, (), {"__init__": keep, "__module__": cls.__module__})
        monkeypatch.setattr(run_data, cls.__name__, stand_in)
    monkeypatch.setattr(training, "TactileDataModule", Noted)
    names = [*config_names(), *(f"{t}/{e}" for t in TEMPLATES for e in expand_template(t))]
    for name in names:
        run_data._data_from_description(load_config(name)["data"], Path(name), tmp_path)
        assert "class_path" not in repr(seen[-1])
    assert len(seen) == len(names) > 50


def test_own_model_needs_a_configuration_that_is_given(run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "my_nets.py").write_text(
        "from torch_geometric_tactile.nn.models import GraspGCN\nclass OwnNet(GraspGCN): pass"
    )
    settings = copy.deepcopy(CONFIG)
    settings["model"]["model"] = {"class_path": "my_nets.OwnNet"}
    path = beside(run, tmp_path, settings, own=True)
    assert main(["predict", str(path)]) == 1
    assert "pass its configuration with '--config FILE'" in capsys.readouterr().err
    assert main(["predict", str(path), "--config", "config.yaml"]) == 0


def test_fit_test_and_validate_build_nothing_of_a_checkpoint(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = torch.load(run, weights_only=True)
    config = run.parent.parent / "config.yaml"
    places = hidden(tmp_path / "mark")
    for i, settings in enumerate(places[name] for name in ("model", "optimizer", "list")):
        for key in ("hyper_parameters", "config"):
            content[key] = {**content["config"], **settings}
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
    assert "using settings from the configuration instead of" in caplog.text
    assert "'model.optimizer.init_args.lr' is 0.25 here and 0.001 in the checkpoint" in caplog.text
    config["model"]["model"]["init_args"]["hidden_channels"] = 5
    Path("a.yaml").write_text(yaml.safe_dump(config))
    capsys.readouterr()
    assert main(["test", "--config", "a.yaml", "--ckpt_path", str(run)]) == 1
    said = capsys.readouterr().err
    assert "last.ckpt' must match the model in the configuration" in said
    assert "'model.model.init_args.hidden_channels' is 5 here and " in said


def test_trainer_reads_checkpoints_as_plain_data(checkpoint, tmp_path):
    path = checkpoint()
    content = torch.load(path, weights_only=True)
    torch.save({**content, "more": Touch(tmp_path / "mark")}, path)
    with pytest.raises(ValueError, match=r"some\.ckpt' must hold plain data and tensors only"):
        AtomicCheckpointIO().load_checkpoint(path)
    with pytest.raises(ValueError, match=r"some\.ckpt' must hold plain data and tensors only"):
        TactileModule.load_from_checkpoint(path, model=GraspGCN())
    assert not (tmp_path / "mark").exists()
    AtomicCheckpointIO().load_checkpoint(path, weights_only=False)
    assert (tmp_path / "mark").exists()
