r"""Sizes on the way from the command line to a checkpoint."""

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
import yaml
from fake_configs import fake_config, fake_dataset
from training_fixtures import quiet_trainer

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.training._lightning_cli import (
    TactileCLI,
    UnparsedArguments,
    fit_summary,
)

CONFIG = fake_config("TactileGCN", 60, val=0.2, split="group")


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gcn.yaml").write_text(yaml.safe_dump(CONFIG))
    return ["--config", "gcn.yaml"]


def built(args):
    return TactileCLI(args, run=False)


def test_model_has_the_sizes_of_the_data_and_the_checkpoint_as_well(config):
    cli = built(config)
    arguments = cli.model.config["model"]["init_args"]
    assert (cli.model.model.num_nodes, arguments["out_channels"]) == (24, 2)
    assert arguments["channels"]["tactile"] == 3
    assert cli.datamodule is cli._data  # built once


def test_sections_may_be_files_and_a_later_file_stands_above(config, tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "data.yaml").write_text(yaml.safe_dump(CONFIG["data"]))
    (tmp_path / "sub" / "all.yaml").write_text(yaml.safe_dump({**CONFIG, "data": "data.yaml"}))
    (tmp_path / "more.yaml").write_text("data: {batch_size: 7}\nmodel: {label_smoothing: 0.1}")
    cli = built(["--config=sub/all.yaml", "--config=more.yaml", "--data.val", "0.3"])
    assert (cli.datamodule.batch_size, cli.datamodule.val) == (7, 0.3)
    assert cli.model.label_smoothing == 0.1


def test_data_on_the_command_line_gives_the_sizes(config):
    cli = built([*config, "--data.dataset.init_args.layout", "null"])
    assert cli.model.model.num_nodes == 24
    cli = built([*config, "--data.dataset.num_samples=30"])
    assert len(cli.datamodule.dataset) == 30


def test_model_on_the_command_line_is_filled_as_well(config):
    name = "torch_geometric_tactile.nn.models.GraspGCN"
    cli = built([*config, f"--model.model={name}", "--model.model.hidden_channels", "5"])
    assert type(cli.model.model).__name__ == "GraspGCN"
    assert (cli.model.model.in_channels, cli.model.model.hidden_channels) == (1, 5)


def test_model_section_may_be_a_file(config, tmp_path):
    (tmp_path / "model.yaml").write_text("label_smoothing: 0.2")
    cli = built([*config, "--model", "model.yaml"])
    assert (cli.model.label_smoothing, cli.model.num_classes) == (0.2, 2)
    assert cli.model.config["model"]["init_args"]["channels"]["tactile"] == 3


def test_wrong_size_is_an_explained_error(config, capsys):
    assert main(["fit", *config, "--model.model.init_args.out_channels", "5"]) == 1
    error = capsys.readouterr().err
    assert "'out_channels' of TactileGCN must be 2, as in the data (got 5); leave it out" in error


def test_help_and_print_config_run_nothing(config, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["fit", "--help-all"])
    said = capsys.readouterr().out
    assert "--data.train_transform" in said
    assert "--model.class_weights" in said
    with pytest.raises(SystemExit, match="0"):
        main(["fit", *config, "--print_config"])
    printed = yaml.safe_load(capsys.readouterr().out)
    assert printed["model"]["model"]["init_args"]["channels"]["tactile"] == 3
    assert printed["model"]["num_classes"] == 2


def test_configuration_without_its_data_is_printed_without_sizes(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["fit", "--config", "p1_table2/gcn_te", "--print_config"])
    printed = capsys.readouterr()
    assert "sizes of the model are not filled in" in printed.err
    assert yaml.safe_load(printed.out)["data"]["batch_size"] == 32


def test_arguments_are_sorted_by_section():
    args = "fit --data.val 0.2 --model.model=A --data.test=0 --trainer.devices 1"
    arguments = UnparsedArguments.read(args.split())
    assert arguments.section_arguments("data") == ["--data.val=0.2", "--data.test=0"]
    assert arguments.last_value("model.model", "model.model.class_path") == "A"
    assert arguments.last_value("data.val") == "0.2"
    assert arguments.last_value("seed_everything") is None
    assert not arguments.only_prints
    assert UnparsedArguments.read(["fit", "--model.help", "A"]).only_prints


def test_files_that_are_no_configuration(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"the configuration 'none\.yaml'"):
        UnparsedArguments.read(["--config", "none.yaml"])
    (tmp_path / "list.yaml").write_text("[1, 2]")
    with pytest.raises(ValueError, match=r"must be a mapping with the keys data, .*\(got list\)"):
        UnparsedArguments.read(["--config", str(tmp_path / "list.yaml")])


