"""Models of a user in the working directory: they are found, and one that fails stops no other."""

# ruff: noqa: E402
import json
import subprocess
import sys
from itertools import count

import pytest

for extra in ("lightning", "sklearn", "matplotlib"):
    pytest.importorskip(extra, reason="needs the extras 'train' and 'viz'")

from compared import touches

from torch_geometric_tactile.cli import main

MODELS = """
import torch
from sklearn.neighbors import KNeighborsClassifier

class Net(torch.nn.Module):
    def __init__(self, num_taxels, in_channels, num_classes):
        super().__init__()
        self.lin = torch.nn.Linear(num_taxels * in_channels, num_classes)

    def forward(self, x, edge_index=None):
        return self.lin(x.flatten(1))

class FailsToBuild(Net):
    def __init__(self, num_taxels, in_channels, num_classes):
        raise RuntimeError("no such thing")

class FailsToTrain(Net):
    def forward(self, x, edge_index=None):
        raise KeyError("no such key")

class FailsToPredict(Net):
    def forward(self, x, edge_index=None):
        if not self.training:
            raise RuntimeError("only trained")
        return super().forward(x)

class Fits(KNeighborsClassifier):
    def fit(self, x, y):
        raise TypeError("no fit")

def neighbours():
    return KNeighborsClassifier(3)

def needs_one(k):
    return KNeighborsClassifier(k)

def network():
    return torch.nn.Linear(2, 2)

NUMBER = 3
"""
NUMBERS = count()


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The name of a module in the working directory that no other test has imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    name = f"my_nets_{next(NUMBERS)}"
    (tmp_path / f"{name}.py").write_text(MODELS)
    touches(tmp_path / "a.npz")
    return name


def compare(models, *options):
    short = ["--grid", "3x4", "--epochs", "1", "--folds", "2", "--members", "1", "--out", "out"]
    return main(["compare", "a.npz", *short, "--models", models, *options])


@pytest.mark.full
def test_models_of_the_working_directory_are_found_in_workers_too(own, tmp_path):
    short = ["--grid", "3x4", "--epochs", "1", "--folds", "2", "--out", "out", "--jobs", "2"]
    command = ["compare", "a.npz", *short, "--models", f"{own}.Net,{own}.neighbours"]
    code = f"import sys; from torch_geometric_tactile.cli import main; sys.exit(main({command}))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out" / "a.json").read_text())
    assert [model["name"] for model in found["models"]] == [f"{own}.Net", f"{own}.neighbours"]


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        ("FailsToBuild", "(RuntimeError: no such thing)"),
        ("FailsToTrain", "KeyError: 'no such key'"),
        ("FailsToPredict", "RuntimeError: only trained"),
        ("Fits", "TypeError: no fit"),
        (
            "needs_one",
            "needs_one' must not need arguments other than 'layout', the only one that it is "
            "called with if it has it (it needs k); give the others a default",
        ),
        ("network", "must return an estimator of scikit-learn; of a network, give the class"),
    ],
)
def test_one_failing_model_stops_no_other(own, tmp_path, capsys, model, reason):
    save = ["--save", "best.predictor", "--model", "constant"]
    assert compare(f"{own}.{model},constant", *save) == 1
    said = capsys.readouterr()
    failed = [line for line in said.err.splitlines() if line.startswith("tactile: error: ")]
    assert len(failed) == 2
    assert all(line.startswith(f"tactile: error: {own}.{model}, by trial") for line in failed)
    assert all(reason in line for line in failed)
    assert "Traceback" not in said.err
    found = json.loads((tmp_path / "out" / "a.json").read_text())
    assert [model["name"] for model in found["models"]] == ["constant"]
    assert (tmp_path / "best.predictor").is_file()


@pytest.mark.parametrize(
    ("text", "model", "reason"),
    [
        (MODELS, "NUMBER", "which is of type int"),
        (MODELS, "Nothing", "has no attribute 'Nothing'"),
        ("def broken(:\n", "Net", "SyntaxError("),
        ("1 / 0\n", "Net", "ZeroDivisionError("),
        ("import no_such_package\n", "Net", "No module named 'no_such_package'"),
    ],
)
def test_what_cannot_be_imported_is_told_before_the_runs(
    own, tmp_path, capsys, text, model, reason
):
    (tmp_path / f"{own}.py").write_text(text)
    assert compare(f"{own}.{model},constant") == 1
    error = capsys.readouterr().err
    assert error.startswith("tactile: error: '--models' must be names of stock models")
    assert reason in error
    assert not (tmp_path / "out").exists()
