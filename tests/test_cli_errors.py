r"""Hostile files and arguments on the command line end in one line that explains the error, without
a traceback and without an endless wait.
"""

import csv
import errno
import io
import os
import re
import sys

import numpy as np
import pytest

from torch_geometric_tactile import cli
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_recording

SUFFIXES = ("h5", "npz", "csv", "json", "jsonl", "txt", "ckpt", "predictor")
CONTENTS = {
    "empty": b"",
    "zeros": bytes(5000),
    "garbage": np.random.default_rng(0).bytes(3000),
    "nested": b"[" * 100_000,
    "text": "a: b\n- \u202e {[\n\x1b[2J".encode(),
    "number": b"3\n",
}
NO_TEXT = os.fsdecode(b"bad\xff\xfe.npz")
EVIL = "a\x1b[2J\nb\u202e$"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def is_explained(status, capsys):
    """One line for the error and one for how to learn more; nothing that a terminal obeys."""
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if not line.startswith("(set TACTILE_TRACEBACK=1")]
    return status == 1 and len(lines) == 1 and re.fullmatch("tactile: error: [ -~]+", lines[0])


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", CONTENTS)
def test_files_that_are_none_of_ours(content, suffix, folder, capsys):
    path = folder / f"{content}.{suffix}"
    path.write_bytes(CONTENTS[content])
    if suffix == "h5":
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    for arguments in (
        ["inspect", str(path), "--no-picture"],
        ["convert", str(path), "out.npz"],
        ["predict", str(path), "--out", "out.csv"],
    ):
        assert is_explained(cli.main(arguments), capsys), arguments
    assert [found.name for found in folder.iterdir()] == [path.name]


@pytest.mark.parametrize(
    "name",
    [
        "pipe.npz",
        "loop.npz",
        "folder.npz",
        "gone.npz",
        "",
        "a\0b.npz",
        "/dev/zero",
        "x" * 5000,
        ".",
    ],
)
def test_names_of_no_file(name, folder, capsys):
    os.mkfifo("pipe.npz")  # whoever opens it waits for a writer
    os.symlink("loop.npz", "loop.npz")
    (folder / "folder.npz").mkdir()
    for arguments in (
        ["inspect", name, "--no-picture"],
        ["convert", name, "out.npz"],
        ["predict", name, "--out", "out.csv"],
    ):
        assert is_explained(cli.main(arguments), capsys), arguments


@pytest.mark.parametrize(
    "out", ["", "/", "/proc/x.npz", "a.npz/x.npz", "x" * 5000 + ".npz", "a.xyz"]
)
def test_places_that_nothing_can_be_written_to(out, folder, capsys):
    write_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3))), "a.npz")
    assert is_explained(cli.main(["convert", "a.npz", out]), capsys)
    assert os.listdir() == ["a.npz"]


@pytest.mark.parametrize("option", ["--trials", "--jobs", "--max-attempts", "--seed"])
@pytest.mark.parametrize(
    "number", ["1e400", "-1", "nan", "9" * 30, "9" * 5000, "", "\u0661", "1_0", "0x10", "1.5"]
)
def test_numbers_that_are_none_or_too_large(option, number, capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["simulate", "--out", "grasps", option, number])
    assert f"argument {option}: must" in capsys.readouterr().err


def test_text_of_a_recording_is_shown_escaped(folder, capsys):
    recording = Recording(
        [0.0, 0.1],
        np.zeros((2, 4, 3)),
        joint=np.zeros((2, 1)),
        label=EVIL,
        meta={EVIL: EVIL, "joint_names": [EVIL], "unit": "count"},
        privileged={EVIL: np.zeros(2)},
    )
    path = folder / f"{EVIL}.npz"
    write_recording(recording, path)
    assert cli.main(["inspect", path.name, "--no-picture"]) == 0
    lines = capsys.readouterr().out.split("\n")
    assert all(map(str.isprintable, lines))
    assert r"label        a\x1b[2J\nb\u202e$" in lines
    assert r"file         a\x1b[2J\nb\u202e$.npz" in lines
    assert cli.main(["convert", path.name, "out.csv"]) == 0
    shown = capsys.readouterr()
    assert all(map(str.isprintable, (shown.out + shown.err).split("\n")))


