"""Shape, width, centre and yaw of what is grasped."""

import math

import numpy as np
import pytest
import torch
from torch_geometric.loader import DataLoader

from torch_geometric_tactile.data import Protocol, Recording
from torch_geometric_tactile.datasets import AllegroUSkin, RecordingFrames
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import grid

FRAMES = 3
UP = (1.0, 0.0, 0.0, 0.0)


def about(axis, angle):
    """A quaternion."""
    return (math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis)))


def poses(place, turn, frames=FRAMES):
    return np.tile(np.array([*place, *turn], dtype=float), (frames, 1))


def write(folder, name, number=0, item=((0.1, 0.2, 0.3), UP), palm=((0, 0, 0), UP), **meta):
    folder.mkdir(parents=True, exist_ok=True)
    recording = Recording(
        time=np.arange(FRAMES) / 100,
        tactile=np.full((FRAMES, 384, 3), float(number)),
        joint=np.zeros((FRAMES, 16)),
        meta={"unit": "count", **meta},
        privileged={"object_pose": poses(*item), "palm_pose": poses(*palm)},
    )
    write_recording(recording, folder / f"{name}_{number:03d}.npz")


@pytest.fixture
def root(tmp_path):
    """A box, a can and a ball, two trials each; the can is turned by 0.3 and 0.5."""
    for number in range(2):
        turned = ((0.1, 0.2, 0.3), about((1, 0, 0), 0.3 + 0.2 * number))
        write(tmp_path, "box", number, shape="box", width=0.07, placement=number, size=7)
        write(tmp_path, "can", number, turned, shape="cylinder", width=0.08, placement=2, size=8)
        write(tmp_path, "ball", number, shape="sphere", width=0.06, placement=number + 3, size=6)
    return tmp_path


def test_shape_is_a_class(root):
    dataset = AllegroUSkin(root, "shape", None)
    assert dataset.class_names == dataset.shape_names == ["box", "cylinder", "sphere"]
    assert dataset.num_classes == 3
    assert dataset.y.tolist() == [2] * 6 + [0] * 6 + [1] * 6  # ball, box, can
    assert dataset.y.dtype == torch.long


def test_width_is_a_number_in_metres(root):
    dataset = AllegroUSkin(root, "width", None)
    assert dataset.class_names == ["width"]
    assert dataset.y.tolist() == pytest.approx([0.06] * 6 + [0.07] * 6 + [0.08] * 6)
    assert dataset.y.dtype == torch.float
    assert dataset[0].y.shape == (1,)


def test_centre_and_yaw_by_hand(root):
    centre = AllegroUSkin(root, "centre", None)
    assert centre.class_names == ["x", "y", "z"]
    assert centre.y.shape == (18, 3)
    assert centre.y.flatten().tolist() == pytest.approx([0.1, 0.2, 0.3] * 18)
    yaw = AllegroUSkin(root, "yaw", None)
    assert yaw.class_names == ["yaw"]
    assert len(yaw) == 12  # without the ball
    assert yaw.y.tolist() == pytest.approx([0.0] * 6 + [0.3] * 3 + [0.5] * 3)
    assert set(yaw.group.tolist()) == {1, 2}


def test_one_processed_file_serves_all_tasks(root, caplog):
    for task in ("object", "shape", "width", "centre", "yaw"):
        AllegroUSkin(root, task, None)
    assert [path.name for path in (root / "processed").iterdir()] == ["allegro_uskin.pt"]
    assert "processing" not in caplog.text


