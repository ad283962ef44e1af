import pytest
import torch
from published_files import uskin_trial

from torch_geometric_tactile.data import Protocol, Trials
from torch_geometric_tactile.datasets import USkinPick

TRIALS = (
    ("train", "2021-11-24-15-19-34", {"obj": "7", "dropped": 0}),
    ("train", "2021-11-24-15-28-02", {"obj": "10", "dropped": 1, "frames": 9}),
    ("test", "2021-11-25-13-07-20", {"obj": "11", "seen": 0, "rate": 20.0, "notes": "slow"}),
    ("test", "2021-11-25-13-28-45", {"obj": "7", "dropped": 1, "notes": "caught"}),
)


def make(folder):
    for part, time, what in TRIALS:
        uskin_trial(folder / part / f"data_sample_{time}", **what)
    return folder


@pytest.mark.parametrize("inner", [".", "raw", "tactile_prediction_flat_dataset"])
def test_trials_by_hand(tmp_path, inner):
    make(tmp_path / inner)
    dataset = USkinPick(tmp_path)
    assert repr(dataset) == "USkinPick(33)"
    assert dataset.class_names == ["held", "dropped"]
    assert dataset.group_names == ["7", "10", "11"]
    assert dataset.trial_names[1:3] == [
        "train/data_sample_2021-11-24-15-28-02",
        "test/data_sample_2021-11-25-13-07-20",
    ]
    frames = [8, 9, 8, 8]
    assert dataset.trial.bincount().tolist() == frames

    def each(*values):
        return torch.tensor(values).repeat_interleave(torch.tensor(frames)).tolist()

    assert dataset.y.tolist() == dataset.fell.tolist() == each(0, 1, 0, 1)
    assert dataset.group.tolist() == each(0, 1, 2, 0)
    assert dataset.seen.tolist() == each(1, 1, 0, 1)
    assert dataset.part.tolist() == each(0, 0, 2, 2)
    assert dataset.time[16:20].tolist() == pytest.approx([0.2, 0, 0.05, 0.1])
    assert dataset.x.shape == (33, 32, 3)
    assert dataset.x[8, 16].tolist() == [36000, 36100, 36200]
    sample = dataset[9]
    assert sample.joint.shape == (1, 7)
    assert sample.end_effector.shape == (1, 7)
    assert sample.finger == pytest.approx(0.071)
    assert sample.edge_index.shape == (2, 96)


def test_published_parts_and_objects_are_held_out(tmp_path):
    dataset = USkinPick(make(tmp_path))
    train, _, test = Protocol("given").split(dataset)
    assert (len(train), len(test)) == (17, 16)
    protocol = Protocol("group", leave_one_out=True)
    fold = protocol.split(dataset, fold=0)
    assert set(dataset.group[fold.test].tolist()) == {0}
    assert Trials(dataset, ragged="pad").valid_frames.tolist() == [8, 9, 8, 8]


def test_target_and_repeats_have_files_of_their_own(tmp_path):
    make(tmp_path)
    dataset = USkinPick(tmp_path, target="object")
    assert dataset.class_names == dataset.group_names
    assert torch.equal(dataset.y, dataset.group)
    changes = USkinPick(tmp_path, repeats=False)
    assert changes.trial.bincount().tolist() == [2, 3, 2, 2]
    assert changes.time[:2].tolist() == pytest.approx([0, 0.1])
    assert len(USkinPick(tmp_path)) == 33
    names = {path.name for path in (tmp_path / "processed").glob("*.pt")}
    assert names >= {"uskin_pick_dropped.pt", "uskin_pick_object.pt"}
    assert "uskin_pick_dropped_changes.pt" in names


def test_stacked_patches_are_channels_of_one_patch(tmp_path):
    make(tmp_path)
    apart = USkinPick(tmp_path)
    dataset = USkinPick(tmp_path, stacked=True)
    assert dataset.x.shape == (33, 16, 6)
    assert torch.equal(dataset.x, torch.cat([apart.x[:, :16], apart.x[:, 16:]], dim=-1))
    assert dataset.layout.num_taxels == 16
    assert torch.equal(dataset[0].edge_index, apart[0].edge_index[:, :48])
    assert torch.equal(dataset[0].pos, apart[0].pos[:16])
    assert USkinPick(tmp_path).x.shape == (33, 32, 3)


def test_unknown_target(tmp_path):
    with pytest.raises(ValueError, match=r"'target' must be one of \['dropped', 'object'\]"):
        USkinPick(make(tmp_path), target="class")


def test_a_trial_that_lacks_a_file_is_named_and_nothing_is_kept(tmp_path):
    make(tmp_path)
    (tmp_path / "test" / "data_sample_2021-11-25-13-07-20" / "robot_state.csv").unlink()
    with pytest.raises(FileNotFoundError, match=r"13-07-20/robot_state.csv' does not exist"):
        USkinPick(tmp_path)
    assert not list((tmp_path / "processed").glob("*.pt"))


def test_anew_when_a_file_changes(tmp_path):
    make(tmp_path)
    USkinPick(tmp_path)
    uskin_trial(tmp_path / "train" / "data_sample_2021-11-24-15-19-34", dropped=1)
    assert USkinPick(tmp_path).y[0] == 1
