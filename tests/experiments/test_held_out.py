import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from compared import GIVEN, experiment, touches

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import SamplesFile
from torch_geometric_tactile.experiments._held_out import (
    balanced_protocol,
    choice_cuts,
    choice_parts,
    compared_protocol,
)
from torch_geometric_tactile.experiments.comparison import _is_regression


def dataset(folder, **changes):
    touches(folder / "a.npz", **changes)
    return SamplesFile(folder / "a.npz", grid="3x4")


def trials(part):
    return set(part.trial.tolist())


@pytest.mark.parametrize("fold", [0, 1, 2])
def test_no_trial_is_in_two_parts_and_each_has_all_classes(tmp_path, fold):
    touches(tmp_path / "a.npz", num_trials=18)
    parts = choice_parts(experiment(tmp_path / "a.npz", fold=fold))
    assert not trials(parts.fit) & trials(parts.val)
    assert not trials(parts.train) & trials(parts.test)
    assert trials(parts.fit) | trials(parts.val) == trials(parts.train)
    assert len(trials(parts.train) | trials(parts.test)) == 18
    assert all(part.y.unique().tolist() == [0, 1, 2] for part in parts[:1] + parts[2:])


def test_cuts_of_the_training_part_hold_out_other_trials_each(tmp_path):
    touches(tmp_path / "a.npz", num_trials=18)
    one = experiment(tmp_path / "a.npz")
    parts, (_, _, cuts) = choice_parts(one), choice_cuts(one, 3)
    held_out = [trials(val) for _, val in cuts]
    assert held_out[0] == trials(parts.val)
    assert not set.intersection(*held_out)
    for fit, val in cuts:
        assert not trials(fit) & trials(val)
        assert trials(fit) | trials(val) == trials(parts.train)
    assert len(choice_cuts(one, 20)[2]) == 4  # trials of each class


