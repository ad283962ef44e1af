r"""Data set, layout and model of one's own, from a folder with a YAML, by ``tactile``."""

import csv
import subprocess
import sys

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
import yaml

from torch_geometric_tactile._user_modules import add_working_directory
from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.training import TactileModule

pytestmark = pytest.mark.full

MODULE = """
import torch
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.sensors import TaxelLayout, as_layout


class Gloves(StaticDataset):
    def __init__(self, layout: str, seed: int = 0, **kwargs):
        self.layout = as_layout(layout)
        self.seed = seed
        super().__init__(None, **kwargs)

    def read(self):
        draw = torch.Generator().manual_seed(self.seed)
        x = torch.randn(80, self.layout.num_taxels, 2, generator=draw)
        data = StaticData(
            x=x,
            edge_index=self.layout.edge_index("original"),
            y=(x[:, 0, 0] > 0).long() + (x[:, 1, 0] > 0).long(),
            trial=torch.arange(80) // 4,
        )
        return data, {"class": ["cup", "pen", "box"]}


class Net(torch.nn.Module):
    def __init__(self, layout: TaxelLayout | str, in_channels: int, out_channels: int):
        super().__init__()
        self.layout = as_layout(layout)
        self.lin1 = torch.nn.Linear(self.layout.num_taxels * in_channels, 16)
        self.lin2 = torch.nn.Linear(16, out_channels)

    def forward(self, x, edge_index):
        return self.lin2(self.lin1(x.flatten(1)).relu())
"""

CONFIG = {
    "model": {
        "model": {"class_path": "my_glove.Net"},
        "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.05}},
        "class_weights": "balanced",
        "label_smoothing": 0.05,
    },
    "data": {
        "dataset": {"class_path": "my_glove.Gloves", "init_args": {"layout": "glove.json"}},
        "test_dataset": {
            "class_path": "my_glove.Gloves",
            "init_args": {"layout": "glove.json", "seed": 1},
        },
        "val": 0.2,
        "transform": {"class_path": "torch_geometric_tactile.transforms.ZScore"},
        "train_transform": {
            "class_path": "torch_geometric_tactile.transforms.DropTaxels",
            "init_args": {"p": 0.01},
        },
    },
    "trainer": {
        "max_epochs": 20,
        "accelerator": "cpu",
        "enable_progress_bar": False,
        "enable_model_summary": False,
    },
}


def tactile(folder, *args):
    # As the installed command starts: the folder is not on the path of its own accord.
    code = "import sys; from torch_geometric_tactile.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-P", "-c", code, *args],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "my_glove.py").write_text(MODULE)
    layout = grid(2, 3, pitch=0.02)
    content = {**layout.to_dict(), "name": "glove"}
    TaxelLayout.from_dict(content).save(tmp_path / "glove.json")
    (tmp_path / "my.yaml").write_text(yaml.safe_dump(CONFIG))
    return tmp_path


def test_own_data_set_layout_and_model_are_trained_tested_and_loaded(folder, monkeypatch):
    done = tactile(folder, "fit", "--config", "my.yaml")
    assert done.returncode == 0, done.stderr
    table = done.stdout.partition("After 20 epochs:")[2]
    accuracy = float(table.partition("val/accuracy")[2].split()[0])
    assert accuracy > 0.6
    assert "val/f1 " in table
    assert "test/" not in table
    assert "serialize" not in done.stderr
    last = "runs/my/version_0/checkpoints/last.ckpt"
    assert f"Last checkpoint: {last}" in table
    (command,) = (line for line in table.splitlines() if line.startswith("  tactile test"))
    assert command.endswith(f"--config runs/my/version_0/config.yaml --ckpt_path {last}")

    stored = torch.load(folder / last, weights_only=True)["config"]["model"]
    assert stored["init_args"]["in_channels"] == 2
    assert stored["init_args"]["out_channels"] == 3

    done = tactile(folder, *command.split()[1:])
    assert done.returncode == 0, done.stderr
    assert "test/accuracy" in done.stdout

    done = tactile(folder, "predict", last, "--config", "my.yaml")
    assert done.returncode == 0, done.stderr
    (path,) = folder.rglob("predictions.csv")
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 80
    assert {row["prediction"] for row in rows} == {"cup", "pen", "box"}

    monkeypatch.syspath_prepend(folder)
    with pytest.raises(ValueError, match="'model' must be given: your model 'Net' cannot be built"):
        TactileModule.load_from_checkpoint(folder / last)
    from my_glove import Net

    model = Net(**{**stored["init_args"], "layout": folder / "glove.json"})
    module = TactileModule.load_from_checkpoint(folder / last, model=model)
    assert module.model.layout.matches(TaxelLayout.load(folder / "glove.json"))


def test_modules_of_the_working_directory_are_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["/somewhere"])
    add_working_directory()
    add_working_directory()
    assert sys.path == ["/somewhere", str(tmp_path)]
