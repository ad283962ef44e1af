import numpy as np
import pytest
from bigs_files import readings, values, write_h5, write_npz

from torch_geometric_tactile.io import BiGSFormat, read_bigs

FOREIGN = BiGSFormat(
    fields={
        "electrodes": "bio/elec [frame (finger electrode)]",
        "time": "bio/stamp",
        "pressure": "p1 | p2 | p3",
        "pac": "bio/pac [(frame step) finger]",
        "robot_joint": "arm/q [(frame step) joint]",
        "finger_joint": "hand/q [(frame step) joint]",
        "object_pose": "pose",
        "phase": "phase",
        "slip": "slip",
        "success": "outcome",
    },
    values={"session": "may"},
    pattern=r"(?P<object>.+)-(?P<trial>\d+)",
    time_unit="ms",
    angle_unit="deg",
    length_unit="mm",
    quaternion="xyzw",
    fingers="middle right left",
)


def foreign(arrays, **changes):
    """The same grasp as its holder might keep it."""
    electrodes = arrays["electrodes"][:, :, [1, 2, 0]]
    frames = len(electrodes)
    pac = arrays["pac"][:, [1, 2, 0]]
    pose = arrays["object_pose"]
    content = {
        "bio/elec": electrodes.transpose(0, 2, 1).reshape(frames, 57),
        "bio/stamp": (arrays["time"] * 1e3).round().astype(np.int64),
        "p1": arrays["pressure"][:, 0],
        "p2": arrays["pressure"][:, 1],
        "p3": arrays["pressure"][:, 2],
        "bio/pac": pac.transpose(0, 2, 1).reshape(22 * frames, 3),
        "arm/q": np.rad2deg(arrays["robot_joint"]).reshape(3 * frames, 7),
        "hand/q": np.rad2deg(arrays["finger_joint"]).reshape(3 * frames, 4),
        "pose": np.concatenate([1e3 * pose[:, :3], pose[:, 4:], pose[:, 3:4]], axis=1),
        "phase": arrays["phase"],
        "slip": arrays["slip"].astype(bool),
        "outcome": np.array([[True]]),
        "pickup_time": 5200,
        **changes,
    }
    return {key: value for key, value in content.items() if value is not None}


def check(rec, arrays):
    assert np.array_equal(rec.tactile, arrays["electrodes"])
    assert np.allclose(rec.time, arrays["time"], rtol=0, atol=1e-9)
    assert np.array_equal(rec.extra["pressure"], arrays["pressure"])
    assert np.array_equal(rec.extra["pac"], arrays["pac"])
    assert rec.extra["pac"].dtype == np.int16
    assert np.allclose(rec.extra["robot_joint"], arrays["robot_joint"], atol=1e-5)
    assert np.allclose(rec.extra["finger_joint"], arrays["finger_joint"], atol=1e-5)
    assert np.allclose(rec.privileged["object_pose"], arrays["object_pose"], atol=1e-6)
    assert np.array_equal(rec.privileged["slip"], arrays["slip"])
    names = np.array(rec.meta["phase_names"])[rec.privileged["phase"]]
    assert names.tolist() == arrays["phase"].tolist()


@pytest.mark.parametrize("write", [write_npz, write_h5])
def test_our_names_need_no_format(write, tmp_path):
    if write is write_h5:
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    arrays = readings()
    path = write((tmp_path / "a").with_suffix(".npz"), {**arrays, **values()})
    rec = read_bigs(path)
    check(rec, arrays)
    assert rec.label == "success"
    assert rec.meta == {
        "sensor": "biotac",
        "unit": "count",
        "rate": 100.0,
        "source": "a.npz",
        "object": "cylinder é",
        "trial": 7,
        "session": "may",
        "pickup_time": 5.2,
        "phase_names": ["closing", "lift", "shake"],
    }


@pytest.mark.parametrize("write", [write_npz, write_h5])
def test_other_names_orders_and_units(write, tmp_path):
    if write is write_h5:
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    arrays = readings(seed=3)
    path = tmp_path / ("box-012.npz" if write is write_npz else "box-012.h5")
    rec = read_bigs(write(path, foreign(arrays)), FOREIGN)
    check(rec, arrays)
    assert (rec.label, rec.meta["object"], rec.meta["trial"]) == ("success", "box", 12)
    assert (rec.meta["session"], rec.meta["pickup_time"]) == ("may", 5.2)


