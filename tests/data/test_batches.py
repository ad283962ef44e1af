"""Samples of parts of data sets, and of several in one."""

import pytest
import torch
from torch.utils.data import ConcatDataset, Subset

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.data._batches import (
    check_joinable,
    join_batches,
    static_batch,
    static_parts,
)
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(1, 2, pitch=0.01)


def numbered(start, num_samples=3, layout=LAYOUT, **kwargs):
    """Samples whose readings and group are their number."""
    number = torch.arange(start, start + num_samples)
    x = number.float().view(-1, 1, 1).expand(-1, 2, 1)
    return StaticDataset.from_arrays(x, layout=layout, group=number, **kwargs)


def several():
    return ConcatDataset([numbered(0), Subset(numbered(10), [2, 0]), numbered(20, 1)])


def test_parts_of_nested_data_sets_in_their_order():
    first, second, third = numbered(0), numbered(10), numbered(20)
    nested = ConcatDataset([Subset(first, [0]), ConcatDataset([second, third])])
    assert list(static_parts(nested)) == [first, second, third]
    with pytest.raises(TypeError, match=r"or ConcatDataset of them \(got list\)"):
        list(static_parts(ConcatDataset([first, [1]])))


@pytest.mark.parametrize(
    ("index", "expected"),
    [
        ([0, 1, 2], [0, 1, 2]),
        ([3, 4], [12, 10]),
        ([5, 3, 0, 4, 2], [20, 12, 0, 10, 2]),
        ([-1, -6], [20, 0]),
        ([], []),
    ],
)
def test_batch_of_several_data_sets(index, expected):
    batch = static_batch(several(), index)
    assert batch.group.tolist() == batch.x[:, 1, 0].tolist() == expected
    assert batch.pos.equal(LAYOUT.pos)  # once for all


def of_values(**values):
    return StaticData(x=torch.zeros(1, 2, 1), **values)


@pytest.mark.parametrize(
    ("other", "match"),
    [
        (
            {"y": torch.ones(1), "note": "wet"},
            "'note' must be equal in all batches, since their samples",
        ),
        (
            {"y": torch.ones(1, 2), "note": "dry"},
            r"'y' must have one type and shape in all batches \(got .*\(2,\)",
        ),
        ({"y": torch.ones(1).long(), "note": "dry"}, "'y' must have one type and shape"),
        (
            {"note": "dry"},
            r"the same attributes \(got \['y'\] only in part 0 or only in part 1",
        ),
    ],
)
def test_batches_that_cannot_be_joined(other, match):
    first, places = of_values(y=torch.ones(1), note="dry"), [torch.tensor([1]), torch.tensor([0])]
    with pytest.raises(ValueError, match=match):
        join_batches([first, of_values(**other)], places)


def test_joined_positions_are_shared_as_long_as_they_are_equal():
    places = [torch.tensor([1]), torch.tensor([0])]
    pos = torch.rand(2, 3)
    batches = [of_values(pos=pos, note="dry"), of_values(pos=pos.clone(), note="dry")]
    assert join_batches(batches, places).pos.equal(pos)
    batches[1].pos = pos + 1
    assert join_batches(batches, places).pos.equal(torch.stack([pos + 1, pos]))
    assert join_batches(batches, places).note == "dry"
    declared = {"gain": torch.ones(1), "shared": ["gain"]}
    batches = [of_values(**declared), of_values(**declared | {"gain": torch.zeros(1)})]
    with pytest.raises(ValueError, match="'gain' must be equal in all batches"):
        join_batches(batches, places)


@pytest.mark.parametrize(
    ("other", "match"),
    [
        (
            lambda: numbered(3, layout=grid(2, 1, 0.01)),
            r"have the layout of part 0, 'grid_1x2' \(got",
        ),
        (
            lambda: numbered(3, edge_index=[[0], [1]]),
            "the same edges .*got different edges in part 2",
        ),
        (lambda: numbered(3, force=torch.ones(3)), r"same attributes \(got \['force'\]"),
        (
            lambda: numbered(3, group_names=list("abcdef")),
            r"part 2 of 'dataset' must have the group_names of the first, \[\], since 'group'",
        ),
    ],
)
def test_samples_of_parts_that_cannot_be_in_one_batch(other, match):
    empty = numbered(0, group_names=["other"])[:0]  # of which only the layout counts
    check_joinable([empty, numbered(0), numbered(3)])
    with pytest.raises(ValueError, match=match):
        check_joinable([empty, numbered(0), other()])
