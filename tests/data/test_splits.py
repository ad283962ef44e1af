import pytest
import torch

from torch_geometric_tactile.data import Fold, Split, StaticData, splits


def trials(objects=5, trials_per_object=4, frames=5):
    num = objects * trials_per_object * frames
    trial = torch.arange(objects * trials_per_object).repeat_interleave(frames)
    group = torch.arange(objects).repeat_interleave(trials_per_object * frames)
    order = torch.randperm(num, generator=torch.Generator().manual_seed(0))
    return StaticData(x=torch.zeros(num, 1, 1), trial=trial[order], group=group[order])


SPLITS = {"frame": splits.by_frame, "trial": splits.by_trial, "group": splits.by_group}


def assert_parts(parts, num):
    """The parts are sorted, disjoint and complete."""
    joined = torch.cat(list(parts))
    assert sorted(joined.tolist()) == list(range(num))
    for part in parts:
        assert part.dtype == torch.long
        assert part.tolist() == sorted(part.tolist())


def units(data, by, part):
    values = torch.arange(data.num_samples) if by == "frame" else data[by]
    return set(values[part].tolist())


def assert_disjoint_units(data, by, parts):
    sides = [units(data, by, part) for part in parts]
    assert sum(map(len, sides)) == len(set.union(*sides))


def test_by_frame_sizes_by_hand():
    split = splits.by_frame(StaticData(x=torch.zeros(10, 1, 1)), val=0.1, test=0.2)
    assert isinstance(split, Split)
    assert [len(part) for part in (split.train, split.val, split.test)] == [7, 1, 2]


@pytest.mark.parametrize("by", SPLITS)
def test_split_is_disjoint_complete_and_deterministic(by):
    data = trials()
    split = SPLITS[by](data, val=0.2, test=0.2, seed=3)
    assert_parts(split, data.num_samples)
    assert_disjoint_units(data, by, split)
    assert [len(part) for part in split] == [60, 20, 20]
    again, other = (SPLITS[by](data, val=0.2, test=0.2, seed=seed) for seed in (3, 4))
    assert all(a.equal(b) for a, b in zip(split, again, strict=True))
    assert not split.test.equal(other.test)


def test_by_frame_puts_trials_on_two_sides_and_by_trial_groups():
    data = trials()
    frame, trial = (SPLITS[by](data, val=0.2, test=0.2) for by in ("frame", "trial"))
    assert units(data, "trial", frame.train) & units(data, "trial", frame.test)
    assert units(data, "group", trial.train) & units(data, "group", trial.test)
    group = splits.by_group(data, val=0.2, test=0.2)
    assert not units(data, "group", group.train) & units(data, "group", group.test)


@pytest.mark.parametrize("by", SPLITS)
def test_split_with_empty_parts(by):
    data = trials()
    split = SPLITS[by](data, val=0, test=0)
    assert [len(part) for part in split] == [100, 0, 0]


def test_split_takes_datasets_and_indexes_their_selection(toy):
    split = splits.by_trial(toy()[2:], val=0, test=0.5)
    assert_parts(split, 4)
    assert {tuple(part.tolist()) for part in (split.train, split.test)} == {(0, 1), (2, 3)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"val": 0.01}, "'val' of 0.01 is less than one of 5 groups"),
        ({"test": 0.05}, "'test' of 0.05 is less than one of 5 groups"),
        ({"val": 0.35, "test": 0.6}, "'val' and 'test' leave none of 5 groups to train on"),
    ],
)
def test_split_rejects(arguments, message):
    with pytest.raises(ValueError, match=message):
        splits.by_group(trials(), **{"val": 0.2, "test": 0.2, **arguments})


@pytest.mark.parametrize("by", ["trial", "group"])
def test_split_without_the_attribute(by):
    with pytest.raises(ValueError, match=rf"'by' must be a unit .* none \(got '{by}'\)"):
        SPLITS[by](StaticData(x=torch.zeros(4, 1, 1)))


def test_leave_one_group_out_yields_each_group_once():
    data = trials()
    folds = list(splits.leave_one_group_out(data))
    assert [units(data, "group", fold.test) for fold in folds] == [{0}, {1}, {2}, {3}, {4}]
    for fold in folds:
        assert isinstance(fold, Fold)
        assert_parts(fold, 100)
        assert_disjoint_units(data, "group", fold)


@pytest.mark.parametrize(("kept", "groups"), [(slice(0, 0), 0), (slice(4, 6), 1)])
def test_leave_one_group_out_needs_two(toy, kept, groups):
    with pytest.raises(ValueError, match=rf"at least 2 groups to leave one out \(got {groups}\)"):
        next(splits.leave_one_group_out(toy()[kept]))


@pytest.mark.parametrize("by", ["frame", "trial", "group"])
def test_k_fold_tests_every_sample_once(by):
    data = trials()
    folds = splits.k_fold(data, folds=5, by=by, seed=1)
    assert len(folds) == 5
    assert_parts([fold.test for fold in folds], 100)
    for fold in folds:
        assert len(fold.test) == 20
        assert_parts(fold, 100)
        assert_disjoint_units(data, by, fold)
    again, other = (splits.k_fold(data, folds=5, by=by, seed=seed) for seed in (1, 2))
    assert all(a.test.equal(b.test) for a, b in zip(folds, again, strict=True))
    assert not all(a.test.equal(b.test) for a, b in zip(folds, other, strict=True))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"folds": 6, "by": "group"}, r"'folds' must be between 2 and the 5 groups .* \(got 6\)"),
        ({"folds": 101, "by": "frame"}, r"'folds' .* 2 and the 100 frames .* \(got 101\)"),
    ],
)
def test_k_fold_rejects(arguments, message):
    with pytest.raises(ValueError, match=message):
        splits.k_fold(trials(), **arguments)