def test_attributes_and_texts_of_hdf5(tmp_path):
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    content = {
        "g/e": readings()["electrodes"],
        "@success": False,
        "g@object": "ball",
        "g/e@n": np.int64(3),
        "session": "äpril",
    }
    fields = {"electrodes": "g/e", "success": "@success", "object": "g@object", "trial": "g/e@n"}
    rec = read_bigs(write_h5(tmp_path / "a.h5", content), BiGSFormat(fields=fields))
    assert rec.label == "failure"
    assert (rec.meta["object"], rec.meta["trial"], rec.meta["session"]) == ("ball", 3, "äpril")
    assert rec.time[:3].tolist() == [0, 0.01, 0.02]
    assert "pickup_time" not in rec.meta
    assert rec.extra == {}


def test_a_file_of_electrodes_only(tmp_path):
    path = write_npz(tmp_path / "cup_3_1.npz", {"electrodes": readings()["electrodes"]})
    layout = BiGSFormat(
        pattern=r"(?P<object>.+)_(?P<trial>\d+)_(?P<success>[01])", ends_after_pickup=2.0
    )
    rec = read_bigs(path, layout)
    assert rec.label == "success"
    assert (rec.meta["object"], rec.meta["trial"]) == ("cup", 3)
    assert rec.meta["ends_after_pickup"] == 2.0


def test_other_rates(tmp_path):
    arrays = readings(20)
    content = {
        "electrodes": arrays["electrodes"],
        "time": np.arange(20) / 50,
        "pac": np.arange(20 * 3 * 44).reshape(20, 3, 44),
        **values(pickup_time=0.1),
    }
    path = write_npz(tmp_path / "a.npz", content)
    rec = read_bigs(path, BiGSFormat(rate=50))
    assert rec.extra["pac"].shape == (20, 3, 44)
    with pytest.raises(
        ValueError, match=r"a.npz': 'time' must agree with the rate of 100 .*\(got 50\)"
    ):
        read_bigs(path)


@pytest.mark.parametrize("rate", [91, 109])
@pytest.mark.parametrize("angle", [-2 * np.pi, 2 * np.pi])
def test_a_rate_within_a_tenth_and_angles_of_a_full_turn_are_read(rate, angle, tmp_path):
    content = {
        "electrodes": readings()["electrodes"],
        "time": np.arange(60) / rate,
        "robot_joint": np.full((60, 3, 7), angle),
        **values(pickup_time=0.1),
    }
    rec = read_bigs(write_npz(tmp_path / "a.npz", content))
    assert rec.extra["robot_joint"].max() == np.float32(angle)


@pytest.mark.parametrize(
    "outcome", [1, 1.0, True, "1", "success", "Success ", [1], np.ones((1, 1))]
)
def test_truth_values(outcome, tmp_path):
    content = {"electrodes": readings()["electrodes"], **values(success=outcome, pickup_time=0.1)}
    assert read_bigs(write_npz(tmp_path / "a.npz", content)).label == "success"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"success": 2}, r"'success' must be a truth value \(0, 1, .* \(got 2\)"),
        ({"success": "maybe"}, r"'success' must be a truth value .* \(got 'maybe'\)"),
        ({"success": [0, 1]}, r"'success' must be one value \(got shape \(2,\)\)"),
        (
            {"success": None},
            r"'success' must be in the file \(got only 'electrodes', .*--field suc",
        ),
        ({"object": 3}, r"'object' must be a string \(got 3\)"),
        ({"object": ""}, r"'object' must not be empty"),
        ({"trial": 1.5}, r"'trial' must be an integer \(got 1.5\)"),
        (
            {"pickup_time": 9.0},
            r"'pickup_time' must be a time during the grasp.* 5.0 to 5.59 s \(got 9",
        ),
        ({"electrodes": None}, r"'electrodes' must be in the file .*--field electrodes=NAME"),
        (
            {"electrodes": None, "format": "tactile recording"},
            r"'electrodes' must be in the file .*: this file needs no",
        ),
        ({"electrodes": np.zeros((60, 24, 3))}, r"'electrodes' must have 19 rows of 'electrode'"),
        ({"electrodes": np.zeros((60, 57))}, r"must have 3 dimensions, .*NAME \[frame \(elec"),
        ({"electrodes": np.zeros((60, 19, 3), bool)}, r"'electrodes' must hold numbers \(got bool"),
        ({"electrodes": np.full((60, 19, 3), np.inf)}, r"'electrodes' must hold finite numbers"),
        ({"electrodes": np.zeros((0, 19, 3))}, r"'electrodes' must hold at least one frame"),
        ({"time": np.arange(59) / 100}, r"'time' must have 60 rows of 'frame'"),
        ({"time": np.zeros(60)}, r"'time' must increase \(got 0.0 s in frame 1 after 0.0 s in fr"),
        ({"time": np.arange(60)}, r"'time' must be seconds as floats, .*time_unit.* \(got int64\)"),
        ({"pressure": np.zeros((60, 2))}, r"'pressure' must have 3 rows of 'finger'"),
        ({"pac": np.zeros((60, 3, 21))}, r"'pac' must have 22 rows of 'step'"),
        ({"robot_joint": np.zeros((60, 3, 0))}, r"'robot_joint' must have any number rows of 'jo"),
        ({"robot_joint": np.full((60, 3, 7), 6.29)}, r"in radians \(got 6.29, .*angle_unit"),
        (
            {"time": np.arange(60) / 111},
            r"'time' must agree with the rate of 100 frames .*\(got 111\)",
        ),
        (
            {"time": np.arange(60) / 89},
            r"'time' must agree with the rate of 100 frames .*\(got 89\)",
        ),
        ({"object_pose": np.ones((60, 7))}, r"a quaternion of length 1 \(got 2 in frame 0\)"),
        ({"object_pose": np.zeros((60, 6))}, r"'object_pose' must have 7 rows of 'value'"),
        ({"phase": np.zeros(60)}, r"'phase' must hold the name of a phase for each of 60 frames"),
        ({"slip": np.full(60, 2)}, r"'slip' must be 0, 1, or -1 if unknown \(got 2\)"),
    ],
)
def test_refuses(changes, message, tmp_path):
    content = {**readings(), **values(), **changes}
    path = write_npz(tmp_path / "a.npz", {k: v for k, v in content.items() if v is not None})
    with pytest.raises(ValueError, match=r"a.npz': .*" + message):
        read_bigs(path)


