import warnings

import pytest
import torch
from mixed_sensors import Gloves, gloves
from torch.utils.data import ConcatDataset, Subset
from torch_geometric.data import Batch, Data, HeteroData

from torch_geometric_tactile.data import Protocol, StaticData, StaticDataset, splits
from torch_geometric_tactile.data._graph_samples import GraphSamples, as_samples, sample_column
from torch_geometric_tactile.data.splits import SharedDataWarning
from torch_geometric_tactile.sensors import grid

SAMPLES = gloves()
# Each has all samples, in their order.
KINDS = {
    "list": lambda: SAMPLES,
    "tuple": lambda: tuple(SAMPLES),
    "data set": Gloves,
    "subset": lambda: Subset(Gloves(), range(len(SAMPLES))),
    "joined": lambda: ConcatDataset([SAMPLES[:30], Gloves()[30:50], SAMPLES[50:]]),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("by", ["group", "trial", "frame"])
def test_every_kind_is_split_alike(name, by):
    protocol = Protocol(by, val=0.2, test=0.2, stratify=None)
    expected = protocol.split(SAMPLES)
    for found, wanted in zip(protocol.split(KINDS[name]()), expected, strict=True):
        assert found.equal(wanted)


def test_no_subject_is_in_two_parts():
    parts = Protocol("group", val=0.25, test=0.25).split(SAMPLES)
    subjects = [{SAMPLES[i].group for i in part} for part in parts]
    assert [len(part) for part in subjects] == [6, 3, 3]
    assert len(set.union(*subjects)) == 12


def test_folds_by_text_and_unseen_sessions():
    protocol = Protocol("session", leave_one_out=True)
    assert protocol.num_folds(SAMPLES) == 3
    tested = [{SAMPLES[i].session for i in protocol.split(SAMPLES, fold=i).test} for i in range(3)]
    assert tested == [{"day 0"}, {"day 1"}, {"day 2"}]
    both = Protocol("trial", folds=2, unseen="session")
    train, _, test = both.split(SAMPLES)
    assert {SAMPLES[i].session for i in test} == {"day 0"}
    assert "day 0" not in {SAMPLES[i].session for i in train}


def test_stratified_by_class():
    split = Protocol("trial", folds=4, stratify="y").split(SAMPLES)
    assert torch.tensor([SAMPLES[i].y for i in split.test]).bincount().tolist() == [9, 9]


def test_given_parts():
    samples = [Data(x=torch.ones(3, 1), part=part) for part in (0, 2, 1, 0)]
    assert [part.tolist() for part in Protocol("given").split(samples)] == [[0, 3], [2], [1]]


def test_subset_of_static_samples_stays_one_topology():
    dataset = StaticDataset.from_arrays(
        torch.rand(6, 4, 1), torch.arange(6), layout=grid(2, 2, 0.01)
    )
    part = as_samples(Subset(Subset(dataset, [1, 3, 5]), [0, 2]))
    assert isinstance(part, StaticDataset)
    assert part.column("y").tolist() == [1, 5]
    data = dataset.data
    assert as_samples(data) is data


def test_columns():
    samples = [
        Data(x=torch.ones(n, 1), a=n, b=torch.tensor(0.5 * n), c=torch.tensor([n]), d=f"n{n}")
        for n in (3, 2)
    ]
    for i, sample in enumerate(samples):
        sample.y = torch.tensor([[i, 1.0]])
    found = GraphSamples(samples)
    assert found.column("a").tolist() == [3, 2]
    assert found.column("b").tolist() == [1.5, 1.0]
    assert found.column("c").tolist() == [3, 2]
    assert found.column("d").tolist() == [1, 0]
    assert found.column("y").tolist() == [[0, 1], [1, 1]]
    assert found.column("e") is None
    assert found[torch.tensor([1])].column("a").tolist() == [2]
    assert found[[True, False]].indices() == [0]
    assert sample_column(found[1:], "a").tolist() == [2]
    assert (found.num_taxels, found.is_mixed, found.num_classes) == ((2, 3), True, 2)
    assert found.describe_taxels() == "2 to 3 taxels"
    assert found[:1].describe_taxels() == "3 taxels"


def test_texts_of_classes_and_sessions_become_numbers():
    samples = [Data(x=torch.ones(2, 1), y=name, session=name) for name in ("b", "a", "b")]
    found = GraphSamples(samples)
    assert found.class_names == found.session_names == ["a", "b"]
    assert found.batch([0, 1]).y.tolist() == [1, 0]
    assert samples[0].y == "b"


def test_transform_comes_behind_that_of_the_data_set():
    def double(data):
        data.x = 2 * data.x
        return data

    def plus_one(data):
        data.x = data.x + 1
        return data

    samples = GraphSamples(Gloves(transform=double))
    samples.transform = plus_one
    raw = Gloves()
    assert samples[3].x.equal(2 * raw[3].x + 1)
    batch = samples.batch([3, 40])
    assert isinstance(batch, Batch)
    assert batch.x.equal(torch.cat([2 * raw[i].x + 1 for i in (3, 40)]))


@pytest.mark.parametrize(
    ("samples", "error", "text"),
    [
        (3, TypeError, r"'dataset' must be a data set of PyG, .* or a list of Data \(got int\)"),
        ([], ValueError, r"'dataset' must hold at least one sample \(got none\)"),
        (["a"], TypeError, r"'dataset' must hold .*Data objects, .* \(got str\)"),
        ([HeteroData()], TypeError, r"with one kind of nodes \(got HeteroData\)"),
    ],
)
def test_what_is_no_sample_is_refused(samples, error, text):
    with pytest.raises(error, match=text):
        Protocol("frame").split(samples)


def test_attributes_that_cannot_be_split_by():
    with pytest.raises(
        ValueError, match=r"'by' must be a unit that all samples have: .* \(got 'placement'"
    ):
        Protocol("placement").split(SAMPLES)
    some = [Data(x=torch.ones(2, 1), trial=0), Data(x=torch.ones(2, 1))]
    with pytest.raises(
        ValueError, match=r"sample 1 must have 'trial', like the other samples.*\(got none\)"
    ):
        Protocol("trial").split(some)
    rows = [Data(x=torch.ones(2, 1), trial=torch.tensor([1, 1])) for _ in range(2)]
    with pytest.raises(
        ValueError, match=r"'trial' must be a number in each .*\(got \(2,\) in samp"
    ):
        Protocol("trial").split(rows)
    several = [Data(x=torch.ones(2, 1), y=torch.ones(1, i + 1)) for i in range(2)]
    with pytest.raises(ValueError, match="'y' must have the same shape in all samples"):
        GraphSamples(several).column("y")
    with pytest.raises(
        ValueError, match="'dataset' must have a 'part' for each sample with by='given'"
    ):
        Protocol("given").split(SAMPLES)


def test_numbers_of_joined_data_sets_must_mean_the_same():
    class Named(StaticDataset):
        def __init__(self, names):
            self.layout, self.names = grid(1, 1, 0.01), names
            super().__init__()

        def read(self):
            data = StaticData(x=torch.rand(4, 1, 1), group=torch.tensor([0, 0, 1, 1]))
            return data, {"group": self.names}

    same = ConcatDataset([Named(["cup", "pen"]), Named(["cup", "pen"])])
    assert len(Protocol("group", val=0, test=0.5).split(same).test) == 4
    others = ConcatDataset([Named(["cup", "pen"]), Named(["pen", "cup"])])
    with pytest.raises(ValueError, match=r"part 1 of 'dataset' must have the group_names"):
        Protocol("group", val=0, test=0.5).split(others)


def test_copies_of_recordings_on_both_sides_are_told():
    samples = gloves(4, 2)
    twice = [*samples, *(sample.clone() for sample in samples[:2])]
    for i, sample in enumerate(twice):
        sample.trial, sample.part = i, 2 * (i >= len(samples))
    with pytest.warns(SharedDataWarning, match=r"2 trials have the same readings.*trial 8 is tria"):
        split = Protocol("given").split(twice)
    assert splits.shared_recordings(twice, split) == [(8, 0), (9, 1)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Protocol("given").split(twice[:-2] + [_noisy(sample) for sample in twice[-2:]])


def _noisy(sample):
    sample = sample.clone()
    sample.x = sample.x + 1
    return sample
