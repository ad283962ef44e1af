r"""A checkpoint, or a configuration beside one, runs nothing."""

import contextlib
import copy
import sys
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
import yaml
from fake_configs import fake_config
from hostile_settings import LINEAR, hidden, payload

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.nn.models import GraspGCN
from torch_geometric_tactile.reports.run_data import load_data, open_predictor
from torch_geometric_tactile.training import AtomicCheckpointIO, TactileModule

CONFIG = fake_config("GraspGCN", 40, test=0.25, split="frame")


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
    assert "taken from the configuration instead of" in caplog.text
    assert "'model.optimizer.init_args.lr' is 0.25, in the checkpoint 0.001" in caplog.text
    config["model"]["model"]["init_args"]["hidden_channels"] = 5
    Path("a.yaml").write_text(yaml.safe_dump(config))
    capsys.readouterr()
    assert main(["test", "--config", "a.yaml", "--ckpt_path", str(run)]) == 1
    said = capsys.readouterr().err
    assert "last.ckpt' must hold the model of the configuration" in said
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