def test_unequal_lengths_of_what_is_flat(tmp_path):
    content = foreign(readings(500), **{"bio/pac": np.zeros((10_999, 3))})
    with pytest.raises(
        ValueError,
        match=r"'pac' \(in 'bio/pac'\) must have 500 x 22 = 11000 rows of 'frame step' .*10999, 3",
    ):
        read_bigs(write_npz(tmp_path / "box-1.npz", content), FOREIGN)


@pytest.mark.parametrize("name", ["bio/elec", "bio/stamp", "p2", "pose", "outcome", "phase"])
def test_a_field_that_was_named_must_be_there(name, tmp_path):
    path = write_npz(tmp_path / "box-1.npz", foreign(readings(), **{name: None}))
    with pytest.raises(ValueError, match=r"box-1.npz': '.*' (\(in '.*'\) )?must be in the file"):
        read_bigs(path, FOREIGN)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"fields": {"electrode": "a"}}, r"'fields' must have keys among .* \(got 'electrode'\)"),
        ({"fields": ["a"]}, r"'fields' must be a mapping \(got list\)"),
        ({"fields": {"time": "a | b | c"}}, r"'time' must have one name, since it has no finger"),
        ({"fields": {"success": "s [frame]"}}, r"order of 'success' must name"),
        ({"fields": {"pac": "p [frame finger]"}}, r"order of 'pac' must name frame, finger, step"),
        ({"values": {"object": ["a"]}}, r"'object' in 'values' must be a string or a number"),
        (
            {"fields": {"object": "a"}, "values": {"object": "b"}},
            r"in 'fields' or in 'values' \(got b",
        ),
        ({"rate": 0}, r"'rate' must be a positive rate"),
        ({"rates": {"pac": 2250.0}}, r"rate of 'pac' must be a multiple of 'rate', 100 \(got 2250"),
        ({"time_unit": "min"}, r"'time_unit' must be one of .* \(got 'min'\)"),
        ({"angle_unit": "grad"}, r"'angle_unit' must be one of"),
        ({"length_unit": "in"}, r"'length_unit' must be one of"),
        ({"quaternion": "zyxw"}, r"'quaternion' must be one of"),
        ({"fingers": "left right"}, r"'fingers' must be an order of 'left', 'middle' and 'right'"),
        ({"pattern": "("}, r"'pattern' must be a regular expression"),
        (
            {"pattern": "(?P<item>.+)"},
            r"'pattern' must have groups among .*'object'.*\(got 'item'\)",
        ),
        ({"ends_after_pickup": -1.0}, r"'ends_after_pickup' must be at least 0 seconds"),
    ],
)
def test_format_refuses(given, message):
    with pytest.raises(ValueError, match=message):
        BiGSFormat(**given)


def test_rates_that_do_not_fit_are_told_where_they_are_needed(tmp_path):
    layout = BiGSFormat(rate=90)
    content = {"electrodes": readings()["electrodes"], **values(pickup_time=0.1)}
    assert read_bigs(write_npz(tmp_path / "a.npz", content), layout).meta["rate"] == 90
    path = write_npz(tmp_path / "b.npz", {**content, "pac": readings()["pac"]})
    with pytest.raises(
        ValueError, match=r"rate of 'pac' must be a multiple of 'rate', 90 \(got 2200"
    ):
        read_bigs(path, layout)
