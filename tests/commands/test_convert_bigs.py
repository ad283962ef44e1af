import subprocess
import sys

import numpy as np
import pytest
from bigs_files import readings, values, write_npz

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.datasets import BiGS
from torch_geometric_tactile.io import read_recording


@pytest.fixture
def source(tmp_path):
    """A folder with three grasps by our names."""
    folder = tmp_path / "in"
    folder.mkdir()
    for i in range(3):
        content = {**readings(seed=i), **values(trial=i, success=i % 2)}
        write_npz(folder / f"g{i}.npz", content)
    return folder


def run(*arguments):
    return main(["convert", "bigs", *map(str, arguments)])


def test_convert_makes_what_the_data_set_reads(source, tmp_path, capsys):
    assert run(source, tmp_path / "out", "--npz") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{tmp_path / 'out' / 'g0.npz'}: Recording(num_frames=60, ")
    assert lines[-1] == f"3 of 3 grasps are in '{tmp_path / 'out'}'"
    dataset = BiGS(tmp_path / "out", until=None)
    assert dataset.y.view(3, 60)[:, 0].tolist() == [0, 1, 0]
    assert np.array_equal(dataset.x[60:120], readings(seed=1)["electrodes"])


def test_hdf5_by_default(source, tmp_path):
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    assert run(source / "g1.npz", source / "g2.npz", tmp_path / "out") == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["g1.h5", "g2.h5"]
    assert read_recording(tmp_path / "out" / "g1.h5").label == "success"


def test_every_file_is_tried_and_what_was_written_is_kept(source, tmp_path, capsys):
    cut = (source / "g0.npz").read_bytes()
    (source / "g0.npz").write_bytes(cut[: len(cut) // 2])
    write_npz(source / "g1\x1b[2J.npz", {**readings(), **values(success=3)})
    assert run(source, tmp_path / "gone.npz", tmp_path / "out", "--npz") == 1
    out, err = capsys.readouterr()
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["g1.npz", "g2.npz"]
    assert out.splitlines()[-1] == f"2 of 5 grasps are in '{tmp_path / 'out'}'"
    errors = err.splitlines()
    assert len(errors) == 3
    assert "g0.npz' is not a complete npz file" in errors[0]
    assert r"g1\x1b[2J.npz': 'success' must be a truth value" in errors[1]
    assert "gone.npz' does not exist" in errors[2]


def test_cut_at_any_byte_is_an_error_that_names_the_file(source, tmp_path, capsys):
    whole = (source / "g0.npz").read_bytes()
    folder = tmp_path / "cut"
    folder.mkdir()
    sizes = [*range(0, len(whole), len(whole) // 40), len(whole) - 1]
    for size in sizes:
        (folder / f"cut{size}.npz").write_bytes(whole[:size])
    assert run(folder, tmp_path / "out", "--npz") == 1
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == len(sizes)
    assert all(f"cut{size}.npz'" in "\n".join(errors) for size in sizes)
    assert not (tmp_path / "out").exists()


def test_options_state_names_orders_units_and_rates(tmp_path):
    arrays = readings(seed=4)
    content = {
        "a": arrays["electrodes"][:, :, 0],
        "b": arrays["electrodes"][:, :, 1],
        "c": arrays["electrodes"][:, :, 2],
        "t": arrays["time"] * 1e6,
        "q": np.rad2deg(arrays["robot_joint"]).reshape(180, 7),
        "pac": arrays["pac"][:, :, :11],
        "lift": 5.2e6,
    }
    path = write_npz(tmp_path / "box_3_0.npz", content)
    status = run(
        *(path, tmp_path / "out", "--npz", "--field", "electrodes=a | b | c [frame electrode]"),
        *("--field", "time=t", "--time-unit", "us", "--field", "pickup_time=lift"),
        *("--field", "robot_joint=q [(frame step) joint]", "--angle-unit", "deg"),
        *("--rate-of", "pac=1100", "--value", "session=may"),
        *("--pattern", r"(?P<object>.+)_(?P<trial>\d+)_(?P<success>[01])"),
    )
    assert status == 0
    rec = read_recording(tmp_path / "out" / "box_3_0.npz")
    assert np.array_equal(rec.tactile, arrays["electrodes"])
    assert np.allclose(rec.extra["robot_joint"], arrays["robot_joint"], atol=1e-5)
    assert rec.extra["pac"].shape == (60, 3, 11)
    assert rec.label == "failure"
    assert rec.meta["session"] == "may"
    assert rec.meta["pickup_time"] == pytest.approx(5.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--field", "electrodes"], r"'--field' must be OURS=THEIRS, once per name \(got 'elec"),
        (["--field", "pac=a", "--field", "pac=b"], r"once per name \(got 'pac=b'\)"),
        (["--field", "taxels=a"], r"'fields' must have keys among"),
        (["--value", "pickup_time=x"], r"'--value' must have a number \(got 'x'\)"),
        (["--rate-of", "pac=fast"], r"'--rate-of' must have a number \(got 'fast'\)"),
        (["--rate", "nan"], r"'rate' must be a positive rate"),
        (["--pattern", "("], r"'pattern' must be a regular expression"),
    ],
)
def test_wrong_options_are_told_before_anything_is_written(options, message, source, tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TACTILE_TRACEBACK", "1")
        with pytest.raises(ValueError, match=message):
            run(source, tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["b.npz", "b.h5", "notes"])
def test_folder_that_is_a_file(name, source, tmp_path, capsys):
    if name == "notes":
        (tmp_path / name).write_text("dry")
    assert run(source / "g0.npz", tmp_path / name, "--npz") == 1
    assert f"'OUT_DIR' must be a folder (got the file '{tmp_path / name}')" in (
        capsys.readouterr().err
    )
    assert not (tmp_path / name).is_dir()


def test_grasps_that_do_not_tell_when_pick_up_begins_are_counted(source, tmp_path, capsys):
    content = {**readings(), **values()}
    del content["pickup_time"]
    for i in (3, 4):
        write_npz(source / f"g{i}.npz", {**content, "trial": i})
    assert run(source, tmp_path / "out", "--npz") == 0
    said = capsys.readouterr().err
    assert "warning: 2 grasps have no pick-up time" in said
    assert "--field pickup_time=NAME or --ends-after-pickup SECONDS" in said
    assert run(source, tmp_path / "out", "--npz", "--ends-after-pickup", "2") == 0
    assert not capsys.readouterr().err


def test_names_that_would_overwrite_each_other(source, tmp_path, capsys):
    (tmp_path / "more").mkdir()
    write_npz(tmp_path / "more" / "g1.npz", {**readings(), **values()})
    assert run(source, tmp_path / "more", tmp_path / "out", "--npz") == 1
    assert "grasps must have different file names (got" in capsys.readouterr().err
    assert run(source, source, "--npz") == 1
    assert "'OUT_DIR' must not be the folder of" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert run(tmp_path / "empty", tmp_path / "out") == 1
    assert (
        "empty' must hold grasps with one of .h5, .hdf5, .npz (got none)" in capsys.readouterr().err
    )


def test_help_has_examples_and_needs_no_torch():
    code = (
        "import sys; from torch_geometric_tactile.cli import main\n"
        "try: main(['convert', 'bigs', '--help'])\n"
        "except SystemExit: sys.exit('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "usage: tactile convert bigs " in done.stdout
    assert "tactile convert bigs grasps/*.h5 bigs/" in done.stdout


def test_a_recording_is_still_converted(tmp_path, capsys):
    from bigs_files import grasp

    from torch_geometric_tactile.io._recording_npz import write_npz as write_recording

    write_recording(grasp(), tmp_path / "bigs.npz")
    assert main(["convert", str(tmp_path / "bigs.npz"), str(tmp_path / "b.npz")]) == 0
    assert read_recording(tmp_path / "b.npz").extra["pac"].shape == (60, 3, 22)
