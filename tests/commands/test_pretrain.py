"""The verb, on tiny files: what it reads, where it goes on, and what it says of bad input."""

# ruff: noqa: E402
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

for extra in ("lightning", "sklearn", "matplotlib"):
    pytest.importorskip(extra, reason="needs the extras 'train' and 'viz'")

from compared import touches

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.predictor import PretrainedEncoder

ENCODED = "encoder_forest,encoder_svm,encoder_tuned"


def run(folder, *data, steps="3", options=()):
    out = folder / "skin.encoder"
    return main(["pretrain", *map(str, data), "--out", str(out), "--steps", steps, *options])


def encoder(folder):
    return PretrainedEncoder.load(folder / "skin.encoder")


def recordings(folder, count=4, suffix="csv", taxels=12, frames=20, **meta):
    draw = np.random.default_rng(0)
    paths = []
    for i in range(count):
        tactile = draw.normal(size=(frames, taxels, 1)) + i
        time_ = 0.01 * np.arange(frames)
        paths.append(folder / f"trial_{i}.{suffix}")
        write_recording(Recording(time=time_, tactile=tactile, meta=meta), paths[-1])
    return paths


def test_samples_without_labels(tmp_path, capsys, caplog):
    touches(tmp_path / "a.npz", y=None)
    assert run(tmp_path, tmp_path / "a.npz", options=["--grid", "3x4"]) == 0
    assert "12 trials and 48 frames are few" in caplog.text
    assert "wrote " in capsys.readouterr().out
    found = encoder(tmp_path)
    assert found.layout.num_taxels == 12
    assert found.trained_on["num_trials"] == 12
    assert found.trained_on["num_frames"] == 48
    assert found.trained_on["source"] == "a.npz"
    assert found.trained_on["steps"] == 3
    assert {path.name for path in tmp_path.iterdir()} == {"a.npz", "skin.encoder"}


@pytest.mark.parametrize("as_folder", [True, False])
def test_recordings(tmp_path, as_folder):
    (tmp_path / "day").mkdir()
    paths = recordings(tmp_path / "day", suffix="npz")
    data = [tmp_path / "day"] if as_folder else paths
    options = ["--grid", "3x4", "--stride", "2", "--rest", "3"]
    assert run(tmp_path, *data, options=options) == 0
    found = encoder(tmp_path)
    assert found.trained_on["num_trials"] == 4
    assert found.trained_on["num_frames"] == 40
    assert found.trained_on["rest"] == 3
    assert float(found.model.center.abs().max()) < 2  # the offset of a trial is gone


def test_recordings_that_name_their_sensor(tmp_path):
    paths = recordings(tmp_path, suffix="npz", taxels=24, sensor="biotac_sp")
    assert run(tmp_path, *paths) == 0
    assert encoder(tmp_path).layout.name == "biotac_sp"


def test_columns_with_other_names(tmp_path):
    for i in range(3):
        rows = ["t,pad_0,pad_1,foot"] + [f"{0.1 * k},{k},{k + i},7" for k in range(9)]
        (tmp_path / f"{i}.csv").write_text("\n".join(rows) + "\n")
    paths = [tmp_path / f"{i}.csv" for i in range(3)]
    options = ["--grid", "1x2", "--tactile", "pad_.*", "--time", "t", "--ignore", "foot"]
    assert run(tmp_path, *paths, options=options) == 0
    assert encoder(tmp_path).layout.num_taxels == 2


