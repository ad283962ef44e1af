import json

import numpy as np
import pytest
from listed_outputs import check_listed

from torch_geometric_tactile.cli import main


def simulate(out, *flags):
    return main(["simulate", "--out", str(out), "--objects", "letters", "--jobs", "1", *flags])


def test_presses_and_their_picture(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    assert simulate(tmp_path, "--presses", "2") == 0
    output = capsys.readouterr()
    (line,) = output.out.splitlines()
    assert line.startswith("52 presses (0 from an earlier run) of 26 letters, ")
    assert line.endswith(f" s; simulated data, not measured, in '{tmp_path}'")
    assert output.err == ""
    assert np.load(tmp_path / "Q" / "Q_0000.npy").shape == (2, 32, 32)

    assert simulate(tmp_path, "--presses", "2", "--preview") == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("52 presses (52 from an earlier run)")
    picture = tmp_path / "preview_letters.png"
    assert second == f"drew {picture}"
    assert picture.read_bytes().startswith(b"\x89PNG")
    check_listed(["simulate", "--out", tmp_path], tmp_path)
    # Folders beside the letters would be other letters.
    assert sum(path.is_dir() for path in tmp_path.iterdir()) == 26


def test_seed_decides(tmp_path, capsys):
    assert simulate(tmp_path, "--presses", "1", "--seed", "3") == 0
    assert json.loads((tmp_path / "simulation.json").read_text())["seed"] == 3
    capsys.readouterr()
    assert simulate(tmp_path, "--presses", "1") == 1
    assert "the presses were simulated with another 'seed' (3, not 0)" in capsys.readouterr().err


def test_number_of_presses_by_the_paper(tmp_path, monkeypatch):
    from torch_geometric_tactile.reports import _simulation as simulation

    asked = []
    monkeypatch.setattr(
        simulation,
        "simulate_letters",
        lambda *args, layout: asked.append(args) or (x for x in ()),
    )
    assert simulate(tmp_path) == 0
    assert asked == [(str(tmp_path), 500, 0, 1)]


def test_ctrl_c_tells_what_is_kept(tmp_path, capsys, monkeypatch):
    from torch_geometric_tactile.reports import _simulation as simulation
    from torch_geometric_tactile.sim import simulate_letters

    def stopped(*args, layout):
        yield from simulate_letters(*args, letters="ABC", layout=layout)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "simulate_letters", stopped)
    assert simulate(tmp_path, "--presses", "1") == 130
    assert "stopped; 3 finished files are kept" in capsys.readouterr().err


def test_letters_on_another_array(tmp_path, capsys):
    from torch_geometric_tactile.sensors import TaxelLayout, hexagonal

    path, out = tmp_path / "hexagonal.json", tmp_path / "letters"
    hexagonal(12, 10, 0.004).save(path)
    assert simulate(out, "--presses", "1", "--layout", str(path)) == 0
    assert len(TaxelLayout.load(out / "layout.json")) == 120
    assert np.load(out / "Q" / "Q_0000.npy").shape == (1, 120)


def test_layout_of_letters_only(tmp_path, capsys):
    assert main(["simulate", "--out", str(tmp_path), "--layout", "hexagonal.json"]) == 1
    error = "'--layout' must be left out for objects other than 'letters' (got 'hexagonal.json')"
    assert error in capsys.readouterr().err


def test_layout_that_is_not_there(tmp_path, capsys):
    assert simulate(tmp_path, "--layout", str(tmp_path / "none.json")) == 1
    assert "none.json" in capsys.readouterr().err
