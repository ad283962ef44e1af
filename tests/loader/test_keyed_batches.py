r"""Transforms that draw by the batch alone."""

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
def test_an_iterator_without_batches_draws_no_random_number(workers):
    batches = loader(num_workers=workers, persistent_workers=workers > 0)
    for _ in range(2):
        before = torch.get_rng_state()
        iter(batches)
        assert torch.get_rng_state().equal(before)
        assert len(list(batches)) == 4
        assert not torch.get_rng_state().equal(before)


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
