import json
import subprocess
import sys
import warnings

import pytest
import torch

from torch_geometric_tactile.data import Protocol, Split, StaticData, StaticDataset, splits
from torch_geometric_tactile.sensors import grid


def grasps(counts=(6, 4, 3), frames=2):
    """Trials of three objects in turn; the label of an object is its number."""
    group = torch.cat([torch.full((count,), i) for i, count in enumerate(counts)])
    group = group.repeat_interleave(frames)
    trial = torch.arange(sum(counts)).repeat_interleave(frames)
    return StaticData(x=torch.zeros(len(trial), 1, 1), y=group, group=group, trial=trial)


class Named(StaticDataset):
    def __init__(self, data, names=("a", "b", "c"), part=None):
        self.layout, self.content, self.names, self.part = grid(1, 1, 0.01), data, names, part
        super().__init__()

    def read(self):
        return self.content, {"group": list(self.names), "class": list(self.names)}


def count_trials(data, part, key="y"):
    first = {int(t): int(c) for t, c in zip(data.trial[part], data[key][part], strict=True)}
    return torch.tensor([*first.values()], dtype=torch.long).bincount(minlength=3).tolist()


def test_repr_and_defaults():
    assert repr(Protocol()) == (
        "Protocol(by='trial', val=0.1, test=0.2, folds=None, leave_one_out=False, stratify=None, "
        "unseen=None)"
    )
    assert Protocol("trial") == Protocol(val=0.1, test=0.2)
    assert Protocol("frame", folds=3) == Protocol("frame", folds=3, val=0.0)
    assert len({Protocol("frame"), Protocol("frame", test=0.2), Protocol("group")}) == 2


@pytest.mark.parametrize(
    ("protocol", "text"),
    [
        (Protocol("frame"), "by frame, 10 % for validation, 20 % for the test"),
        (
            Protocol("trial", val=0, stratify="group"),
            "by trial, 20 % for the test, stratified by group",
        ),
        (Protocol("group", folds=5), "5 folds by group"),
        (Protocol("trial", folds=3, val=0.25), "3 folds by trial, 25 % for validation"),
        (Protocol("group", leave_one_out=True), "leave one group out"),
        (
            Protocol("group", folds=5, unseen="session"),
            "5 folds by group, each session tested on unseen",
        ),
        (Protocol("given"), "the given parts"),
    ],
)
def test_describe_and_round_trip(protocol, text):
    assert protocol.describe() == text
    content = json.loads(json.dumps(protocol.to_dict()))
    assert Protocol.from_dict(content) == protocol


def test_from_dict_rejects_unknown_keys():
    with pytest.raises(ValueError, match=r"must have keys of \['by', 'val', .* \(got 'k'\)"):
        Protocol.from_dict({"by": "trial", "k": 5})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"by": ""}, r"'by' must be 'frame', 'given' or the name of a unit.* \(got ''\)"),
        ({"by": None}, r"'by' must be 'frame', 'given' or the name of a unit.* \(got None\)"),
        ({"folds": 1}, r"'folds' must be at least 2 \(got 1\)"),
        ({"folds": 3, "test": 0.2}, r"'test' must be None with folds \(got 0.2\)"),
        ({"leave_one_out": True, "folds": 3}, r"'folds' must be None with 'leave_one_out'"),
        ({"leave_one_out": True, "stratify": "y"}, r"'stratify' must be None with 'leave_one_ou"),
        ({"val": 1.0}, r"'val' must be at least 0 and below 1 \(got 1.0\)"),
        ({"val": 0.5, "test": 0.5}, r"'val \+ test' must be at least 0 and below 1"),
        ({"by": "given", "val": 0.1}, r"'val' must be left out with by='given'"),
        ({"unseen": "session"}, r"'unseen' must be None without folds \(got 'session'\)"),
    ],
)
def test_rejects(arguments, message):
    with pytest.raises(ValueError, match=message):
        Protocol(**arguments)


@pytest.mark.parametrize("fold", [-1, 3])
def test_fold_that_is_not_there(fold):
    with pytest.raises(ValueError, match=rf"'fold' must be between 0 and 2 \(got {fold}\)"):
        Protocol("trial", folds=3).split(grasps(), fold=fold)


def test_number_of_folds():
    data = grasps()
    protocols = (
        Protocol("frame"),
        Protocol("given"),
        Protocol("trial", folds=4),
        Protocol("group", leave_one_out=True),
        Protocol("trial", leave_one_out=True),
    )
    assert [protocol.num_folds(data) for protocol in protocols] == [1, 1, 4, 3, 13]


def test_short_forms_are_protocols():
    data = grasps()
    split = Protocol("trial", val=0.2, test=0.3).split(data, seed=4)
    assert isinstance(split, Split)
    assert all(map(torch.equal, split, splits.by_trial(data, 0.2, 0.3, 4)))
    for fold, (train, test) in enumerate(splits.k_fold(data, 3, "trial", seed=2)):
        again = Protocol("trial", folds=3).split(data, 2, fold)
        assert again.train.equal(train)
        assert again.test.equal(test)
        assert len(again.val) == 0


