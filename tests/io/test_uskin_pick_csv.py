import numpy as np
import pytest
from published_files import USKIN_READINGS, uskin_readings, uskin_trial, write_csv

from torch_geometric_tactile.io import read_uskin_pick


def test_trial_by_hand(tmp_path):
    rec = read_uskin_pick(uskin_trial(tmp_path / "data_sample", frames=8, obj="11", dropped=1))
    assert (rec.tactile.shape, rec.joint.shape) == ((8, 32, 3), (8, 7))
    assert rec.tactile[0, 0].tolist() == [16000, 16100, 16200]  # taxel 1 of the first sensor
    assert rec.tactile[4, 15].tolist() == [20501, 20601, 20701]
    assert rec.tactile[4, 16].tolist() == [36001, 36101, 36201]  # taxel 1 of the second
    assert rec.time.tolist() == [t / 40 for t in range(8)]
    assert rec.joint[1] == pytest.approx(0.001 + 0.01 * np.arange(7), abs=1e-6)
    assert rec.extra["finger"][1] == pytest.approx(0.071)
    assert rec.extra["end_effector"][1] == pytest.approx(0.001 + 0.01 * np.arange(15, 22))
    assert rec.meta == {
        "sensor": "XELA uSkin",
        "unit": "count",
        "rate": 40.0,
        "object": "11",
        "seen": 1,
        "dropped": 1,
    }


def test_repeated_frames_are_left_out_with_their_times(tmp_path):
    folder = uskin_trial(tmp_path, frames=10)
    rec = read_uskin_pick(folder, repeats=False)
    assert rec.time.tolist() == [0, 0.1, 0.2]
    assert rec.tactile[:, 0, 0].tolist() == [16000, 16001, 16002]
    assert rec.joint[:, 0] == pytest.approx([0, 0.004, 0.008], abs=1e-6)
    assert rec.meta["stale_rows"] == 7
    # A change of one sensor is one, also of one channel of one taxel.
    rows = uskin_readings(10, 20000, every=100)
    rows[6:, 47] += 1
    write_csv(folder / "xela_sensor2.csv", USKIN_READINGS, rows)
    assert read_uskin_pick(folder, repeats=False).time.tolist() == [0, 0.1, 0.15, 0.2]


def test_notes_with_commas_and_columns_in_another_order(tmp_path):
    folder = uskin_trial(tmp_path, notes='"Side to Side motion, loose grip, high slip and drop!"')
    write_csv(folder / "xela_sensor1.csv", USKIN_READINGS[::-1], uskin_readings(8)[:, ::-1])
    rec = read_uskin_pick(folder)
    assert rec.meta["object"] == "7"
    assert rec.tactile[0, 0].tolist() == [16000, 16100, 16200]


@pytest.mark.parametrize("longer", [0, 1, 5])
def test_files_are_cut_to_the_shortest(tmp_path, longer):
    assert read_uskin_pick(uskin_trial(tmp_path, longer=longer)).num_frames == 8


def test_files_of_other_lengths_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"14 in xela_sensor2.csv, 8 in robot_state.csv\): is one"):
        read_uskin_pick(uskin_trial(tmp_path, longer=6))


@pytest.mark.parametrize("name", ["meta_data", "robot_state", "xela_sensor1", "xela_sensor2"])
def test_missing_file_is_named(tmp_path, name):
    (uskin_trial(tmp_path) / f"{name}.csv").unlink()
    with pytest.raises(FileNotFoundError, match=rf"{name}.csv' does not exist; put all files"):
        read_uskin_pick(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rate": 0.0}, r"'frequency_hz' must be up to 1000 \(got 0.0\)"),
        ({"rate": 1e4}, r"'frequency_hz' must be up to 1000 \(got 10000.0\)"),
        ({"dropped": 2}, r"'dropped' must be 0 or 1 \(got 2.0\)"),
        ({"obj": " "}, r"must name an object in 'object_name' \(got ' '\)"),
    ],
)
def test_wrong_metadata(tmp_path, change, message):
    with pytest.raises(ValueError, match=rf"meta_data.csv'.*{message}"):
        read_uskin_pick(uskin_trial(tmp_path, **change))


def test_two_lines_of_metadata(tmp_path):
    path = uskin_trial(tmp_path) / "meta_data.csv"
    path.write_text(path.read_text() + path.read_text().splitlines()[1] + "\n")
    with pytest.raises(ValueError, match=r"must have one line below its header \(got 2\)"):
        read_uskin_pick(tmp_path)


def test_wrong_cell_and_missing_column(tmp_path):
    path = uskin_trial(tmp_path) / "xela_sensor2.csv"
    text = path.read_text()
    path.write_text(text.replace("36000.0", "inf", 1))
    with pytest.raises(ValueError, match=r"xela_sensor2.csv', line 2, column 1: 'txl1_x' must be"):
        read_uskin_pick(tmp_path)
    path.write_text(text.replace("txl16_z", "txl17_z"))
    with pytest.raises(ValueError, match=r"must have the column 'txl16_z' \(1 of 48"):
        read_uskin_pick(tmp_path)