def test_no_session_is_in_two_parts(tmp_path):
    session = np.repeat(np.arange(18) // 3 % 3, 4)
    samples = dataset(tmp_path, num_trials=18, session=session)
    protocol = compared_protocol(samples, "session", 5)
    assert protocol.folds == 3
    fit, val, train, test = (
        set(part.session.tolist())
        for part in choice_parts(experiment(tmp_path / "a.npz", protocol=protocol))
    )
    assert [len(part) for part in (fit, val, train, test)] == [1, 1, 2, 1]
    assert fit | val | test == {0, 1, 2}


def test_two_folds_of_three_sessions_leave_none_to_choose_on(tmp_path):
    session = np.repeat(np.arange(12) // 2 % 3, 4)
    samples = dataset(tmp_path, session=session)
    with pytest.raises(ValueError, match=r"'folds' must be at least 3 for 3 sessions.* \(got 2\)"):
        compared_protocol(samples, "session", 2)


def test_given_parts_bring_their_own(tmp_path):
    touches(tmp_path / "a.npz", part=GIVEN)
    parts = choice_parts(experiment(tmp_path / "a.npz", protocol=Protocol("given")))
    assert [len(part) for part in parts] == [24, 12, 36, 12]
    assert trials(parts.val) == {6, 7, 8}
    given = experiment(tmp_path / "a.npz", protocol=Protocol("given"))
    assert [trials(val) for _, val in choice_cuts(given, 3)[2]] == [{6, 7, 8}]
    touches(tmp_path / "b.npz", part=np.where(GIVEN == 1, 0, GIVEN))
    parts = choice_parts(experiment(tmp_path / "b.npz", protocol=Protocol("given")))
    assert len(parts.train) == 36
    assert not trials(parts.fit) & trials(parts.val)


def test_classes_within_a_trial_are_spread_over_folds(tmp_path):
    found = dataset(tmp_path, y=np.arange(48) % 4)
    protocol = balanced_protocol(found, "trial", 3)
    assert protocol == Protocol("trial", folds=3, stratify="y")


def test_numbers_and_rare_classes_are_not_stratified(tmp_path):
    numbers = dataset(tmp_path, y=np.arange(48) / 7)
    assert balanced_protocol(numbers, "trial", 3).stratify is None
    each = dataset(tmp_path, y=np.arange(12).repeat(4))
    assert balanced_protocol(each, "trial", 3).stratify is None


def test_no_more_folds_than_trials(tmp_path):
    found = dataset(tmp_path, num_trials=3)
    assert balanced_protocol(found, "trial", 5).folds == 3
    one = dataset(tmp_path, trial=np.zeros(48, int))
    with pytest.raises(ValueError, match="at least 2 trials to be split by trial"):
        balanced_protocol(one, "trial")


PERSONS = np.repeat(["ann", "bo", "cy", "di"], 12)


@pytest.mark.parametrize(
    ("changes", "by", "message"),
    [
        ({"group": PERSONS}, "group", "are split by group (4 of them): the scores hold for a new"),
        (
            {"group": PERSONS, "y": np.arange(48) / 7},
            "group",
            "'--by frame' to split single samples",
        ),
        (
            {"group": PERSONS == "ann"},
            "frame",
            "since at least 3 groups are needed to split by group (got 2): if several",
        ),
        ({"group": PERSONS == "ann"}, "frame", "('--by group' holds out whole groups)"),
        (
            {"group": PERSONS, "y": PERSONS},  # objects that are the classes
            "frame",
            "since 4 of 4 classes are in a single group and cannot be learned: if several",
        ),
        ({"session": PERSONS}, "frame", "('--by session' holds out whole sessions)"),
        ({}, "frame", "too high for a new touch"),
    ],
)
def test_samples_without_trials_are_split_by_group_if_there_are_several(
    tmp_path, caplog, changes, by, message
):
    found = dataset(tmp_path, trial=None, **changes)
    assert compared_protocol(found, None, 5).by == by
    assert "the samples have no 'trial' and are split" in caplog.text
    assert message in caplog.text


@pytest.mark.parametrize(
    ("changes", "by", "match"),
    [
        (
            {"trial": np.arange(48) % 2},
            "trial",
            r"3 trials, .* \(got 2\); compare by frame, which is a weaker",
        ),
        ({"group": np.arange(48) % 2}, "group", r"3 groups, .* compare by trial or by frame"),
        ({"trial": None}, "trial", "'by' must be a unit that all samples have: none"),
    ],
)
def test_too_few_units_are_refused(tmp_path, changes, by, match):
    with pytest.raises(ValueError, match=match):
        compared_protocol(dataset(tmp_path, **changes), by, 5)


def test_what_is_predicted_follows_from_the_labels(tmp_path):
    assert not _is_regression(dataset(tmp_path))
    assert _is_regression(dataset(tmp_path, y=np.arange(48) / 7))
    found = dataset(tmp_path)
    found._data.y = torch.zeros(48, 2)
    with pytest.raises(ValueError, match="got 0 and 1 for each of 2 labels"):
        _is_regression(found)
    del found._data.y
    with pytest.raises(ValueError, match=r"'data' must have 'y', .* \(got none\)"):
        _is_regression(found)


@pytest.mark.parametrize(
    ("group", "unit"),
    [
        (np.array([0, 1, 2, 0, 1, 2, 0, 1, 2, 5, 5, 5]), "group"),  # tested on others
        (np.array([0, 1, 2] * 4), "trial"),
    ],
)
def test_validation_holds_out_what_given_parts_hold_out(tmp_path, group, unit):
    part = np.where(GIVEN == 2, 2, 0)
    touches(tmp_path / "a.npz", part=part, group=group.repeat(4))
    given = experiment(tmp_path / "a.npz", protocol=Protocol("given"))
    parts = choice_parts(given)
    apart = [set(one.column(unit).tolist()) for one in parts[:2]]
    assert not set.intersection(*apart)
    if unit == "trial":
        assert set(parts.val.column("group").tolist()) <= set(parts.fit.column("group").tolist())


def test_choice_is_made_on_a_part_of_many_samples(tmp_path):
    touches(tmp_path / "a.npz", num_trials=18)
    one = experiment(tmp_path / "a.npz")
    train, _, cuts = choice_cuts(one, 2, max_samples=10)
    assert [len(part) for part, _ in cuts] == [10, 10]
    assert len(train) == 48
    again = choice_cuts(one, 2, max_samples=10)[2]
    assert [a.trial.tolist() for a, _ in again] == [a.trial.tolist() for a, _ in cuts]
    assert [len(val) for _, val in cuts] == [len(val) for _, val in choice_cuts(one, 2)[2]]
