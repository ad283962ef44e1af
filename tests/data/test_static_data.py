import copy
import pickle

import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData

EDGES = torch.tensor([[0, 1], [1, 0]])


def two_taxels(samples=3, **kwargs):
    x = torch.arange(samples * 4.0).view(samples, 2, 2)
    return StaticData(x=x, edge_index=EDGES, y=torch.arange(samples), **kwargs)


def test_static_data_repr_and_counts():
    data = two_taxels()
    assert repr(data) == "StaticData(x=[3, 2, 2], edge_index=[2, 2], y=[3])"
    assert (data.num_samples, data.num_nodes, data.num_features, data.num_edges) == (3, 2, 2, 2)


def test_sample_by_hand():
    pos = torch.zeros(2, 3)
    sample = two_taxels(pos=pos, force=torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])).sample(1)
    assert type(sample) is Data
    assert sample.x.tolist() == [[4.0, 5.0], [6.0, 7.0]]
    assert sample.y.tolist() == [1]
    assert sample.force.tolist() == [[3.0, 4.0]]
    assert sample.edge_index is EDGES
    assert sample.pos is pos


@pytest.mark.parametrize("i", [-3, -1, 0, 2])
def test_sample_counts_from_both_ends(i):
    assert two_taxels().sample(i).y.tolist() == [i % 3]


@pytest.mark.parametrize("i", [3, -4])
def test_sample_out_of_range(i):
    with pytest.raises(IndexError, match=rf"'i' must be below 3 \(got {i}\)"):
        two_taxels().sample(i)


@pytest.mark.parametrize("shape", [(4,), (4, 3), (1, 2, 3, 4)])
def test_static_data_rejects_x_of_other_dimensions(shape):
    with pytest.raises(ValueError, match=r"'x' must have shape \(num_samples, num_nodes"):
        StaticData(x=torch.zeros(shape))


def test_is_shared_tells_by_dimensions_of_known_names():
    shared = {"pos": torch.zeros(2, 3), "edge_attr": torch.zeros(2, 1), "edge_weight": EDGES[0]}
    own = {key: torch.stack([value] * 3) for key, value in shared.items()}
    assert all(two_taxels(**shared).is_shared(key) for key in shared)
    assert not any(two_taxels(**own).is_shared(key) for key in own)
    assert two_taxels(**own).sample(1).edge_attr.shape == (2, 1)


@pytest.mark.parametrize("key", ["pos", "normal"])
def test_is_shared_where_there_are_as_many_taxels_as_samples(key):
    data = two_taxels(samples=2, **{key: torch.zeros(2, 3)})
    assert data.is_shared(key)
    assert data.sample(0)[key].shape == (2, 3)


def test_is_shared_says_no_to_x_and_yes_to_index_text_and_scalars():
    data = two_taxels(patch_index=torch.tensor([0, 1, 2]), note="dry", rate=torch.tensor(50.0))
    assert not data.is_shared("x")
    assert data.is_shared("patch_index")
    assert data.is_shared("note")
    assert data.is_shared("rate")


def test_shared_names_win_over_sizes():
    gain = torch.tensor([1.0, 2.0, 3.0])
    assert not two_taxels(gain=gain).is_shared("gain")
    data = two_taxels(gain=gain, shared=["gain"])
    assert data.shared == {"gain"}
    assert data.sample(0).gain is gain
    assert data.index_select(torch.tensor([2])).gain is gain


@pytest.mark.parametrize(
    "duplicate",
    [copy.copy, copy.deepcopy, StaticData.clone, lambda d: pickle.loads(pickle.dumps(d))],
)
def test_copies_keep_shared(duplicate):
    data = duplicate(two_taxels(gain=torch.ones(3), shared=["gain"]))
    assert isinstance(data, StaticData)
    assert data.shared == {"gain"}
    assert data.sample(0).gain.shape == (3,)


