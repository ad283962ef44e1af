import copy

import numpy as np
import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose

OBJECTS = ("mango_replica", "sponge", "purse")  # in the papers' order: sponge, mango, purse
FRAMES = 6


def write_trial(folder, name, number, value=0.0, frames=FRAMES, suffix=".npz", **meta):
    """Frame t reads value + t in all taxels; its joint j is at 0.1 t + 0.01 j radians."""
    folder.mkdir(parents=True, exist_ok=True)
    time = np.arange(frames)
    recording = Recording(
        time=time / 100,
        tactile=np.broadcast_to((value + time)[:, None, None], (frames, 384, 3)),
        joint=0.1 * time[:, None] + 0.01 * np.arange(16),
        meta={"unit": "count", "phase_names": ["reach", "lift", "hold"], **meta},
        privileged={"phase": time * 3 // frames},
    )
    write_recording(recording, folder / f"{name}_{number:03d}{suffix}")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Three objects with four trials of six frames; the first reading of a trial is its number."""
    root = tmp_path_factory.mktemp("allegro")
    names = sorted((name, number) for name in OBJECTS for number in range(4))
    for i, (name, number) in enumerate(names):
        write_trial(root / "raw", name, number, 100.0 * i)
    return root


def trials(dataset):
    return set(dataset.column("trial").tolist())


def test_everything_by_hand(root):
    dataset = AllegroUSkin(root, split=None)
    assert repr(dataset) == "AllegroUSkin(72)"
    assert dataset.class_names == dataset.group_names == ["sponge", "mango_replica", "purse"]
    assert dataset.trial_names[:5] == [f"mango_replica_{i:03d}" for i in range(4)] + ["purse_000"]
    assert dataset.phase_names == ["reach", "lift", "hold"]
    assert (dataset.num_classes, dataset.num_features, dataset.num_missing) == (3, 3, 0)
    assert not dataset.synthetic
    data = dataset.data
    assert data.trial.tolist() == [i for i in range(12) for _ in range(6)]
    assert data.group.tolist() == [1] * 24 + [2] * 24 + [0] * 24
    assert data.y.equal(data.group)
    assert data.phase.tolist() == [0, 0, 1, 1, 2, 2] * 12
    assert data.x[:, 383, 2].tolist() == [100.0 * i + t for i in range(12) for t in range(6)]
    assert data.time.tolist() == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04, 0.05] * 12)
    assert data.joint[3].tolist() == pytest.approx([0.3 + 0.01 * j for j in range(16)])
    assert data.edge_index.equal(allegro_uskin().edge_index("original"))
    assert "pos" not in data
    assert data.x.dtype == data.joint.dtype == torch.float
    assert data.time.dtype == torch.double


def test_sample_is_plain_data(root):
    data = AllegroUSkin(root, split=None)[25]
    assert type(data) is Data
    assert {key: list(data[key].shape) for key in data.keys()} == {  # noqa: SIM118
        "x": [384, 3],
        "edge_index": [2, 1401],
        "y": [1],
        "joint": [1, 16],
        "time": [1],
        "trial": [1],
        "group": [1],
        "property": [1, 6],
        "phase": [1],
    }
    assert data.x.eq(401.0).all()
    assert data.validate()


def test_properties_of_known_objects_are_the_papers(root):
    dataset = AllegroUSkin(root, "property", split=None)
    light_soft_grippy, light_hard_grippy, heavy_hard_grippy = (
        [1, 0, 0, 1, 1, 0],
        [1, 0, 1, 0, 1, 0],
        [0, 1, 1, 0, 1, 0],
    )
    expected = [light_hard_grippy] * 24 + [heavy_hard_grippy] * 24 + [light_soft_grippy] * 24
    assert dataset.column("property").tolist() == expected
    assert dataset.column("y").tolist() == expected
    assert dataset.column("y").dtype == torch.float
    assert dataset[0].y.shape == (1, 6)
    assert dataset.num_classes == 6
    assert dataset.class_names == ["light", "heavy", "hard", "soft", "non-slippery", "slippery"]
    assert dataset.group_names == ["sponge", "mango_replica", "purse"]


@pytest.mark.parametrize(("name", "edges"), [("sparse", 1000), ("slanted", 1184), ("dense", 2488)])
def test_adjacency_is_chosen_at_load(root, name, edges):
    assert AllegroUSkin(root, adjacency=name)[0].num_edges == edges


def test_layout_gives_the_edges(root):
    assert AllegroUSkin(root, layout=allegro_uskin(symmetric=True))[0].num_edges == 1400


@pytest.mark.parametrize(
    ("fractions", "sizes"), [((0.7, 0.1, 0.2), (2, 1, 1)), ((0.5, 0.0, 0.5), (2, 0, 2))]
)
def test_split_by_trial_holds_out_trials_of_each_object(root, fractions, sizes):
    parts = {}
    for name, size in zip(("train", "val", "test"), sizes, strict=True):
        if size:
            part = AllegroUSkin(root, split=name, fractions=fractions)
            parts[name] = trials(part)
            assert part.column("group").bincount().tolist() == [FRAMES * size] * 3
            assert len(part) == FRAMES * len(parts[name])
    assert sorted(i for part in parts.values() for i in part) == list(range(12))


def test_split_by_frame_is_disjoint_and_covers_all(root):
    parts = [
        set(AllegroUSkin(root, split=name, split_by="frame").indices())
        for name in ("train", "val", "test")
    ]
    assert [len(part) for part in parts] == [51, 7, 14]
    assert set.union(*parts) == set(range(72))


@pytest.mark.parametrize("split_by", ["trial", "frame"])
def test_split_is_deterministic_by_seed(root, split_by):
    first, again, *others = (
        list(AllegroUSkin(root, split="test", split_by=split_by, split_seed=seed).indices())
        for seed in (3, 3, 4, 5, 6)
    )
    assert first == again
    assert any(first != other for other in others)


@pytest.mark.parametrize(
    ("count", "fractions", "sizes"),
    [
        (2, (0.7, 0.1, 0.2), (1, 0, 1)),
        (3, (0.7, 0.1, 0.2), (1, 1, 1)),
        (10, (0.7, 0.1, 0.2), (7, 1, 2)),
        (10, (0.6, 0.1, 0.3), (6, 1, 3)),
        (3, (0.1, 0.1, 0.8), (1, 1, 1)),
        (3, (0.1, 0.8, 0.1), (1, 1, 1)),
        (1, (1, 0, 0), (1, 0, 0)),
    ],
)
def test_number_of_trials_held_out(tmp_path, count, fractions, sizes):
    for number in range(count):
        write_trial(tmp_path, "sponge", number, frames=1)
    for split, size in zip(("train", "val", "test"), sizes, strict=True):
        if size:
            assert len(AllegroUSkin(tmp_path, split=split, fractions=fractions)) == size
        else:
            with pytest.raises(ValueError, match=rf"split='{split}'.*leave at least one.*none"):
                AllegroUSkin(tmp_path, split=split, fractions=fractions)


@pytest.mark.parametrize(
    ("arguments", "frames"),
    [
        ({"phases": ["lift"]}, [2, 3]),
        ({"phases": "hold"}, [4, 5]),
        ({"phases": ("hold", "reach")}, [0, 1, 4, 5]),
        ({"stride": 2}, [0, 2, 4]),
        ({"stride": 4}, [0, 4]),
        ({"stride": 100}, [0]),
        ({"stride": 2, "phases": ["lift", "hold"]}, [2, 4]),
    ],
)
def test_phases_and_stride_select_frames_of_each_trial(root, arguments, frames):
    dataset = AllegroUSkin(root, split=None, **arguments)
    assert list(dataset.indices()) == [6 * i + t for i in range(12) for t in frames]
    assert dataset.data.x[:, 0, 0].tolist() == [100.0 * i + t for i in range(12) for t in frames]


@pytest.mark.parametrize("split_by", ["trial", "frame"])
def test_phases_and_stride_move_no_frame_to_another_split(root, split_by):
    whole = AllegroUSkin(root, split="test", split_by=split_by)
    part = AllegroUSkin(root, split="test", split_by=split_by, phases=["lift"], stride=3)
    assert 0 < len(part) < len(whole)
    assert set(part.indices()) < set(whole.indices())


def test_selection_copies_no_readings(root):
    whole, part = AllegroUSkin(root, split=None), AllegroUSkin(root, split="val", stride=2)
    assert whole._indices is None
    assert part.len() == 72
    assert part._data.x.shape == whole._data.x.shape
    assert len(part) == 9


def test_transform_places_taxels_by_the_joints(root):
    layout, hand = allegro_uskin(), HandKinematics.allegro()
    transform = Compose([TaxelPose(layout, hand), GeometricEdgeAttr()])
    dataset = AllegroUSkin(root, split=None, transform=transform)
    assert dataset[3].edge_attr.shape == (1401, 4)
    batch = dataset.batch([0, 3])
    assert batch.edge_attr.shape == (2, 1401, 4)
    assert batch.pos[1].allclose(hand.taxel_pose(layout, dataset[3].joint[0]).pos, atol=1e-6)
    assert not batch.pos[0].allclose(batch.pos[1], atol=1e-3)


def test_pre_filter_and_pre_transform_see_labels_and_edges(root, tmp_path):
    def negated(data):
        assert data.num_edges == 1401
        data = copy.copy(data)
        data.x = -data.x
        return data

    (tmp_path / "raw").symlink_to(root / "raw")
    arguments = {"pre_filter": lambda data: int(data.y) == 1, "pre_transform": negated}
    dataset = AllegroUSkin(tmp_path, split=None, **arguments)
    assert len(dataset) == 24
    assert dataset.data.x[:6, 0, 0].tolist() == [-0.0, -1.0, -2.0, -3.0, -4.0, -5.0]
    assert dataset.column("group").eq(1).all()
    assert len(AllegroUSkin(tmp_path, split="test", **arguments)) == 6
    assert len(AllegroUSkin(tmp_path, split=None)) == 72  # in a processed file of its own
    names = sorted(path.name for path in (tmp_path / "processed").rglob("allegro*"))
    assert names == ["allegro_uskin.pt"] * 2


def test_edges_of_a_pre_transform_stay(root, tmp_path):
    def one_edge(data):
        data = copy.copy(data)
        data.edge_index = data.edge_index[:, :1]
        return data

    (tmp_path / "raw").symlink_to(root / "raw")
    for adjacency in ("original", "dense"):
        dataset = AllegroUSkin(tmp_path, adjacency=adjacency, pre_transform=one_edge)
        assert dataset[0].edge_index.equal(allegro_uskin().edge_index(adjacency)[:, :1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "mass"}, r"'task' must be one of \('object', .*, 'yaw'\) \(got 'mass'\)"),
        ({"split_by": "object"}, r"'split_by' must be one of \('trial', .* \(got 'object'\)"),
        ({"phases": ["hold", "fly"]}, r"'phases' must be some of \['reach', 'lift', 'hold'\]"),
        ({"phases": []}, r"'phases' must be some of .* \(got \[\]\)"),
        *(
            ({"fractions": fractions}, r"'fractions' must be three numbers.*that add up to 1")
            for fractions in (
                (0.7, 0.2),
                (0.7, 0.1, 0.3),
                (1.1, -0.1, 0.0),
                (0, 0.5, 0.5),
                0.7,
                ("a", 0, 1),
                (float("nan"), 0.1, 0.2),
            )
        ),
    ],
)
def test_rejects(root, arguments, message):
    with pytest.raises(ValueError, match=message):
        AllegroUSkin(root, **arguments)
