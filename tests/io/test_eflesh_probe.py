import numpy as np
import pytest

from torch_geometric_tactile.io import read_eflesh_probe, read_recording
from torch_geometric_tactile.io.recording_files import recording_format

SENSOR = "0.0,1,2,3,4,5,6\n0.5,7,8,9,10,11,12\n1.0,1,1,1,1,1,1\n"
STATES = "0.01,315,-100,288,-1\n0.51,315,-100,287.5,4.25\n1.01,315,-100,287,0\n"


@pytest.fixture
def write(tmp_path):
    """Writes the files of a run, and returns its folder."""

    def write(sensor=SENSOR, states=STATES):
        (tmp_path / "sensor.csv").write_text(sensor)
        (tmp_path / "states.csv").write_text(states)
        return tmp_path

    return write


def test_read_by_hand(write):
    recording = read_eflesh_probe(write())
    assert recording.time.tolist() == [0.0, 0.5, 1.0]
    assert recording.tactile[1].tolist() == [[7, 8, 9], [10, 11, 12]]
    np.testing.assert_array_equal(recording.extra["force"], [np.nan, 4.25, 0])
    assert recording.extra["probe"].tolist()[1] == [315, -100, 287.5]
    assert recording.meta["sensor"] == "eflesh"
    assert "unit" not in recording.meta


def test_a_folder_is_read_as_any_recording(write):
    folder = write()
    assert recording_format(folder) == "eFlesh probe"
    assert repr(read_recording(folder)) == repr(read_eflesh_probe(folder))
    with pytest.raises(ValueError, match="'forces' must be an option of the format eFlesh probe"):
        read_recording(folder, forces=True)


def test_single_frame(write):
    assert read_eflesh_probe(write("0,1,2,3\n", "5,1,2,3,4\n")).num_frames == 1


@pytest.mark.parametrize(
    ("sensor", "states", "text"),
    [
        (SENSOR[:-16], STATES, r"as many rows in sensor.csv as in states.csv \(got 2 and 3\)"),
        (SENSOR, STATES.replace("0.51", "1.005"), r"less than a frame, 0.5 s \(got 0.505 s in li"),
        (SENSOR.replace("0.5,", "0.0,"), STATES, "'time' must increase|less than a frame"),
        ("0,1,2\n", STATES, r"three readings of each magnetometer \(got 3 columns\)"),
        (SENSOR, "0,1,2,3\n", r"must have the columns time, x, y, z, force \(got 4\)"),
        (SENSOR, STATES.replace("288", ""), r"states.csv', line 1, column 4"),
        (SENSOR.replace("9", "inf"), STATES, r"sensor.csv', line 2, column 4: .* finite"),
        ("time,x,y,z\n" + SENSOR, STATES, r"sensor.csv', line 1"),
        (",".join(["0"] * 1003) + "\n", STATES, r"at most 1000 columns \(got 1003\)"),
    ],
)
def test_bad_files(sensor, states, text, write):
    with pytest.raises(ValueError, match=text):
        read_eflesh_probe(write(sensor, states))


@pytest.mark.parametrize("name", ["sensor.csv", "states.csv"])
def test_missing_file(name, write):
    folder = write()
    (folder / name).unlink()
    with pytest.raises(FileNotFoundError, match=rf"{name}' does not exist; give the folder of a"):
        read_eflesh_probe(folder)
    with pytest.raises(FileNotFoundError, match="give the path of a recording"):
        read_recording(folder)


def test_published_runs(eflesh_probe):
    found = {}
    for folder in sorted(eflesh_probe.glob("*_force/*")):
        recording = read_eflesh_probe(folder)
        force = recording.extra["force"]
        found[folder.name] = (recording.tactile.shape, int(np.isnan(force).sum()))
        assert np.nanmin(force) == 0
    assert found == {
        "20250401_014340_probe": ((3600, 5, 3), 1740),
        "20250401_015037_probe": ((3600, 5, 3), 1740),
        "20250401_015717_probe": ((3600, 5, 3), 1740),
        "20250416_200533_probe": ((7200, 10, 3), 3475),
        "20250416_201911_probe": ((7200, 10, 3), 3575),
    }
