import sys

import numpy as np
import pytest
from listed_outputs import check_listed

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.cli import build_parser, main
from torch_geometric_tactile.experiments import Predictions, run_plan

SAID = Predictions(np.eye(2)[[0, 1, 1, 1]], np.array([0, 1, 1, 1]), np.array([0, 0, 1, 1]))


@pytest.fixture
def command(grasps, tmp_path, monkeypatch):
    """Runs the command with made-up results; X with positions fails."""

    def run(experiment):
        if experiment.name == "x_pos":
            return {"error": "RuntimeError: no memory"}
        return {
            "metrics": {"accuracy": 0.5, "f1": 0.25, "auroc": 0.75},
            "label_names": None,
            "predictions": SAID.to_dict(),
            "num_train": 48,
            "num_test": 24,
            "frames_per_second": 100.0,
            "peak_memory_mb": 10.0,
            "measures": "resident memory of the process",
            "num_parameters": 7,
            "train_seconds": 1.0,
            "machine": "a machine",
        }

    monkeypatch.setattr(sys.modules[run_plan.__module__], "run_safely", run)
    short = ["--root", str(grasps), "--out", str(tmp_path), "--seeds", "1", "--epochs", "1"]
    return lambda *flags: main(["table", "p2-table2", *short, *flags])


def test_finished_table_is_named(command, tmp_path, capsys):
    assert command("--split-by", "trial", "--only", "i_*", "ii_*") == 0
    output = capsys.readouterr()
    assert output.err == ""  # no bar where there is no terminal
    assert output.out.splitlines() == [
        "p2-table2: 12 of 18 runs finished, 6 missing",
        *(
            f"wrote {tmp_path / 'p2-table2'}{suffix}"
            for suffix in (".md", ".csv", ".png", "-runs.csv", "-orderings.csv")
        ),
    ]
    check_listed(["table", "p2-table2", "--out", tmp_path], tmp_path)
    page = (tmp_path / "p2-table2.md").read_text()
    assert "|  | simulated, by trial | 50.0 | 50.0 | 50.0 |" in page
    assert "objects `paper8`, seed 7, 0.08 s at 100 Hz, MuJoCo 3.3.0" in page
    assert command("--split-by", "trial", "--no-train") == 0
    assert "12 of 18 runs finished (12 kept from before), 6 missing" in capsys.readouterr().out


def test_failed_runs_give_status_1_and_the_table_of_the_others(command, tmp_path, capsys):
    assert command("--split-by", "trial") == 1
    output = capsys.readouterr()
    assert output.err == "tactile: error: x_pos, by trial, seed 0: RuntimeError: no memory\n"
    assert "17 of 18 runs finished, 1 missing" in output.out
    assert (tmp_path / "p2-table2.png").is_file()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (
            ["--only", "mt_*"],
            "'--only' must match the name of an experiment of p2-table2: x_tac, x_pos",
        ),
        (["--phases", "fly"], "'--phases' must be some of ['hover', 'hold']"),
        (
            ["--tare", "fly"],
            "'--tare' must be seconds, or a phase of the recordings: ['hover', 'hold']",
        ),
        (["--protocols", "object"], "'--protocols' must be some of ['by trial', 'by frame']"),
        (["--root", "nowhere"], "simulate some: tactile simulate --out 'nowhere'"),
    ],
)
def test_wrong_arguments_are_explained(command, capsys, flags, message):
    assert command(*flags) == 1
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ([], "readings in the phase hover is subtracted."),
        (["--tare", "0.02"], "readings in its first 0.02 s is subtracted."),
        (["--tare", "none"], None),
    ],
)
def test_rest_readings_are_those_of_the_table_or_chosen(command, tmp_path, flags, said):
    assert command("--split-by", "trial", "--only", "ii_tac", *flags) == 0
    page = (tmp_path / "p2-table2.md").read_text()
    assert (
        ("subtracted" not in page)
        if said is None
        else (f" The mean of each trial's {said}" in page)
    )


@pytest.mark.parametrize("tare", ["0", "-1", "nan", "inf"])
def test_rest_of_no_length_is_refused(tare, capsys):
    with pytest.raises(SystemExit, match="2"):
        build_parser().parse_args(["table", "p1-table2", f"--tare={tare}"])
    assert "must be a phase, 'none', or seconds above 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    "flag", ["--seeds", "--epochs", "--stride", "--folds", "--jobs", "--threads"]
)
def test_numbers_below_one_are_refused(flag, capsys):
    with pytest.raises(SystemExit, match="2"):
        build_parser().parse_args(["table", "p1-table2", flag, "0"])
    assert f"argument {flag}: must be at least 1 (got 0)" in capsys.readouterr().err


def test_help_is_for_strangers(capsys):
    with pytest.raises(SystemExit, match="0"):
        build_parser().parse_args(["table", "--help"])
    text = capsys.readouterr().out
    assert "published numbers" in text
    assert "tactile simulate --out sim" in text
    assert all(len(line) <= 100 for line in text.splitlines())