def test_error_is_one_line_whatever_a_name_is(folder, capsys):
    assert cli.main(["inspect", "tactile: fine\n\x1b[2K\x9b\u2067.npz"]) == 1
    first, second, end = capsys.readouterr().err.split("\n")
    assert first.startswith(r"tactile: error: 'tactile: fine \x1b[2K\x9b\u2067.npz' does not exist")
    assert second == "(set TACTILE_TRACEBACK=1 for the traceback)"
    assert end == ""


def test_name_that_is_no_text_is_shown(folder, capsys):
    write_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3))), NO_TEXT)
    assert cli.main(["inspect", NO_TEXT, "--no-picture"]) == 0
    assert r"file         bad\udcff\udcfe.npz" in capsys.readouterr().out


def test_name_that_is_no_text_is_printed_by_the_process(folder, monkeypatch):
    write_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3))), NO_TEXT)
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "argv", ["tactile", "convert", NO_TEXT, "größe.npz"])
    assert cli.main() == 0
    assert rb"gr\xf6\xdfe.npz: Recording(" in out.buffer.getvalue()


@pytest.fixture
def recording(folder):
    write_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3))), "a.npz")
    return ["inspect", "a.npz", "--no-picture"]


def test_reader_of_the_output_that_has_what_it_wanted(recording, monkeypatch, capsys):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert cli.main(recording) == 0
        assert not capsys.readouterr().err


class Full(io.StringIO):
    """An output to a full disk."""

    def flush(self):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_output_on_a_full_disk(recording, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", Full())
    assert cli.main(recording) == 1
    assert "tactile: error: [Errno 28] No space left on device" in capsys.readouterr().err


def test_broken_pipe_of_something_else_is_an_error(monkeypatch, capsys):
    def run(arguments):
        raise BrokenPipeError(errno.EPIPE, "a worker has gone")

    monkeypatch.setattr(cli, "_run", run)
    assert is_explained(cli.main(["inspect"]), capsys)


def test_closed_output_and_errors(recording, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert cli.main(recording) == 0
    assert cli.main(["inspect", "gone.npz"]) == 1


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (MemoryError(), 1, "tactile: error: not enough memory\n"),
        (OSError(), 1, "tactile: error: OSError\n"),
        (KeyboardInterrupt("stopped;\x1b 3 trials"), 130, "tactile: stopped;\\x1b 3 trials\n"),
        (KeyboardInterrupt(), 130, "tactile: stopped\n"),
    ],
)
def test_what_ends_a_command(error, status, text, monkeypatch, capsys):
    def run(arguments):
        raise error

    monkeypatch.setattr(cli, "_run", run)
    assert cli.main(["inspect"]) == status
    assert capsys.readouterr().err.startswith(text)


@pytest.mark.parametrize("error", [ValueError("bad"), OSError("gone")])
def test_traceback_on_request(error, monkeypatch):
    def run(arguments):
        raise error

    monkeypatch.setattr(cli, "_run", run)
    monkeypatch.setenv("TACTILE_TRACEBACK", "1")
    with pytest.raises(type(error), match=str(error)):
        cli.main(["inspect"])


def test_fault_of_ours_is_not_hidden(monkeypatch):
    def run(arguments):
        raise AssertionError("our fault")

    monkeypatch.setattr(cli, "_run", run)
    with pytest.raises(AssertionError, match="our fault"):
        cli.main(["inspect"])


def test_predictions_are_safe_to_open_in_a_spreadsheet(folder):
    import torch

    from torch_geometric_tactile import Predictor
    from torch_geometric_tactile.nn import TactileFNN
    from torch_geometric_tactile.sensors import grid

    names = ("=1+1", "-1", "@now", "a\nb")
    model = TactileFNN(4, 4, widths=(5,), pools=(1,))
    with torch.no_grad():
        list(model.parameters())[-1].copy_(torch.tensor([50.0, 0.0, 0.0, 0.0]))
    Predictor(model, grid(2, 2, 0.01), class_names=names, num_channels=3).save("a.predictor")
    write_recording(Recording([0.0, 0.1], np.zeros((2, 4, 3))), "=a.npz")
    assert cli.main(["predict", "a.predictor", "=a.npz", "--out", "out.csv"]) == 0
    with open("out.csv", newline="", encoding="utf-8") as file:
        head, first, _ = csv.reader(file)
    assert head == [
        "recording", "frame", "time", "prediction", "p_=1+1", "p_-1", "p_@now", "p_a\nb"
    ]  # fmt: skip
    assert first[:5] == ["'=a.npz", "0", "0.000000", "'=1+1", "1.000000"]
