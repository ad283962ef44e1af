import json
import sys

import pytest
from listed_outputs import check_listed

from torch_geometric_tactile.cli import build_parser, main
from torch_geometric_tactile.commands.simulate import _MOTIONS, _OBJECT_SETS, _PRESETS, _SPREADS

pytest.importorskip("mujoco", reason="needs the extra 'sim'")
pytest.importorskip("h5py", reason="needs the extra 'sim'")
pytest.importorskip("joblib", reason="needs the extra 'sim'")

from torch_geometric_tactile.sim import (
    MOTIONS,
    PRESETS,
    SPREADS,
    paper8,
    twenty,
)
from torch_geometric_tactile.sim._grasp import PHASES, GraspPlan, plan_grasp
from torch_geometric_tactile.sim._object_sets import OBJECT_SETS

module = sys.modules["torch_geometric_tactile.sim.simulate"]


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Two objects in place of eight, and trials that end before contact; runs the command."""

    def plan(*args):
        gantry, joint, phase, step = plan_grasp(*args)
        hover = phase == PHASES.index("hover")
        return GraspPlan(gantry[hover], joint[hover], phase[hover], step)

    monkeypatch.setattr(module, "plan_grasp", plan)
    monkeypatch.setitem(OBJECT_SETS, "paper8", lambda: paper8()[:2])
    out = tmp_path / "grasps"

    def run(*flags):
        short = ["--preset", "ci", "--jobs", "1", "--trials", "2"]
        return main(["simulate", "--out", str(out), *short, *map(str, flags)])

    return out, run


def never_lifted(monkeypatch, name):
    """Attempts at one object fail."""
    run = module.GraspSimulator.run
    monkeypatch.setattr(
        module.GraspSimulator,
        "run",
        lambda self, *args: run(self, *args)._replace(success=self.item.name != name),
    )


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_choices_are_those_of_the_simulation():
    assert tuple(OBJECT_SETS) == _OBJECT_SETS
    assert tuple(PRESETS) == _PRESETS
    assert tuple(SPREADS) == _SPREADS
    assert tuple(MOTIONS) == _MOTIONS
    assert len(twenty()) == 20


def test_run_ends_with_one_line(quick, capsys):
    out, run = quick
    assert run() == 0
    output = capsys.readouterr()
    (line,) = output.out.splitlines()
    assert line.startswith(
        "4 trials (0 from an earlier run), 4 attempts, 100 % of them successful, "
    )
    assert line.endswith(f" s; simulated data, not measured, in '{out}'")
    assert output.err == ""  # no bar where there is no terminal
    assert files(out) == [
        "plastic_tube_000.h5",
        "plastic_tube_001.h5",
        "simulation.json",
        "sponge_000.h5",
        "sponge_001.h5",
    ]


def test_run_goes_on_where_it_was(quick, capsys):
    out, run = quick
    assert run("--trials", 1) == 0
    assert run() == 0
    assert "\n4 trials (2 from an earlier run), 4 attempts" in capsys.readouterr().out
    assert len(files(out)) == 5
    assert run("--seed", 1) == 1
    error = (
        f"tactile: error: '{out / 'plastic_tube_000.h5'}' was written with another 'seed' (0, not"
    )
    assert error in capsys.readouterr().err


def test_trials_by_the_preset(quick, capsys):
    out, _ = quick
    assert main(["simulate", "--out", str(out), "--preset", "ci", "--jobs", "1"]) == 0
    assert capsys.readouterr().out.startswith("6 trials")


def test_shapes_with_a_wide_spread(quick, capsys):
    out, run = quick
    chosen = ["--objects", "shapes", "--num-objects", 3, "--spread", "wide", "--seconds", 4]
    assert run(*chosen) == 0
    assert capsys.readouterr().out.startswith("6 trials (0 from an earlier run), 6 attempts")
    summary = json.loads((out / "simulation.json").read_text())
    assert summary["spread"]["lazy_finger"] == 0.3
    assert summary["preset"]["duration"] == 4.0
    assert run(*chosen[:-1], 5) == 1
    assert "was written with another 'preset'" in capsys.readouterr().err


def test_squeezes(quick, capsys):
    out, run = quick
    assert run("--motion", "squeeze", "--seconds", 1, "--max-attempts", 20) == 0
    assert capsys.readouterr().out.startswith("4 trials (0 from an earlier run)")
    assert json.loads((out / "simulation.json").read_text())["motion"] == "squeeze"


def test_given_up_trials_are_listed_and_the_status_is_1(quick, capsys, monkeypatch):
    out, run = quick
    never_lifted(monkeypatch, "plastic_tube")
    assert run("--max-attempts", 3) == 1
    output = capsys.readouterr()
    assert "4 trials (0 from an earlier run), 8 attempts, 25 % of them successful" in output.out
    assert output.err.endswith(
        "tactile: error: 2 trials failed after 3 attempts each: plastic_tube 0, plastic_tube 1\n"
    )
    assert files(out) == ["simulation.json", "sponge_000.h5", "sponge_001.h5"]


def test_preview_is_drawn_and_named(quick, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    out, run = quick
    assert run("--trials", 1, "--preview") == 0
    pictures = [out / "preview" / f"preview_{name}.png" for name in ("film", "forces")]
    assert capsys.readouterr().out.splitlines()[1:] == [f"drew {path}" for path in pictures]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    check_listed(["simulate", "--out", out], out, but=(".h5",))
    check_listed(["simulate", "--out", out], out / "preview")


def test_preview_of_a_finished_run_takes_the_first_trial_that_is_there(quick, capsys, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    from torch_geometric_tactile.io import read_recording
    from torch_geometric_tactile.reports import _simulation as simulation

    out, run = quick
    assert run() == 0
    (out / "plastic_tube_000.h5").unlink()
    never_lifted(monkeypatch, "plastic_tube")
    drawn = []

    def read(path):
        drawn.append(path)
        return read_recording(path)

    monkeypatch.setattr(simulation, "read_recording", read)
    monkeypatch.setattr(simulation, "plot_grasp_film", lambda *args: None)
    monkeypatch.setattr(simulation, "plot_grasp_forces", lambda *args: None)
    monkeypatch.setattr(simulation, "save_figure", lambda *args: None)
    assert run("--preview") == 1
    assert drawn == [out / "plastic_tube_001.h5"]


def test_preview_without_matplotlib_fails_before_the_run(quick, capsys, monkeypatch):
    out, _ = quick
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["simulate", "--out", str(out), "--preview"]) == 1
    assert 'pip install "torch-geometric-tactile[viz]"' in capsys.readouterr().err
    assert not out.exists()


def test_interrupt_between_two_trials_tells_what_is_kept(quick, capsys, monkeypatch):
    out, run = quick
    write, written = module.write_hdf5, []

    def stopped_at_the_third(recording, path):
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(path)
        write(recording, path)

    monkeypatch.setattr(module, "write_hdf5", stopped_at_the_third)
    assert run() == 130
    assert capsys.readouterr().err == "tactile: stopped; 2 finished trials are kept\n"
    assert len(files(out)) == 2


def test_killed_process_is_explained(quick, capsys, monkeypatch):
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    def killed(*args):
        raise TerminatedWorkerError("a worker stopped")

    monkeypatch.setattr(module, "write_hdf5", killed)
    assert quick[1]() == 1
    error = capsys.readouterr().err
    assert "a process of the simulation was killed" in error
    assert "fewer jobs" in error


@pytest.mark.parametrize("flag", ["--trials", "--jobs", "--max-attempts", "--presses", "--grasps"])
def test_numbers_below_one_are_refused(flag, capsys):
    with pytest.raises(SystemExit, match="2"):
        build_parser().parse_args(["simulate", "--out", "a", flag, "0"])
    assert f"argument {flag}: must be at least 1 (got 0)" in capsys.readouterr().err


def test_other_wrong_arguments_are_refused(capsys):
    for arguments, message in [
        (["--seed", "-1"], "argument --seed: must not be negative (got -1)"),
        (["--objects", "nine"], "argument --objects: invalid choice: 'nine'"),
        (["--preset", "slow"], "argument --preset: invalid choice: 'slow'"),
        (["--motion", "drop"], "argument --motion: invalid choice: 'drop'"),
        (["--spread", "narrow"], "argument --spread: invalid choice: 'narrow'"),
        (["--seconds", "0.5"], "--seconds: must be a number of seconds from 1 to 3600 (got '0.5')"),
        (["--seconds", "nan"], "--seconds: must be a number of seconds from 1 to 3600 (got 'nan')"),
        (["--seconds", "1_0"], "--seconds: must be a number of seconds from 1 to 3600 (got '1_0')"),
        (["--seconds", "long"], "must be a number of seconds from 1 to 3600 (got 'long')"),
        (["--num-objects", "0"], "argument --num-objects: must be at least 1 (got 0)"),
    ]:
        with pytest.raises(SystemExit, match="2"):
            build_parser().parse_args(["simulate", "--out", "a", *arguments])
        assert message in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        build_parser().parse_args(["simulate"])
    assert "required: --out" in capsys.readouterr().err


def test_help_has_examples(capsys):
    with pytest.raises(SystemExit, match="0"):
        build_parser().parse_args(["simulate", "--help"])
    text = capsys.readouterr().out
    assert "tactile simulate --out grasps" in text
    assert "tactile simulate --out letters --objects letters --preview" in text
    assert "plausible, not measured" in " ".join(text.split())
    assert "    simulate " in build_parser().format_help()


@pytest.mark.full
def test_grasps_of_three_fingertips(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    out = tmp_path / "bigs"
    flags = ["--out", str(out), "--objects", "bigs", "--jobs", "1", "--grasps"]
    assert main(["simulate", *flags, "2"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("2 grasps (0 from an earlier run), held: box ")
    assert main(["simulate", *flags, "3", "--preview"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("3 grasps (2 from an earlier run)")
    picture = out / "preview" / "preview_grasps.png"
    assert second == f"drew {picture}"
    check_listed(["simulate", *flags, "3"], out, but=(".h5",))
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("trials", "3"),
        ("preset", "ci"),
        ("hand", "allegro_uskin"),
        ("seconds", "4.0"),
        ("spread", "wide"),
        ("motion", "squeeze"),
        ("max_attempts", "3"),
        ("num_objects", "3"),
    ],
)
def test_what_only_the_hand_has_is_refused_for_others(tmp_path, capsys, option, value):
    for objects, number in (("bigs", "grasps"), ("letters", "presses")):
        flags = ["--objects", objects, f"--{option.replace('_', '-')}", value]
        assert main(["simulate", "--out", str(tmp_path / "a"), *flags]) == 1
        flag = f"--{option.replace('_', '-')}"
        advice = f": use '--{number}'" if option == "trials" else ""
        message = f"error: '{flag}' must be left out for '{objects}' (got {value}){advice}\n"
        assert message in capsys.readouterr().err
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    ("objects", "option", "owner", "number"),
    [
        ("paper8", "grasps", "bigs", "trials"),
        ("letters", "grasps", "bigs", "presses"),
        ("paper8", "presses", "letters", "trials"),
        ("shapes", "presses", "letters", "trials"),
        ("bigs", "presses", "letters", "grasps"),
    ],
)
def test_each_has_a_number_of_its_own(tmp_path, capsys, objects, option, owner, number):
    flags = ["--objects", objects, f"--{option}", "3"]
    assert main(["simulate", "--out", str(tmp_path / "a"), *flags]) == 1
    assert (
        f"'--{option}' must be left out for objects other than '{owner}' (got 3): use '--{number}'"
    ) in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