@pytest.mark.parametrize(
    ("index", "kept"),
    [
        (slice(1, None), [1, 2]),
        (torch.tensor([2, 0, 2]), [2, 0, 2]),
        (torch.tensor([True, False, True]), [0, 2]),
        (torch.tensor([-1]), [2]),
        (torch.tensor([], dtype=torch.long), []),
    ],
)
def test_index_select_takes(index, kept):
    data = two_taxels()
    out = data.index_select(index)
    assert out.y.tolist() == kept
    assert out.x.equal(data.x[kept])
    assert out.x.shape == (len(kept), 2, 2)
    assert out.edge_index is EDGES
    assert data.num_samples == 3


def test_index_select_slice_copies_nothing():
    data = two_taxels()
    assert data.index_select(slice(0, 2)).x.data_ptr() == data.x.data_ptr()


def test_index_select_to_as_many_samples_as_a_shared_attribute_has_rows():
    bias = torch.tensor([0.5, 1.5])
    data = two_taxels(bias=bias)
    assert data.sample(0).bias is bias
    assert data.index_select(torch.tensor([0, 1])).sample(0).bias is bias


def test_index_select_lets_samples_get_positions_of_their_own():
    data = two_taxels(pos=torch.zeros(2, 3)).index_select(slice(0, 2))
    data.pos = torch.ones(2, 2, 3)
    assert data.sample(0).pos.shape == (2, 3)


def test_empty_static_data():
    data = two_taxels(samples=0)
    assert (data.num_samples, data.num_nodes) == (0, 2)
    assert data.to_data_list() == []
    with pytest.raises(IndexError, match="'i' must be below 0"):
        data.sample(0)


def test_single_taxel_and_sample():
    data = StaticData(x=torch.ones(1, 1, 1), pos=torch.zeros(1, 3), y=torch.tensor([1]))
    assert data.is_shared("pos")
    assert data.sample(0).x.shape == (1, 1)
    assert data.sample(0).pos.shape == (1, 3)
    assert data.sample(0).y.tolist() == [1]


MARKS = {"absolute": torch.zeros(2, 4), "dropped": torch.zeros(2), "missing": torch.zeros(2)}


@pytest.mark.parametrize("samples", [1, 2, 3])  # also as many as taxels
@pytest.mark.parametrize("key", MARKS)
def test_is_shared_of_marks_of_the_taxels(key, samples):
    once, own = MARKS[key], torch.stack([MARKS[key]] * samples)
    data = two_taxels(samples, **{key: once})
    assert data.is_shared(key)
    assert not data.has_elements(key)
    assert data.sample(0)[key] is once
    assert data.index_select(slice(0, 1)).sample(0)[key] is once
    data = two_taxels(samples, **{key: own + torch.arange(samples).view(-1, *[1] * once.dim())})
    assert not data.is_shared(key)
    assert data.has_elements(key)
    assert data.sample(0)[key].shape == once.shape
    assert data.index_select(slice(0, 1))[key].shape == (1, *once.shape)
    again = StaticData.from_data_list(data.to_data_list())
    assert torch.equal(again.sample(-1)[key], data.sample(-1)[key])


@pytest.mark.parametrize("key", MARKS)
def test_is_shared_leaves_marks_of_the_samples_alone(key):
    value = torch.arange(3.0) if MARKS[key].dim() == 1 else torch.arange(15.0).view(3, 5)
    data = two_taxels(**{key: value})
    assert not data.is_shared(key)
    assert not data.has_elements(key)
    assert torch.equal(data.sample(1)[key], value[1:2])
    assert torch.equal(data.index_select(torch.tensor([2]))[key], value[2:])
    again = StaticData.from_data_list(data.to_data_list())
    assert torch.equal(again[key], value)
    assert not again.is_shared(key)


def test_share_adds_to_the_shared_of_this_one_only():
    data = two_taxels(gain=torch.ones(3), shared=["bias"])
    other = copy.copy(data)
    other.share("gain")
    assert other.shared == {"bias", "gain"}
    assert other.sample(0).gain.shape == (3,)
    assert data.shared == {"bias"}