@pytest.mark.parametrize("key", ["y", "group"])
def test_stratified_fractions_take_from_every_class(key):
    data = grasps()
    split = Protocol("trial", val=0.1, test=0.3, stratify=key).split(data, seed=1)
    assert [count_trials(data, part) for part in split] == [[3, 2, 1], [1, 1, 1], [2, 1, 1]]
    assert sorted(torch.cat(list(split)).tolist()) == list(range(26))
    other = Protocol("trial", val=0.1, test=0.3, stratify=key).split(data, seed=2)
    assert not split.test.equal(other.test)


def test_plain_fractions_may_lack_a_class():
    data = grasps()
    plain = [Protocol("trial", val=0, test=0.2).split(data, seed).test for seed in range(20)]
    assert any(0 in count_trials(data, part) for part in plain)
    drawn = Protocol("trial", val=0, test=0.2, stratify="y")
    assert not any(0 in count_trials(data, drawn.split(data, s).test) for s in range(20))


def test_draw_of_a_class_does_not_depend_on_the_others():
    protocol = Protocol("trial", stratify="group")
    both = Named(grasps())
    alone = Named(grasps().index_select(torch.arange(12)))
    test = protocol.split(both, seed=3).test
    assert test[test < 12].equal(protocol.split(alone, seed=3).test)
    renamed = Named(grasps(), names=("x", "y", "z"))
    assert any(
        not protocol.split(renamed, seed).test.equal(protocol.split(both, seed).test)
        for seed in range(5)
    )


