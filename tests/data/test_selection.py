from functools import partial

import numpy as np
import pytest
import torch


@pytest.fixture(params=["memory", "file"])
def build(request, toy, tmp_path):
    """Builds the toy data set, in memory or by way of a file."""
    return partial(toy, tmp_path / "toy" if request.param == "file" else None)


@pytest.mark.parametrize(
    ("index", "kept"),
    [
        (slice(2, 5), [2, 3, 4]),
        (slice(None, 0.5), [0, 1, 2]),
        (slice(None, None, -2), [5, 3, 1]),
        (torch.tensor([True, False, False, False, False, True]), [0, 5]),
        (np.array([False, True, False, False, False, False]), [1]),
        (torch.tensor([4, 4, 0]), [4, 4, 0]),
        (np.array([3, 1]), [3, 1]),
        ([-1, 2], [5, 2]),
        ([], []),
        (slice(0, 0), []),
    ],
)
def test_dataset_selection(build, index, kept):
    dataset = build()
    part = dataset[index]
    assert len(part) == len(kept)
    assert part.data.x.equal(dataset.data.x[kept])
    assert part.data.edge_index.equal(dataset.data.edge_index)
    assert [int(data.x[0, 0]) for data in part] == [8 * i for i in kept]
    assert part.batch(range(len(kept))).x.equal(part.data.x)
    assert len(dataset) == 6


def test_dataset_selection_of_a_selection(build):
    first = build()[1:]
    assert first.batch([0]).trial.tolist() == [0]
    part = first[torch.tensor([4, 0])]
    assert part.data.trial.tolist() == [2, 0]
    assert part.batch(torch.tensor([1])).trial.tolist() == [0]
    assert part[1].x[0].tolist() == [8.0, 9.0]


def test_dataset_shuffle_is_a_permutation(build):
    dataset = build()
    torch.manual_seed(1)
    shuffled, order = dataset.shuffle(return_perm=True)
    assert sorted(order.tolist()) == list(range(6))
    assert order.tolist() != list(range(6))
    assert shuffled.data.x.equal(dataset.data.x[order])


@pytest.mark.parametrize("index", [6, -7])
def test_dataset_index_out_of_range(build, index):
    with pytest.raises(IndexError, match="index out of range"):
        build()[index]


def test_batch_of_nothing_and_out_of_range(build):
    assert build().batch([]).x.shape == (0, 4, 2)
    with pytest.raises(IndexError, match="index 6 is out of"):
        build().batch([6])


def test_column_is_that_of_the_selection(build):
    dataset = build()
    assert dataset.column("trial").equal(dataset.data.trial)
    assert dataset[[4, 0]].column("trial").equal(dataset.data.trial[[4, 0]])
    assert dataset.column("nothing") is None
