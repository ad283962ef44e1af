import numpy as np
import pytest
from published_files import pickled, sparsh_episode, sparsh_joints, sparsh_touch

from torch_geometric_tactile.io import read_sparsh_skin
from torch_geometric_tactile.sensors import allegro_uskin_368

# The authors' patches: their first taxel in a frame, and ours.
PATCHES = {
    0: "thumb_tip",
    30: "thumb_2",
    46: "thumb_1",
    62: "index_tip",
    92: "index_3",
    108: "index_2",
    124: "index_1",
    140: "middle_tip",
    170: "middle_3",
    186: "middle_2",
    202: "middle_1",
    218: "ring_tip",
    248: "ring_3",
    264: "ring_2",
    280: "ring_1",
    296: "palm_1_index",
    320: "palm_1_ring",
    344: "palm_2_ring",
}


@pytest.mark.parametrize("protocol", [4, 5])
def test_episode_by_hand(tmp_path, protocol):
    rec = read_sparsh_skin(sparsh_episode(tmp_path / "cup" / "7", protocol=protocol))
    assert rec.tactile.dtype == np.float32
    assert (rec.tactile.shape, rec.joint.shape) == ((6, 368, 3), (6, 16))
    assert rec.time.tolist() == [0, 0.01, 0.02, 0.03, 0.04, 0.05]
    # Angles and efforts are linear in time, between their own rows.
    assert rec.joint[2] == pytest.approx(0.02 + 0.01 * np.arange(16), abs=1e-6)
    assert rec.extra["effort"][2] == pytest.approx(0.02 + 0.01 * np.arange(16, 32), abs=1e-6)
    assert rec.meta == {
        "sensor": "XELA uSkin",
        "unit": "count",
        "rate": 100.0,
        "object": "cup",
        "episode": 7,
    }


def test_stamps_that_repeat_are_left_out(tmp_path):
    joints = sparsh_joints()[[0, 1, 1, 2, 3, 4, 5, 6, 7]]
    rec = read_sparsh_skin(sparsh_episode(tmp_path, changed((2, ..., 0), 0.01), joints))
    assert rec.time.tolist() == [0, 0.01, 0.03, 0.04, 0.05]
    assert (rec.tactile[:, 0, 0] - rec.tactile[0, 0, 0]).tolist() == [0, 1, 3, 4, 5]
    assert rec.joint[1] == pytest.approx(0.01 + 0.01 * np.arange(16), abs=1e-6)


def test_patches_are_those_of_the_authors(tmp_path):
    rec = read_sparsh_skin(sparsh_episode(tmp_path))
    layout = allegro_uskin_368()
    place = (rec.tactile[0, :, 0] - 30000) / 10  # in a frame of the authors
    assert sorted(place.tolist()) == list(range(368))
    for start, name in PATCHES.items():
        mine = place[layout.patch.numpy() == layout.patch_names.index(name)]
        assert mine.tolist() == list(range(start, start + len(mine)))
    assert rec.tactile[3, 0].tolist() == [30003 + 10 * 124, 30004 + 10 * 124, 30005 + 10 * 124]
    assert "object" not in rec.meta or tmp_path.name.isdecimal()


def test_frames_without_joints_are_left_out(tmp_path):
    joints = sparsh_joints(frames=3, rate=100.0, start=0.015)  # to 0.035
    rec = read_sparsh_skin(sparsh_episode(tmp_path, joints=joints))
    assert rec.time.tolist() == [0.02, 0.03]
    assert rec.tactile[0, 0, 0] == 30002 + 10 * 124
    late = sparsh_joints(start=7.0)
    with pytest.raises(ValueError, match=r"allegro/data.pkl' must overlap in time .*0 to 0.05 s"):
        read_sparsh_skin(sparsh_episode(tmp_path, joints=late))


def test_the_hand_at_rest_has_no_joints(tmp_path):
    pickled(tmp_path / "baseline" / "xela" / "data.pkl", sparsh_touch(3))
    rec = read_sparsh_skin(tmp_path / "baseline", joints=False)
    assert (rec.num_frames, rec.joint, rec.extra) == (3, None, {})
    with pytest.raises(FileNotFoundError, match=r"allegro/data.pkl' does not exist; put the file"):
        read_sparsh_skin(tmp_path / "baseline")


def changed(index, value):
    frames = np.array(sparsh_touch())
    frames[index] = value
    return list(frames)


@pytest.mark.parametrize(
    ("touch", "match"),
    [
        ([], r"must hold a list of at least one frame \(got list\)"),
        ({"a": 1}, r"list of at least one frame \(got dict\)"),
        ([*sparsh_touch(), 3], r"frame 6 must be an array of shape \(368, 4\) \(got int\)"),
        ([np.zeros((367, 4))], r"frame 0 must be an array .*\(got \(367, 4\)\)"),
        (changed((2, ..., 0), 0.005), r"must have times in order \(got 0.005 in row 2\)"),
        (changed((2, ..., 0), np.nan), r"must have times in order \(got nan in row"),
        (changed((2, 9, 0), 0.3), r"the same time for all tax.* \(got several in frame 2\)"),
        (
            changed((2, 9, 3), np.nan),
            r"finite numbers \(got an infinite number or NaN at 2, 9, 2\)",
        ),
    ],
)
def test_wrong_touch_is_refused_by_name(tmp_path, touch, match):
    folder = sparsh_episode(tmp_path)
    pickled(folder / "xela" / "data.pkl", touch)
    with pytest.raises(ValueError, match=rf"xela/data.pkl'.*{match}"):
        read_sparsh_skin(folder)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (sparsh_joints(), r"'joint_states' must be an array .* \(got NoneType\)"),
        ({"joint_states": np.array(3.0)}, r"shape \(1, 33\) \(got \(\)\)"),
        ({"joint_states": np.zeros((0, 33))}, r"shape \(1, 33\) \(got \(0, 33\)\)"),
        ({"joint_states": np.zeros((5, 17))}, r"shape \(5, 33\) \(got \(5, 17\)\)"),
        ({"joint_states": sparsh_joints()[::-1]}, r"times in order"),
        ({"joint_states": np.where(np.eye(8, 33, 3), np.nan, sparsh_joints())}, r"NaN at 0, 3\)"),
    ],
)
def test_wrong_joints_are_refused_by_name(tmp_path, content, match):
    folder = sparsh_episode(tmp_path)
    pickled(folder / "allegro" / "data.pkl", content)
    with pytest.raises(ValueError, match=rf"allegro/data.pkl'.*{match}"):
        read_sparsh_skin(folder)


def test_a_frame_that_is_there_many_times_takes_no_memory(tmp_path):
    frame = np.zeros((368, 4))
    many = 100_000  # 1.2 GB of a file of 0.2 MB
    path = pickled(tmp_path / "xela" / "data.pkl", many * [frame])
    assert path.stat().st_size < 2**19
    with pytest.raises(ValueError, match=rf"must not repeat its frames .*{many * 11776}"):
        read_sparsh_skin(tmp_path, joints=False)