@pytest.mark.parametrize("turn", [about((0, 1, 0), 1.0), about((0.6, 0.0, 0.8), -2.0)])
def test_what_moves_with_the_hand_stays_where_it_is(tmp_path, turn):
    w, x, y, z = turn
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    place = rotation @ [0.01, 0.02, 0.03] + [0.5, 0.6, 0.7]
    write(tmp_path, "can", 0, (place, turn), ((0.5, 0.6, 0.7), turn), shape="cylinder", width=0.08)
    centre, yaw = (AllegroUSkin(tmp_path, task, None).y for task in ("centre", "yaw"))
    assert centre[0].tolist() == pytest.approx([0.01, 0.02, 0.03], abs=1e-6)
    assert yaw[0].item() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(1.2, 1.2), (-1.2, -1.2), (math.pi, 0.0), (math.pi - 0.4, -0.4), (0.4 - math.pi, 0.4)],
)
def test_half_a_turn_is_none(tmp_path, angle, expected):
    turned = ((0, 0, 0), about((1, 0, 0), angle))
    write(tmp_path, "can", 0, turned, shape="cylinder", width=0.08)
    assert AllegroUSkin(tmp_path, "yaw", None).y[0].item() == pytest.approx(expected, abs=1e-6)


def test_rolling_about_the_long_axis_is_no_yaw(tmp_path):
    write(tmp_path, "can", 0, ((0, 0, 0), about((0, 1, 0), 0.7)), shape="cylinder", width=0.08)
    assert AllegroUSkin(tmp_path, "yaw", None).y.tolist() == pytest.approx([0] * 3, abs=1e-6)


def test_older_simulations_tell_shape_and_width_as_parameters(tmp_path):
    parameters = {"shape": "box", "size": [0.05, 0.1, 0.06]}
    write(tmp_path, "box", 0, object_parameters=parameters)
    assert AllegroUSkin(tmp_path, "shape", None).class_names == ["box"]
    assert AllegroUSkin(tmp_path, "width", None).y.tolist() == pytest.approx([0.05] * 3)


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("shape", r"task='shape' must have a target .*: 'shape' in their metadata"),
        ("width", r"task='width' must have a target .*: 'width' in their metadata"),
        ("yaw", r"task='yaw' must have a target .*'object_pose' and 'palm_pose' \(T, 7\) of obj"),
    ],
)
def test_unknown_targets_are_named(tmp_path, task, message):
    write(tmp_path, "ball", 0, shape="sphere", width=0.06)
    write(tmp_path, "ball", 1, **({"shape": "sphere"} if task == "yaw" else {}))
    with pytest.raises(ValueError, match=message):
        AllegroUSkin(tmp_path, task, None)
    assert len(AllegroUSkin(tmp_path, "centre", None)) == 6


@pytest.mark.parametrize(("shape", "width"), [(3, 0.1), ("box", "wide"), (None, True)])
def test_other_metadata_are_no_targets(tmp_path, shape, width):
    write(tmp_path, "box", 0, shape=shape, width=width)
    for task, value in (("shape", shape), ("width", width)):
        if (task, value) in (("shape", "box"), ("width", 0.1)):
            AllegroUSkin(tmp_path, task, None)
        else:
            with pytest.raises(ValueError, match=f"task='{task}' must have a target"):
                AllegroUSkin(tmp_path, task, None)


def test_recordings_without_poses_have_no_centre(tmp_path):
    recording = Recording(
        time=[0.0],
        tactile=np.zeros((1, 384, 3)),
        joint=np.zeros((1, 16)),
        meta={"unit": "count"},
        privileged={"object_pose": np.zeros((1, 7)), "palm_pose": np.zeros((1, 6))},
    )
    write_recording(recording, tmp_path / "box_000.npz")
    dataset = AllegroUSkin(tmp_path, split=None)
    assert dataset.column("centre") is None
    assert dataset.shape_names == dataset.placement_names == dataset.size_names == []
    with pytest.raises(ValueError, match="task='centre' must have a target"):
        AllegroUSkin(tmp_path, "centre", None)