def test_summary_tells_what_comes_next(config):
    cli = built(config)
    cli.trainer.fit(cli.model, datamodule=cli.datamodule)
    lines = fit_summary(cli.trainer, cli.trainer.log_dir).splitlines()
    value = float(cli.trainer.callback_metrics["val/f1_positive"])
    (row,) = (line for line in lines if line.startswith("val/f1_positive"))
    assert float(row.split()[1]) == pytest.approx(value, abs=1e-4)
    assert "Last checkpoint: checkpoints/last.ckpt" in lines


def test_summary_without_parts(config):
    cli = built([*config, "--data.val=0"])
    cli.trainer.fit(cli.model, datamodule=cli.datamodule)
    text = fit_summary(cli.trainer, cli.trainer.log_dir)
    assert "there is no validation part" in text
    assert "train/loss" in text
    assert "There is no test part: set 'data.test_dataset', or 'data.test' above 0." in text


def test_summary_names_the_best_checkpoint(config):
    cli = built(config)
    callback = L.pytorch.callbacks.ModelCheckpoint(monitor="val/loss", save_last=True)
    trainer = quiet_trainer(callbacks=[callback], enable_checkpointing=True)
    trainer.fit(cli.model, datamodule=cli.datamodule)
    text = fit_summary(trainer)
    assert "Best checkpoint by val/loss: checkpoints/epoch=0" in text
    assert "Last checkpoint: checkpoints/last.ckpt" in text


def test_seed_gives_the_weights_that_it_gave_before(config):
    weights = [p.clone() for p in built(config).model.parameters()]
    model = CONFIG["model"]["model"]["class_path"].rpartition(".")[2]
    from torch_geometric_tactile.nn import models

    L.seed_everything(0, verbose=False)
    init_args = built(config).model.config["model"]["init_args"]
    L.seed_everything(0, verbose=False)
    expected = getattr(models, model)(**init_args)
    for found, value in zip(weights, expected.parameters(), strict=True):
        assert torch.equal(found, value)


def test_model_without_edges_from_fit_to_predict(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plain = {**fake_dataset(60), "init_args": {"num_samples": 60}}
    parts = {"val": 0.2, "split": "group", "dataset": plain, "test_dataset": plain}
    own = fake_config("TaxelNet", 60, is_logged=True, **parts)
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(own))
    assert main(["fit", "--config", "own.yaml"]) == 0
    checkpoint = "runs/own/version_0/checkpoints/last.ckpt"
    assert main(["test", "--config", "own.yaml", "--ckpt_path", checkpoint]) == 0
    assert main(["predict", checkpoint]) == 0
    assert len((tmp_path / "predictions.csv").read_text().splitlines()) == 61
    capsys.readouterr()
    gcn = "torch_geometric_tactile.nn.models.TactileGCN"
    assert main(["fit", "--config", "own.yaml", "--model.model", gcn]) != 0
    assert "the model needs 'edge_index'" in capsys.readouterr().err


@pytest.mark.parametrize("form", ["path", "class with arguments"])
def test_encoder_of_my_own_by_import_path(form, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_encoders.py").write_text(
        "import torch\n"
        "class MyEncoder(torch.nn.Module):\n"
        "    def __init__(self, factor: float = 2.0):\n"
        "        super().__init__()\n"
        "        self.factor = torch.nn.Parameter(torch.tensor(factor))\n"
        "    def forward(self, edge_attr, edge_index, num_nodes=None):\n"
        "        out = edge_attr.new_zeros(*edge_attr.shape[:-2], num_nodes, edge_attr.size(-1))\n"
        "        return self.factor * out.index_add(-2, edge_index[1], edge_attr)\n"
    )
    path = "my_encoders.MyEncoder"
    encoder = path if form == "path" else {"class_path": path, "init_args": {"factor": 3.0}}
    edges = {"class_path": "torch_geometric_tactile.transforms.GeometricEdgeAttr"}
    model = {"init_args": {"inputs": ["tactile", "edge"], "encoder": encoder}}
    model["class_path"] = "torch_geometric_tactile.nn.models.TactileGCN"
    content = {**CONFIG, "model": {"model": model}, "data": {**CONFIG["data"], "transform": edges}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(content))
    cli = built(["--config", "own.yaml"])
    assert type(cli.model.model.encoder).__name__ == "MyEncoder"
    assert cli.model.model.encoder.factor.item() == (2.0 if form == "path" else 3.0)
    cli.datamodule.setup("fit")
    batch = next(iter(cli.datamodule.train_dataloader()))
    assert cli.model.model(batch.x, batch.edge_index, batch.edge_attr).shape[1] == 2
