r"""Epochs that are resumed in their middle, and transforms that draw by the batch alone."""

import random

import numpy as np
import pytest
import torch
from torch_geometric.transforms import BaseTransform, RandomJitter

from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.transforms import DropTaxels


class Draws(BaseTransform):
    """One number of each source, as an attribute of each sample."""

    def __init__(self):
        self.generator = torch.Generator().manual_seed(7)

    def forward(self, data):
        own = torch.rand(1, generator=self.generator)
        numpy = float(np.random.rand())  # noqa: NPY002
        data.drawn = torch.cat([torch.tensor([[random.random(), numpy, own.item()]])])
        return data


def loader(transform=None, size=10, **kwargs):
    dataset = FakeTactileDataset(size, transform=transform)
    return StaticLoader(dataset, 3, **{"shuffle": True, "keyed": True, **kwargs})


def seeds(seed):
    torch.manual_seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    random.seed(seed)


def trials(batches):
    return [batch.trial.tolist() for batch in batches]


@pytest.mark.parametrize("workers", [0, 1])
@pytest.mark.parametrize("num_batches", [1, 3])
def test_resumed_epoch_has_the_batches_that_were_left(num_batches, workers):
    seeds(0)
    first = loader(Draws())
    list(first)
    batches = iter(first)
    for _ in range(num_batches):
        next(batches)
    state = first.state_dict()
    assert state["num_batches"] == num_batches
    left = list(batches)

    seeds(1)
    other = loader(Draws(), num_workers=workers)
    other.load_state_dict(state)
    before = torch.get_rng_state()
    found = list(other)
    assert torch.get_rng_state().equal(before)
    assert trials(found) == trials(left)
    for a, b in zip(found, left, strict=True):
        assert a.drawn.equal(b.drawn)
    assert other.state_dict()["num_batches"] == 4
    assert trials(other) != trials(left)  # a new epoch
    assert sorted(i for batch in trials(other) for i in batch) == list(range(10))


def test_state_in_the_middle_of_a_resumed_epoch():
    seeds(0)
    first = loader()
    batches = iter(first)
    next(batches)
    other = loader()
    other.load_state_dict(first.state_dict())
    expected = next(batches), next(batches)
    assert next(iter(other)).trial.equal(expected[0].trial)
    third = loader()
    third.load_state_dict(other.state_dict())
    assert next(iter(third)).trial.equal(expected[1].trial)


def test_resumed_order_of_a_generator():
    def own(seed):
        return loader(generator=torch.Generator().manual_seed(seed))

    first = own(3)
    batches = iter(first)
    next(batches)
    other = own(8)
    other.load_state_dict(first.state_dict())
    assert trials(other) == trials(batches)
    assert trials(other) == trials(first)  # and the next epoch, from the same generator


@pytest.mark.parametrize("mark", [{}, {"num_batches": 2, "ended": True}])
def test_epoch_that_had_ended_is_followed_by_a_new_one(mark):
    seeds(0)
    first = loader()
    list(first)
    other = loader()
    other.load_state_dict(first.state_dict() | mark)
    before = torch.get_rng_state()
    iter(other)  # draws nothing
    assert torch.get_rng_state().equal(before)
    expected = trials(first)
    torch.set_rng_state(before)
    assert trials(other) == expected


def test_state_before_the_first_epoch():
    first = loader()
    assert first.state_dict() == {"num_batches": 0}
    other = loader()
    other.load_state_dict(first.state_dict())
    assert len(list(other)) == 4


def test_what_transforms_draw_does_not_depend_on_workers():
    found = []
    for workers in (0, 1, 2):
        seeds(5)
        batches = loader(Draws(), num_workers=workers, persistent_workers=workers > 0)
        epochs = [torch.cat([batch.drawn.clone() for batch in batches]) for _ in range(2)]
        assert not epochs[0].equal(epochs[1])
        found.append(torch.cat([*epochs, torch.rand(1, 3)]))  # and the state after them
    assert found[1].equal(found[0])
    assert found[2].equal(found[0])
    assert len(found[0].flatten().unique()) == len(found[0].flatten())


def test_keyed_batches_leave_the_random_states_alone():
    plain, drawing = loader(), loader(DropTaxels(0.5))
    states = []
    for batches in (plain, drawing):
        seeds(0)
        orders = trials(batches)
        numpy = np.random.rand()  # noqa: NPY002
        states.append((orders, torch.rand(1).item(), numpy, random.random()))
    assert states[0] == states[1]


def test_transforms_draw_from_the_global_states_unless_keyed():
    seeds(0)
    (batch,) = StaticLoader(FakeTactileDataset(4, transform=RandomJitter(1.0)), 4)
    seeds(0)
    torch.empty((), dtype=torch.int64).random_()  # the seed of workers
    jittered = [sample.pos for sample in FakeTactileDataset(4, transform=RandomJitter(1.0))]
    assert batch.pos.equal(torch.stack(jittered))


def test_last_index_tells_the_samples_of_a_batch():
    for workers in (0, 1):
        batches = loader(num_workers=workers)
        assert batches.last_index == []
        for batch in batches:
            expected = FakeTactileDataset(10).batch(batches.last_index)
            assert expected.x.equal(batch.x)
    single = StaticLoader(FakeTactileDataset(3), batch_size=None)
    assert [single.last_index for _ in single] == [[0], [1], [2]]


@pytest.mark.parametrize(
    ("state", "match"),
    [
        ({}, r"'num_batches' of the state of a loader must be a number from 0 \(got None\)"),
        ({"num_batches": -1}, r"number from 0 \(got -1\)"),
        ({"num_batches": 2}, r"the random states must be those of PyTorch.*got KeyError"),
    ],
)
def test_state_that_is_something_else_is_an_error(state, match):
    with pytest.raises(ValueError, match=match):
        loader().load_state_dict(state)