def test_splits_by_placement_and_size(root):
    dataset = AllegroUSkin(root, "width", None)
    assert dataset.placement_names == ["0", "1", "2", "3", "4"]
    assert dataset.size_names == ["6", "7", "8"]
    assert dataset.column("placement").tolist() == [3] * 3 + [4] * 3 + [0] * 3 + [1] * 3 + [2] * 6
    protocol = Protocol("size", leave_one_out=True)
    assert protocol.describe() == "leave one size out"
    assert protocol.num_folds(dataset) == 3
    largest = protocol.split(dataset, fold=2)
    assert dataset.y[largest.test].unique().tolist() == pytest.approx([0.08])
    assert dataset.y[largest.train].max().item() == pytest.approx(0.07)
    parts = Protocol("placement", folds=5).split(dataset, fold=1)
    placement = dataset.column("placement")
    assert not set(placement[parts.train].tolist()) & set(placement[parts.test].tolist())


@pytest.mark.parametrize(
    ("by", "key"), [("placement", "placement"), ("size", "size"), ("group",) * 2]
)
def test_data_set_holds_out_whole_groups(root, by, key):
    fractions = {"placement": (0.6, 0.2, 0.2)}.get(by, (0.34, 0.33, 0.33))
    seen = []
    for split in ("train", "val", "test"):
        part = AllegroUSkin(root, "width", split, split_by=by, fractions=fractions)
        seen.append(set(part.column(key).tolist()))
    assert all(seen)
    assert sum(map(len, seen)) == len(set.union(*seen))


def test_batches_have_the_attributes_of_the_samples(root):
    dataset = AllegroUSkin(root, "centre", None)
    ours, theirs = (
        next(iter(loader(dataset, batch_size=7))) for loader in (StaticLoader, DataLoader)
    )
    for key in ("shape", "width", "centre", "yaw", "placement", "size"):
        assert torch.allclose(ours[key], dataset.column(key)[:7], equal_nan=True)
        assert torch.allclose(ours[key], theirs[key], equal_nan=True)
    assert ours.y.shape == theirs.y.shape == (7, 3)
    assert theirs.num_graphs == 7


def test_recordings_without_a_placement_are_not_split_by_it(tmp_path):
    for number in range(2):
        write(tmp_path, "box", number, size=[0.1, 0.2] if number else 3)
    with pytest.raises(ValueError, match=r"'by' must be a unit .*\(got 'placement'"):
        AllegroUSkin(tmp_path, split="train", split_by="placement")
    with pytest.raises(ValueError, match=r"'by' must be a unit .*\(got 'size'"):
        Protocol("size").split(AllegroUSkin(tmp_path, split=None))


def test_placement_of_any_recordings():
    recordings = [
        Recording(
            time=[0.0],
            tactile=np.zeros((1, 4, 1)),
            label="a",
            meta={"placement": place, "session": "one", "size": 3},
        )
        for place in ("left", "right", "left")
    ]
    dataset = RecordingFrames(layout=grid(2, 2, 0.01), recordings=recordings, target="label")
    assert dataset.placement_names == ["left", "right"]
    assert dataset.column("placement").tolist() == [0, 1, 0]
    assert dataset.column("size").tolist() == [0, 0, 0]


def test_yaw_of_a_simulated_hand_is_its_own_before_it_touches(tmp_path):
    for package in ("mujoco", "h5py"):
        pytest.importorskip(package, reason="needs the extra 'sim'")
    from torch_geometric_tactile.io import read_recording
    from torch_geometric_tactile.sim import GraspSpread, simulate

    choice = {"preset": "ci", "plan": GraspSpread(yaw=0.5), "seconds": 2.0, "num_objects": 2}
    reports = list(simulate(tmp_path, "shapes", 1, seed=3, max_attempts=30, **choice))
    assert [report.object_name for report in reports] == ["sphere_000", "cylinder_000"]
    meta = read_recording(reports[1].path).meta
    hover = AllegroUSkin(tmp_path, "yaw", None, phases=["hover"])
    assert hover.y.tolist() == pytest.approx([meta["palm_yaw"]] * len(hover), abs=0.03)
    centre = AllegroUSkin(tmp_path, "centre", None, phases=["hover"])
    assert (centre.y[:, 0] > 0.1).all()  # below the palm, along its normal