def test_stratified_frames_and_rows_of_labels():
    y = torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]).repeat(10, 1)
    data = StaticData(x=torch.zeros(30, 1, 1), y=y)
    split = Protocol("frame", stratify="y").split(data)
    assert [len(part) for part in split] == [21, 3, 6]
    for part in split:
        assert y[part].unique(dim=0, return_counts=True)[1].tolist() == [len(part) // 3] * 3


@pytest.mark.parametrize("by", ["frame", "trial"])
def test_stratified_folds_have_every_class(by):
    data = grasps((6, 6, 3), frames=4)
    protocol = Protocol(by, folds=3, stratify="y")
    parts = [protocol.split(data, seed=5, fold=fold) for fold in range(3)]
    for part in parts:
        assert (count_trials(data, part.test) == [2, 2, 1]) == (by == "trial")
        assert data.y[part.test].bincount().tolist() == [8, 8, 4]
    assert sorted(torch.cat([part.test for part in parts]).tolist()) == list(range(60))
    plain = [Protocol(by, folds=3).split(data, 5, fold).test for fold in range(3)]
    assert any(data.y[part].bincount(minlength=3).tolist() != [8, 8, 4] for part in plain)


def test_stratified_folds_of_groups_with_several_classes():
    group = torch.arange(6).repeat_interleave(10)
    y = ((torch.arange(60) % 10) < group + 2).long()
    data = StaticData(x=torch.zeros(60, 1, 1), y=y, group=group)
    protocol = Protocol("group", folds=3, stratify="y")
    tests = [protocol.split(data, fold=fold).test for fold in range(3)]
    assert [group[test].unique().numel() for test in tests] == [2, 2, 2]
    assert sorted(torch.cat(tests).tolist()) == list(range(60))
    with pytest.raises(ValueError, match=r"all samples of a group must have the same 'y'"):
        Protocol("group", stratify="y").split(data)


def test_validation_part_of_a_fold():
    data = grasps()
    protocol = Protocol("trial", folds=3, val=0.25)
    for fold in range(3):
        split = protocol.split(data, 7, fold)
        whole = Protocol("trial", folds=3).split(data, 7, fold)
        assert split.test.equal(whole.test)
        assert torch.cat([split.train, split.val]).sort()[0].equal(whole.train)
        assert not set(data.trial[split.train].tolist()) & set(data.trial[split.val].tolist())
        assert len(split.val) == 4
    stratified = Protocol("trial", folds=3, val=0.25, stratify="y").split(data, 7)
    assert count_trials(data, stratified.val) == [1, 1, 1]


def test_too_few_of_a_class():
    data = grasps((4, 1, 3))
    with pytest.raises(ValueError, match=r"class '1' must have at least 2 trials to .* \(got 1\)"):
        Protocol("trial", stratify="y").split(data)
    with pytest.raises(ValueError, match=r"object 'b' must have at least 2 trials to .* \(got 1\)"):
        Protocol("trial", stratify="group").split(Named(data))
    message = r"3 folds will lack a class, since these have fewer trials than folds: 'b' \(1\)$"
    with pytest.warns(UserWarning, match=message):
        Protocol("trial", folds=3, stratify="y").split(Named(data))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Protocol("trial", folds=3).split(data)
        Protocol("frame", folds=2, stratify="y").split(data)
    with pytest.raises(ValueError, match=r"'folds' must be at most 4 .* the most frequent class"):
        Protocol("trial", folds=5, stratify="y").split(data)


def test_stratify_needs_integers():
    data = grasps()
    data.score = torch.linspace(0, 1, 26)
    with pytest.raises(ValueError, match="'score' must hold integers to be stratified by"):
        Protocol("trial", stratify="score").split(data)
    with pytest.raises(
        ValueError, match=r"'stratify' must be a unit .*: 'group', 'trial' \(got 'joint'"
    ):
        Protocol("trial", stratify="joint").split(data)


def test_given_parts():
    part = torch.tensor([0, 0, 2, 1, 0, 2])
    data = StaticData(x=torch.zeros(6, 1, 1), part=part)
    split = Protocol("given").split(data)
    assert [indices.tolist() for indices in split] == [[0, 1, 4], [3], [2, 5]]
    assert all(map(torch.equal, split, Protocol("given").split(Named(data))))
    brought = Named(StaticData(x=torch.zeros(6, 1, 1)), part=part)
    assert all(map(torch.equal, split, Protocol("given").split(brought)))
    with pytest.raises(
        ValueError, match=r"must have a 'part' for each sample with by='given'.* \(got none"
    ):
        Protocol("given").split(grasps())
    data.part = part + 1
    with pytest.raises(ValueError, match=r"'part' must hold 0, 1 and 2 \(got \[1, 2, 3\]\)"):
        Protocol("given").split(data)


@pytest.mark.full
def test_import_leaves_scikit_learn_out():
    names = ", ".join(
        f"torch_geometric_tactile.{name}" for name in ("sensors", "data.splits", "data")
    )
    code = f"import sys, {names}; sys.exit('sklearn' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_stratify_auto_takes_the_classes_where_they_allow():
    generator = torch.Generator().manual_seed(0)
    y = torch.tensor([0, 0, 0, 0, 0, 0, 0, 1, 1, 1])
    trial = torch.arange(10)
    data = StaticData(x=torch.randn(10, 1, 1, generator=generator), y=y, trial=trial)
    auto, plain = (Protocol("trial", val=0, test=0.3, stratify=key) for key in ("auto", None))
    by_class = Protocol("trial", val=0, test=0.3, stratify="y")
    for seed in range(8):
        assert all(map(torch.equal, auto.split(data, seed), by_class.split(data, seed)))
    assert any(not y[plain.split(data, seed).test].any() for seed in range(8))  # lacks class 1
    folds = Protocol("trial", folds=3, stratify="auto")
    assert all(y[folds.split(data, fold=fold).test].sum() == 1 for fold in range(3))
    # Too few of a class, several classes in a unit, no integers or no labels: as without.
    one = StaticData(x=data.x, y=torch.tensor([0] * 9 + [1]), trial=trial)
    mixed = StaticData(x=data.x, y=torch.arange(10) % 2, trial=trial // 2)
    numbers = StaticData(x=data.x, y=torch.rand(10, generator=generator), trial=trial)
    for other in (one, mixed, numbers, StaticData(x=data.x, trial=trial)):
        assert all(map(torch.equal, auto.split(other, 1), plain.split(other, 1)))
    assert auto.describe().endswith("stratified by class where classes allow")


def test_unseen_sessions_are_tested_on_by_what_never_saw_them():
    group = torch.arange(60) % 10
    session = torch.arange(60) // 20 * 3  # 0, 3 and 6
    data = StaticData(x=torch.zeros(60, 1, 1), y=group % 2, group=group, session=session)
    protocol = Protocol("group", folds=5, unseen="session", val=0.2)
    assert protocol.num_folds(data) == 15
    tested = []
    for fold in range(15):
        train, val, test = protocol.split(data, seed=1, fold=fold)
        plain = Protocol("group", folds=5, val=0.2).split(data, seed=1, fold=fold // 3)
        assert session[test].unique().tolist() == [fold % 3 * 3]
        assert not torch.isin(session[test].unique(), session[torch.cat([train, val])])
        assert torch.isin(test, plain.test).all()
        assert torch.isin(train, plain.train).all()
        assert torch.isin(val, plain.val).all()
        assert (len(train), len(val), len(test)) == (24, 8, 4)  # two of ten groups, one session
        tested += test.tolist()
    assert sorted(tested) == list(range(60))
    with pytest.raises(ValueError, match=r"'fold' must be between 0 and 14 \(got 15\)"):
        protocol.split(data, fold=15)


def test_unseen_in_one_group_after_the_other():
    group = torch.tensor([0, 0, 1, 1, 2, 2])
    session = torch.tensor([0, 1, 0, 1, 0, 0])
    data = StaticData(x=torch.zeros(6, 1, 1), group=group, session=session)
    protocol = Protocol("group", leave_one_out=True, unseen="session")
    assert protocol.num_folds(data) == 6
    assert [part.tolist() for part in protocol.split(data, fold=1)] == [[2, 4, 5], [], [1]]
    with pytest.raises(ValueError, match=r"samples of 'session' 1 in each fold .* in fold 2\)"):
        protocol.split(data, fold=5)
    data.session = torch.zeros(6, dtype=torch.long)
    with pytest.raises(ValueError, match=r"at least 2 values of 'session' .*\(got 1\)"):
        protocol.split(data, fold=0)
    del data.session
    with pytest.raises(ValueError, match=r"'unseen' must be a unit .*: 'group' \(got 'session'"):
        protocol.num_folds(data)
