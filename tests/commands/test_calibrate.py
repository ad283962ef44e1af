"""The verb: what it reads, what it says, and what it writes."""

import json
import re

import numpy as np
import pytest
import torch

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording, StaticData
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.transforms import Calibrate

GAIN = np.array([[1.0, 2.0, 3.0], [0.0, -1.0, 5.0]])


def recordings(folder, count=3, suffix="npz", offset=0.0, **changes):
    draw = np.random.default_rng(0)
    paths = []
    for i in range(count):
        tactile = draw.normal(size=(40, 2, 3)).astype(np.float32)
        force = (tactile * GAIN).sum(axis=(1, 2)) + 7
        force[::4] = np.nan
        tactile[:5] = 0
        force[:5] = 7
        given = {"extra": {"fz": force}, "meta": {"unit": "count"}, **changes}
        time = 0.01 * np.arange(40)
        paths.append(folder / f"press_{i}.{suffix}")
        write_recording(Recording(time=time, tactile=tactile + offset * i, **given), paths[-1])
    return paths


def run(*words):
    return main(["calibrate", *map(str, words)])


def complaint(capsys, *words):
    assert run(*words) == 1
    return capsys.readouterr().err


def test_errors_are_printed_and_the_file_is_a_transform(tmp_path, capsys):
    paths = recordings(tmp_path)
    out = tmp_path / "skin.json"
    assert run(*paths, "--force", "fz", "--force-unit", "newton", "--out", out) == 0
    lines = capsys.readouterr().out.splitlines()
    assert re.split("  +", lines[0])[:2] == ["held out", "RMSE in newtons"]
    assert [line.split()[0] for line in lines[1:4]] == [path.name for path in paths]
    assert all(float(line.split()[1]) < 0.01 for line in lines[1:4])
    assert lines[4].startswith("fitted to all recordings: 96 forces from ")
    assert "channel 2 -" in lines[5]
    assert lines[6] == f"wrote {out}"
    calibrate = Calibrate.load(out)
    assert calibrate.units == ("count", "newton")
    assert calibrate.source.startswith("'fz' of 3 recordings (press_0.npz, press_1.npz, press_2")
    x = torch.from_numpy(read_recording(paths[0]).tactile)
    expected = (x * torch.tensor(GAIN)).sum(dim=(1, 2)) + 7
    found = calibrate(StaticData(x=x)).force[:, 0].double()
    torch.testing.assert_close(found, expected, atol=0.01, rtol=0)


def test_rest_is_subtracted(tmp_path, capsys):
    paths = recordings(tmp_path, offset=100.0)
    out = tmp_path / "skin.json"
    assert run(*paths, "--force", "fz", "--degree", 1, "--rest", 5, "--out", out) == 0
    assert float(capsys.readouterr().out.splitlines()[1].split()[1]) < 0.01
    assert "less the mean of the first 5 frames of each" in json.loads(out.read_text())["source"]
    assert run(*paths, "--force", "fz", "--degree", 1) == 0
    assert float(capsys.readouterr().out.splitlines()[1].split()[1]) > 1


def test_column_of_a_named_csv_is_the_force_and_no_reading(tmp_path, capsys):
    paths = []
    for i, recording in enumerate(map(read_recording, recordings(tmp_path))):
        x = recording.tactile.reshape(40, 6)
        order = np.arange(6) if i else np.arange(6)[::-1]  # columns in another order
        names = [f"pad_{k}" for k in order]
        rows = [",".join(["time", "fz", *names])]
        for t, f, row in zip(recording.time, recording.extra["fz"], x[:, order], strict=True):
            rows.append(",".join([str(t), "" if np.isnan(f) else str(f), *map(str, row)]))
        paths.append(tmp_path / f"press_{i}.csv")
        paths[-1].write_text("\n".join(rows) + "\n")
    out = tmp_path / "skin.json"
    words = ["--force", "fz", "--unit", "count", "--out", out, "--degree", 1]
    assert run(*paths, *words) == 0
    assert float(capsys.readouterr().out.splitlines()[1].split()[1]) < 0.01
    assert repr(Calibrate.load(out)).startswith("Calibrate(1 -> 1, num_taxels=6, degree=1")


def test_forces_of_taxels_of_a_simulator(tmp_path, capsys):
    force = np.random.default_rng(1).normal(size=(40, 2, 2))
    paths = recordings(tmp_path, count=2, privileged={"force": force}, extra={})
    out = tmp_path / "skin.json"
    assert run(*paths, "--force", "force", "--per", "taxel", "--out", out) == 0
    assert "Calibrate(3 -> 2, num_taxels=2, " in repr(Calibrate.load(out))
    assert "1.0" not in capsys.readouterr().out.splitlines()[0]
    text = complaint(capsys, *paths, "--force", "force")
    assert "'--force' must have shape (80, 'num_forces'), per sensor (got (80, 2, 2))" in text


def test_bad_input(tmp_path, capsys):
    paths = recordings(tmp_path, count=2)
    text = complaint(capsys, paths[0], "--force", "fz")
    assert "two or more different recordings must be given" in text
    assert "two or more different" in complaint(capsys, *paths, paths[0], "--force", "fz")
    text = complaint(capsys, *paths, "--force", "fx")
    assert "'--force' must be a signal of" in text
    assert "press_0.npz': fz (got 'fx')" in text
    other = tmp_path / "other"
    other.mkdir()
    (one,) = recordings(other, count=1, meta={"unit": "microtesla"})
    text = complaint(capsys, *paths, one, "--force", "fz")
    assert "all recordings must be from one sensor in one unit" in text
    (one,) = recordings(other, count=1, extra={"fz": np.array(["a"] * 40)})
    assert "'--force' must be numbers in" in complaint(capsys, one, paths[0], "--force", "fz")
    (one,) = recordings(other, count=1, extra={"fz": np.full(40, np.nan)})
    text = complaint(capsys, one, paths[0], "--force", "fz")
    assert "'--force' must be measured in each recording (got none in 0)" in text
    assert "does not exist" in complaint(capsys, *paths, tmp_path / "no.npz", "--force", "fz")
    with pytest.raises(SystemExit):
        run(*paths)
    assert "--force" in capsys.readouterr().err


def test_columns_that_are_called_as_options_keep_their_names(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("time,fz,pad,degree\n0,1,2,cup\n0.01,1,2,cup\n")
    (other,) = recordings(tmp_path, count=1)
    text = complaint(capsys, path, other, "--force", "fz", "--unit", "count")
    assert "'degree'" in text
    assert "'--degree'" not in text
    assert "give it as '--label' or '--ignore'" in text


def test_published_runs(eflesh_probe, tmp_path, capsys):
    folders = sorted((eflesh_probe / "normal_force").iterdir())
    out = tmp_path / "eflesh.json"
    assert run(*folders, "--force", "force", "--degree", 1, "--rest", 10, "--out", out) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "RMSE in the unit of the file" in lines[0]
    found = [float(line.split()[1]) for line in lines[1:4]]
    assert found == pytest.approx([240.9, 60.2, 71.5], abs=0.1)
    assert Calibrate.load(out).units == ("unit of the file", "unit of the file")
