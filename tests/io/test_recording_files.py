import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.io._xela_message import format_xela_message
from torch_geometric_tactile.io.recording_files import recording_format

XELA_LOG = "Receive time,Send time,Message number,1X,1Y,1Z\n0,1,1,7,8,9\n"


def plain():
    return Recording([0.0, 0.5], np.arange(12).reshape(2, 2, 3), joint=[[0.0], [0.25]])


@pytest.mark.parametrize("suffix", [".h5", ".hdf5", ".npz", ".csv", ".NPZ"])
def test_written_files_read_back_equal(suffix, assert_same, tmp_path):
    if suffix in (".h5", ".hdf5"):
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    write_recording(plain(), tmp_path / f"a{suffix}")
    assert_same(read_recording(tmp_path / f"a{suffix}"), plain())


@pytest.mark.parametrize("suffix", [".jsonl", ".ndjson"])
def test_written_messages_read_back_equal(suffix, tmp_path):
    write_recording(plain(), tmp_path / f"a{suffix}")
    assert np.array_equal(read_recording(tmp_path / f"a{suffix}").tactile, plain().tactile)


def test_content_decides_between_kinds_of_csv(tmp_path):
    (tmp_path / "log.csv").write_text(XELA_LOG)
    (tmp_path / "bom.csv").write_text("\ufeff" + XELA_LOG)
    (tmp_path / "wide.csv").write_text("7,8,9\n")
    assert recording_format(tmp_path / "log.csv") == "XELA log CSV"
    assert recording_format(tmp_path / "bom.csv") == "XELA log CSV"
    assert recording_format(tmp_path / "wide.csv") == "wide CSV"
    assert read_recording(tmp_path / "log.csv").tactile.tolist() == [[[7, 8, 9]]]
    wide = read_recording(tmp_path / "wide.csv", num_taxels=1, num_joints=0)
    assert wide.tactile.tolist() == [[[7, 8, 9]]]


def test_content_overrules_a_wrong_suffix(assert_same, tmp_path):
    write_npz(plain(), tmp_path / "a.h5")
    assert recording_format(tmp_path / "a.h5") == "npz"
    assert_same(read_recording(tmp_path / "a.h5"), plain())


def test_options_reach_the_reader(tmp_path):
    import json

    message = format_xela_message(np.ones((1, 3)), 1, 0.0, forces=np.full((1, 3), 0.5))
    (tmp_path / "a.txt").write_text(json.dumps(message))
    assert read_recording(tmp_path / "a.txt").tactile.tolist() == [[[1, 1, 1]]]
    assert read_recording(tmp_path / "a.txt", forces=True).tactile.tolist() == [[[0.5, 0.5, 0.5]]]


def test_unknown_option_names_the_known_ones(tmp_path):
    write_npz(plain(), tmp_path / "a.npz")
    with pytest.raises(ValueError, match=r"'forces' must be an option of the format npz: allow_l"):
        read_recording(tmp_path / "a.npz", forces=True)
    (tmp_path / "a.csv").write_text("1\n")
    with pytest.raises(ValueError, match=r"'forces' .* wide CSV: num_taxels, num_channels, num_jo"):
        read_recording(tmp_path / "a.csv", forces=True)


def test_unknown_suffix(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"a")
    with pytest.raises(
        ValueError, match=r"a.mat' must end in one of .h5, .hdf5, .npz, .mcap, .csv, .jso"
    ):
        read_recording(tmp_path / "a.mat")
    with pytest.raises(
        ValueError, match=r"one of .h5, .hdf5, .npz, .mcap, .csv, .jsonl, .ndjson \(got '.json'\)"
    ):
        write_recording(plain(), tmp_path / "a.json")


@pytest.mark.parametrize(
    "names",
    [
        "1X,1Y,1Z,Message number,Receive time,Send time",  # sorted by pandas
        "index,Receive time,Send time,Message number,1X,1Y,1Z",
        "Send time,Message number,1X,1Y,1Z",
        "Receive_time,Send_time,Message_number,1X,1Y,1Z",
        "timestamp,Receive time,Send time,Message number,1X,1Y,1Z",
        "\ufeff\ufeffSend time,Message number,1X,1Y,1Z",
    ],
)
def test_xela_logs_are_known_by_their_names_in_any_order(names, tmp_path, caplog):
    cells = dict.fromkeys(("receive time", "send time"), "5")
    cells |= {"message number": "1", "1x": "7", "1y": "8", "1z": "9"}
    keys = [name.strip("\ufeff").lower().replace("_", " ") for name in names.split(",")]
    row = ",".join(cells.get(key, "hold") for key in keys)
    (tmp_path / "log.csv").write_text(f"{names}\n{row}\n")
    assert recording_format(tmp_path / "log.csv") == "XELA log CSV"
    recording = read_recording(tmp_path / "log.csv")
    assert recording.tactile.tolist() == [[[7, 8, 9]]]
    assert recording.time.tolist() == [5]
    assert ("columns that are not read: 'index'" in caplog.text) == names.startswith("index")


@pytest.mark.parametrize("names", ["Receive time,Message number,1X", "time,Message number,1X"])
def test_xela_logs_without_the_time_are_refused_unless_columns_are_declared(names, tmp_path):
    (tmp_path / "log.csv").write_text(f"{names}\n0,1,7\n")
    with pytest.raises(ValueError, match=r"must have the column 'Send time'"):
        read_recording(tmp_path / "log.csv")
    options = {"tactile": ["1X"], "time": names.split(",")[0]}
    assert read_recording(tmp_path / "log.csv", **options).tactile.tolist() == [[[7]]]
