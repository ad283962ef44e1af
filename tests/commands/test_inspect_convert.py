import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from torch_geometric_tactile.cli import build_parser, main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._recording_npz import read_npz, write_npz
from torch_geometric_tactile.io._xela_message import format_xela_message


@pytest.fixture
def recording(tmp_path, monkeypatch):
    """A file with a recording; the current folder is an empty one."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    tactile = np.arange(60.0).reshape(10, 2, 3)
    write_npz(
        Recording(np.arange(10) / 10, tactile, label="cup", meta={"unit": "count"}),
        tmp_path / "cup.npz",
    )
    return tmp_path / "cup.npz"


def test_help_of_both_commands_needs_no_torch():
    code = (
        "import sys; from torch_geometric_tactile.cli import build_parser; "
        "print(build_parser().format_help()); sys.exit('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "    inspect " in done.stdout
    assert "    convert " in done.stdout


def test_inspect_reads_csv_files_with_names_of_the_users_own(tmp_path, capsys):
    (tmp_path / "glove.csv").write_text(
        "time,pad_0,pad_1,bend,grasp\n0,3,4,0.5,pinch\n1,5,6,0.5,open\n"
    )
    options = ["--tactile", r"pad_\d", "--joint", "bend", "--label", "grasp", "--unit", "count"]
    assert main(["inspect", str(tmp_path / "glove.csv"), "--no-picture", *options]) == 0
    facts = capsys.readouterr().out
    assert "2 of 1 channels" in facts
    assert "3 to 6 counts" in facts
    assert main(["inspect", str(tmp_path / "glove.csv"), "--no-picture"]) == 1
    assert "'grasp' must be a number" in capsys.readouterr().err


def test_inspect_prints_and_draws_in_the_current_folder(recording, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    assert main(["inspect", str(recording)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"file         {recording}"
    assert lines[1] == "format       npz"
    assert lines[2] == "frames       10 in 0.9 s, 10 per second"
    assert lines[-1] == "picture      cup_inspect.png"
    assert (tmp_path / "here/cup_inspect.png").read_bytes().startswith(b"\x89PNG")


def test_inspect_draws_where_it_is_told(recording, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    assert main(["inspect", str(recording), "--out", str(tmp_path / "new/a.png")]) == 0
    assert (tmp_path / "new/a.png").is_file()
    assert list((tmp_path / "here").iterdir()) == []


def test_inspect_without_a_picture_needs_no_matplotlib(recording, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["inspect", str(recording), "--no-picture"]) == 0
    assert "label        cup" in capsys.readouterr().out
    assert list((tmp_path / "here").iterdir()) == []


def test_inspect_prints_before_it_misses_matplotlib(recording, capsys, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["inspect", str(recording)]) == 1
    output = capsys.readouterr()
    assert "label        cup" in output.out
    assert 'pip install "torch-geometric-tactile[viz]"' in output.err


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.h5", None, "gone.h5' does not exist"),
        ("a.mat", b"a", "a.mat' must end in one of .h5, .hdf5"),
        ("a.npz", b"PK\x03\x04abc", "a.npz' is not a complete npz file (is it truncated?)"),
        ("a.csv", b"1,2,3\n", "a.csv', line 1 must have 1168 cells for 384 taxels"),
        ("a.json", b'{"message": 3,', "a.json', line 1: the message that begins here"),
    ],
)
def test_inspect_explains_errors(tmp_path, capsys, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert main(["inspect", str(tmp_path / name), "--no-picture"]) == 1
    output = capsys.readouterr()
    assert f"tactile: error: '{tmp_path}" in output.err
    assert message in output.err
    assert output.out == ""


def test_inspect_refuses_a_picture_that_is_no_png(recording, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    assert main(["inspect", str(recording), "--out", "a.jpg"]) == 1
    assert "'path' must end in '.png' (got 'a.jpg')" in capsys.readouterr().err


def test_inspect_takes_one_of_picture_and_none():
    with pytest.raises(SystemExit, match="2"):
        build_parser().parse_args(["inspect", "a.h5", "--out", "a.png", "--no-picture"])


@pytest.mark.parametrize("suffix", ["h5", "csv", "npz", "jsonl"])
def test_convert_keeps_the_readings(recording, tmp_path, capsys, suffix):
    if suffix == "h5":
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    target = tmp_path / f"out.{suffix}"
    assert main(["convert", str(recording), str(target)]) == 0
    assert capsys.readouterr().out.startswith(f"{target}: Recording(num_frames=10, num_taxels=2")
    assert np.array_equal(read_recording(target).tactile, read_npz(recording).tactile)


def test_convert_warns_of_what_is_lost(recording, tmp_path, caplog):
    assert main(["convert", str(recording), str(tmp_path / "out.csv")]) == 0
    assert "out.csv' is CSV and cannot store label, unit" in caplog.text


def test_convert_forces(tmp_path):
    message = format_xela_message(np.ones((1, 3)), 1, 0.0, forces=np.full((1, 3), 0.5))
    (tmp_path / "a.json").write_text(json.dumps(message))
    source = str(tmp_path / "a.json")
    assert main(["convert", source, str(tmp_path / "counts.npz")]) == 0
    assert main(["convert", source, str(tmp_path / "forces.npz"), "--forces"]) == 0
    assert read_npz(tmp_path / "counts.npz").tactile.tolist() == [[[1, 1, 1]]]
    assert read_npz(tmp_path / "forces.npz").tactile.tolist() == [[[0.5, 0.5, 0.5]]]
    assert read_npz(tmp_path / "forces.npz").meta["unit"] == "newton"


def test_convert_explains_errors(recording, tmp_path, capsys):
    assert main(["convert", str(recording), str(tmp_path / "a.xyz")]) == 1
    assert "must end in one of .h5, .hdf5, .npz, .mcap, .csv" in capsys.readouterr().err
    assert main(["convert", str(recording), str(tmp_path / "a.npz"), "--forces"]) == 1
    assert "'forces' must be an option of the format npz: allow_l" in capsys.readouterr().err
    assert not (tmp_path / "a.npz").exists()


def converted(tmp_path, text, *options):
    (tmp_path / "in.csv").write_text(text)
    assert main(["convert", str(tmp_path / "in.csv"), str(tmp_path / "out.npz"), *options]) == 0
    return read_npz(tmp_path / "out.npz")


def test_convert_csv_with_names_of_its_own(tmp_path):
    text = "stamp_ms,pad_b,pad_a,bend,wet,grasp\n9,1,2,0.5,0,mug\n"
    options = ["--tactile", "pad_a", "--tactile", "pad_b", "--joint", "ben.", "--time", "stamp_ms"]
    rec = converted(tmp_path, text, *options, "--label", "grasp", "--unit", "count")
    assert rec.tactile.tolist() == [[[2], [1]]]
    assert rec.joint.tolist() == [[0.5]]
    meta = {"unit": "count", "column_names": {"joint": ["bend"]}}
    assert (rec.time.tolist(), rec.label, rec.meta) == ([0.009], "mug", meta)
    options = ["--tactile", "pad_.*", "--num-channels", "2", "--rate", "10"]
    assert converted(tmp_path, text, *options).tactile.tolist() == [[[1, 2]]]
    ignored = [f"--ignore={name}" for name in ("stamp_ms", "grasp", "wet")]
    options = [*ignored, "--joint", "bend", "--rate", "10"]
    assert converted(tmp_path, text, *options).tactile.tolist() == [[[1], [2]]]
    rec = converted(tmp_path, "a,b\n9,1\n", "--time", "a", "--time-unit", "us")
    assert rec.time.tolist() == [9e-6]


def test_convert_csv_without_names(tmp_path):
    options = ["--num-taxels", "1", "--num-channels", "2", "--num-joints", "1"]
    rec = converted(tmp_path, "1,2,0.5\n3,4,0.5\n", *options, "--rate", "10")
    assert rec.tactile.tolist() == [[[1, 2]], [[3, 4]]]
    assert rec.time.tolist() == [0.0, 0.1]
    rec = converted(tmp_path, "0,1,2\n", *options, "--no-header")
    assert rec.joint.tolist() == [[2]]


@pytest.mark.parametrize(
    ("name", "content", "options", "message"),
    [
        ("a.csv", b"0,1,2\n5,6,7\n", ["--num-taxels", "1"], "pandas writes for columns"),
        ("a.csv", b"x_0,taxel_0_x\n5,6\n", [], "(got 'x_0')"),
        ("a.csv", b"t,b\n5," + b"9" * 5000 + b"\n", [], "must be finite"),
        ("a.csv", b"Send time,Receive time\n", [], "the column 'Message number'"),
        ("a.csv", b"clock,a\n0,1\n", [], "a time column (got clock, a)"),
        ("a.npz", b"PK\x05\x06" + bytes(18), [], "a.npz'"),
        ("a.json", b'{"a":' * 100_000, [], "line 1"),
        ("a.json", b'{"message": ' + b"9" * 5000 + b"}", [], "line 1"),
    ],
)
def test_convert_explains_bad_files(tmp_path, capsys, name, content, options, message):
    (tmp_path / name).write_bytes(content)
    assert main(["convert", str(tmp_path / name), str(tmp_path / "out.npz"), *options]) == 1
    error = capsys.readouterr().err
    assert f"tactile: error: '{tmp_path / name}'" in error
    assert message in error
    assert not (tmp_path / "out.npz").exists()


def test_inspect_lists_the_actions_of_a_demonstration(tmp_path, capsys):
    rec = Recording([0, 0.1], np.zeros((2, 1, 1)), action=[[0.5, np.nan], [20, np.nan]])
    write_npz(rec, tmp_path / "a.npz")
    assert main(["inspect", str(tmp_path / "a.npz"), "--no-picture"]) == 0
    assert (
        "actions      2\n             0: 0.5 to 20\n             1: none\n"
        in capsys.readouterr().out
    )
    write_npz(replace(rec, meta={"action_names": ["grip", "lift"]}), tmp_path / "b.npz")
    assert main(["inspect", str(tmp_path / "b.npz"), "--no-picture"]) == 0
    assert "grip: 0.5 to 20\n" in capsys.readouterr().out
