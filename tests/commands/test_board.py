"""The verb, on two small data sets and three quick models."""

# ruff: noqa: E402

import json
import sys

import pytest

for extra in ("lightning", "sklearn", "matplotlib"):
    pytest.importorskip(extra, reason="needs the extras 'train' and 'viz'")

from listed_outputs import check_listed

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.experiments import _board, _compared_models
from torch_geometric_tactile.experiments._board import BOARD, BoardSet

SETS = (
    BoardSet("grasps", "BioTacSP", "slip", "given", {"split": "all", "checksum": False}),
    BoardSet("by object", "BioTacSP", "slip", "group", {"checksum": False}, ranks=False),
    BoardSet("away", "ICubGrasp", "objects", "trial"),
)


@pytest.fixture
def data(tmp_path, write_bts3, monkeypatch):
    write_bts3(tmp_path / "BioTacSP" / "raw")
    monkeypatch.setattr(_board, "BOARD", SETS)
    quick = [m for m in _compared_models.MODELS if m.name in ("fnn", "svm_linear", "constant")]
    monkeypatch.setattr(_compared_models, "MODELS", tuple(quick))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(data, *options):
    return main(["board", "--data", str(data), "--epochs", "1", "--out", "out", *options])


def test_page_and_scores(data, capsys, caplog):
    assert run(data) == 0
    assert "away is left out: there are no trials in" in caplog.text
    said = capsys.readouterr().out
    assert "grasps: 48 samples, 48 trials; the given parts; 3 models x 1 seed; about" in said
    assert "grasps: 3 models, the best is" in said
    check_listed(["board", "--out", data / "out"], data / "out")
    page = (data / "out" / "board.md").read_text()
    (row,) = [line for line in page.splitlines() if line.startswith("| `constant` |")]
    scores = json.loads((data / "out" / "board.json").read_text())["accuracy"]
    assert set(scores) == {"grasps", "by object"}
    shown = f"{100 * scores['grasps']['constant']['mean']:.1f}"
    assert row.split(" | ")[3].strip("*") == shown
    assert row.split(" | ")[2] == "1"  # one of both sets ranks models
    assert "the given parts" in page
    kept = {p: p.stat().st_mtime_ns for p in (data / "out" / "runs").glob("*.json")}
    assert run(data, "--no-train") == 0
    assert kept == {p: p.stat().st_mtime_ns for p in (data / "out" / "runs").glob("*.json")}


def test_model_of_ones_own_finds_its_place(data, capsys):
    assert run(data, "--sets", "grasps", "--own", "own_models.neighbours") == 0
    page = (data / "out" / "board.md").read_text()
    places = [float(line.split(" | ")[1]) for line in page.splitlines() if line.startswith("| `")][
        :4
    ]
    assert "`own_models.neighbours`" in page
    assert places == sorted(places)
    assert sum(places) == 1 + 2 + 3 + 4


def test_model_of_ones_own_that_fails_stops_no_other(data, capsys, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    (data / "my_board_nets.py").write_text("def broken():\n    raise KeyError('no such key')\n")
    assert run(data, "--sets", "grasps", "--own", "my_board_nets.broken") == 1
    said = capsys.readouterr()
    assert "tactile: error: my_board_nets.broken, given, seed 0" in said.err
    assert "KeyError: 'no such key'" in said.err
    scores = json.loads((data / "out" / "board.json").read_text())["accuracy"]["grasps"]
    assert set(scores) == {"fnn", "svm_linear", "constant"}


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--sets", "grasp"], "'--sets' must be some of grasps, by object, away (got 'grasp')"),
        (["--own", "OneLayer"], "'--own' must be some of taxel_net, "),
        (
            ["--own", "own_models.Nothing"],
            "import paths of your own models (got 'own_models.Nothing'",
        ),
        (["--sets", "away"], "no data set of the board has results"),
    ],
)
def test_bad_input(data, capsys, options, match):
    assert run(data, *options) != 0
    assert match in capsys.readouterr().err


def test_sets_are_classes_of_ours_with_their_arguments():
    from torch_geometric_tactile import datasets
    from torch_geometric_tactile.experiments._building import argument_names

    for board_set in BOARD:
        names = argument_names(f"torch_geometric_tactile.datasets.{board_set.dataset}")
        assert hasattr(datasets, board_set.dataset)
        assert {*board_set.arguments} <= set(names)
        assert board_set.by in ("given", "group", "trial")


def test_tables_of_scores_have_at_most_six_columns():
    from torch_geometric_tactile.reports._board import _score_tables

    header = ["model", "mean rank", "ranked sets", "a", "b", "c", "d"]
    rows = [["fnn", "1.0", "4", "90", "91", "92", "93"], ["lstm", "2.0", "1", "80", "", "", ""]]
    lines = _score_tables(header, rows)
    assert [line for line in lines if line.startswith("| model")] == [
        "| model | mean rank | ranked sets | a | b | c |",
        "| model | d |",
    ]
    assert lines[-1] == "| `fnn` | 93 |"  # lstm has no score on the fourth set