def test_encoder_joins_a_comparison(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    assert run(tmp_path, tmp_path / "a.npz", options=["--grid", "3x4"]) == 0
    out = tmp_path / "out"
    options = ["--grid", "3x4", "--epochs", "2", "--folds", "3", "--members", "1"]
    options += ["--models", f"{ENCODED},constant", "--out", str(out)]
    given = ["--encoder", str(tmp_path / "skin.encoder")]
    assert main(["compare", str(tmp_path / "a.npz"), *options, *given]) == 0
    said = capsys.readouterr().out
    for name in ENCODED.split(","):
        assert name in said
    assert len(list((out / "runs").glob("*.json"))) == 12
    assert main(["compare", str(tmp_path / "a.npz"), *options]) == 1
    assert "no encoder is given ('--encoder')" in capsys.readouterr().err
    assert main(["compare", str(tmp_path / "a.npz"), *options, *given, "--rest", "2"]) == 1
    assert "'--rest' must be of the first 0 frames of a trial" in capsys.readouterr().err


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_stopped_pretraining_goes_on_to_the_same_encoder(tmp_path, stop):
    whole, halved = tmp_path / "whole", tmp_path / "halved"
    for folder in (whole, halved):
        folder.mkdir()
        touches(folder / "a.npz")
    assert run(whole, whole / "a.npz", steps="60", options=["--grid", "3x4"]) == 0
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from torch_geometric_tactile.training import pretraining; "
        "pretraining._SECONDS_BETWEEN_FILES = 0.0; "
        "from torch_geometric_tactile.cli import main; raise SystemExit(main())"
    )
    arguments = [str(halved / "a.npz"), "--grid", "3x4", "--steps", "60"]
    arguments += ["--out", str(halved / "skin.encoder")]
    process = subprocess.Popen(
        [sys.executable, "-c", code, "pretrain", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    checkpoint = halved / "skin.encoder.checkpoint"
    deadline = time.monotonic() + 120
    while not checkpoint.is_file() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(stop)
    said = process.communicate(timeout=60)[1].decode()
    assert process.returncode == (130 if stop == signal.SIGINT else -9), said
    assert stop == signal.SIGKILL or "stopped: the same command goes on" in said
    assert checkpoint.is_file()
    assert not (halved / "skin.encoder").exists()
    assert run(halved, halved / "a.npz", steps="60", options=["--grid", "3x4"]) == 0
    assert not checkpoint.exists()
    one, other = (encoder(folder).model.state_dict() for folder in (whole, halved))
    assert all(one[name].equal(other[name]) for name in one)


def test_bad_input(tmp_path, capsys):
    touches(tmp_path / "a.npz")
    paths = recordings(tmp_path, suffix="npz")
    (tmp_path / "other").mkdir()
    other = recordings(tmp_path / "other", count=1, suffix="npz", taxels=6)
    (tmp_path / "none").mkdir()
    grid = ["--grid", "3x4"]
    cases = [
        ([paths[0]], grid, "at least 2 trials: with one there is nothing to contrast"),
        ([*paths, *other], grid, "all recordings must be of one sensor, of 12 taxels and 1"),
        (paths, [], "a 'layout' or a 'grid' must be given"),
        (paths, ["--grid", "2x4"], "must have 8 taxels (got 12)"),
        (paths, [*grid, "--init", "root=a"], "'--init' must be left out for recordings"),
        ([tmp_path / "a.npz", paths[0]], grid, "is a file of samples, which must be given alone"),
        ([tmp_path / "a.npz"], [*grid, "--time", "t"], "the options of recordings"),
        ([tmp_path / "none"], grid, "has no recordings"),
        ([tmp_path / "gone.npz"], grid, "does not exist"),
        (["Nothing"], [], "neither a file, nor a folder, nor one of our data sets"),
    ]
    for data, options, text in cases:
        assert run(tmp_path, *data, options=options) == 1, text
        assert text.replace("'layout'", "'--layout'").replace("'grid'", "'--grid'") in (
            capsys.readouterr().err
        )
    touches(tmp_path / "a.npz", trial=None)
    assert run(tmp_path, tmp_path / "a.npz", options=grid) == 1
    assert "must have a 'trial' for each frame" in capsys.readouterr().err
    assert not (tmp_path / "skin.encoder").exists()
    assert main(["pretrain", str(paths[0]), "--out", str(tmp_path)]) == 1
    assert "must be a file to write" in capsys.readouterr().err


def test_help_names_the_next_step(capsys):
    with pytest.raises(SystemExit):
        main(["pretrain", "--help"])
    said = capsys.readouterr().out
    assert "tactile compare touches.npz --grid 28x50 --rest 10 --encoder mat.encoder" in said
