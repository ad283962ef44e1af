import pytest
import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.nn import EdgeConv, GATConv, GCNConv
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.testing import (
    assert_permutation_equivariant,
    assert_static_equals_batched,
    assert_streaming_equals_window,
    assert_transform_static_equals_batched,
)

EDGE_INDEX = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 1]])


def normal(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0))


def sum_over_leading_dim(x: Tensor, edge_index: Tensor) -> Tensor:
    return x - x.mean(0, keepdim=True)  # samples in one form, taxels in the other


def add_node_number(x: Tensor, edge_index: Tensor) -> Tensor:
    return x + torch.arange(x.size(-2)).view(-1, 1)


def first_edge_only(x: Tensor, edge_index: Tensor) -> Tensor:
    out = torch.zeros_like(x)
    out[..., edge_index[1, 0], :] = x[..., edge_index[0, 0], :]
    return out


class CenterSamples(BaseTransform):
    supports_static = True

    def forward(self, data: Data) -> Data:
        data.x = data.x - data.x.mean()  # over all samples at once
        return data


class AddNumber(BaseTransform):
    supports_static = True

    def forward(self, data: Data) -> Data:
        if isinstance(data, StaticData):
            data.number = torch.zeros(data.num_samples)
        return data


class NameKind(BaseTransform):
    supports_static = True

    def forward(self, data: Data) -> Data:
        data.kind = type(data).__name__
        return data


class Double(BaseTransform):
    supports_static = True

    def forward(self, data: Data) -> Data:
        data.x = 2 * data.x
        return data


@pytest.mark.parametrize("layer", [GCNConv(3, 5), lambda x, edge_index: x.relu()])
def test_assert_static_equals_batched_green(layer):
    assert_static_equals_batched(layer, normal(6, 4, 3), EDGE_INDEX)


def test_assert_static_equals_batched_edge_attr():
    def weigh(x, edge_index, edge_attr):
        out = torch.zeros_like(x)
        messages = x[..., edge_index[0], :] * edge_attr
        return out.index_add(-2, edge_index[1], messages)

    assert_static_equals_batched(weigh, normal(6, 4, 3), EDGE_INDEX, normal(4, 1))
    assert_static_equals_batched(weigh, normal(6, 4, 3), EDGE_INDEX, normal(6, 4, 3))
    assert_static_equals_batched(GCNConv(3, 5), normal(6, 4, 3), EDGE_INDEX, normal(4).abs())


def test_assert_static_equals_batched_red():
    law = r"function must give the same output on \(B, N, F\) as on each sample: .* is \d.*allowed"
    with pytest.raises(AssertionError, match=law):
        assert_static_equals_batched(sum_over_leading_dim, normal(6, 4, 3), EDGE_INDEX)
    with pytest.raises(AssertionError, match="as on PyG's batch"):
        assert_static_equals_batched(add_node_number, normal(6, 4, 3), EDGE_INDEX)
    with pytest.raises(AssertionError, match="the shapes differ"):
        assert_static_equals_batched(lambda x, e: x[:1], normal(6, 4, 3), EDGE_INDEX)
    with pytest.raises(AssertionError, match="difference is nan"):
        assert_static_equals_batched(
            lambda x, e: x / 0 - x / 0 if x.dim() == 3 else x, normal(6, 4, 3), EDGE_INDEX
        )


@pytest.mark.parametrize("size", [(4, 3), (0, 4, 3)])
def test_assert_static_equals_batched_shape(size):
    with pytest.raises(ValueError, match="at least one sample"):
        assert_static_equals_batched(GCNConv(3, 5), torch.zeros(size), EDGE_INDEX)


def test_assert_permutation_equivariant_green():
    for layer in (GCNConv(3, 5), GATConv(3, 5), EdgeConv(torch.nn.Linear(6, 5))):
        assert_permutation_equivariant(layer, normal(4, 3), EDGE_INDEX)
    assert_permutation_equivariant(GCNConv(3, 5), normal(6, 4, 3), EDGE_INDEX, seed=1)
    weight = torch.tensor([1.0, 2.0, 3.0, 4.0])
    assert_permutation_equivariant(GCNConv(3, 5), normal(4, 3), EDGE_INDEX, edge_attr=weight)


@pytest.mark.parametrize("layer", [add_node_number, first_edge_only])
def test_assert_permutation_equivariant_red(layer):
    with pytest.raises(AssertionError, match=r"function must be permutation equivariant: .* is"):
        assert_permutation_equivariant(layer, normal(4, 3), EDGE_INDEX)


def test_assert_permutation_equivariant_never_identity():
    edge_index = torch.tensor([[0], [1]])
    for seed in range(5):  # some of them draw the identity of two nodes
        with pytest.raises(AssertionError, match="permutation"):
            assert_permutation_equivariant(add_node_number, normal(2, 1), edge_index, seed)


def test_assert_transform_static_equals_batched_green():
    data = StaticData(x=normal(3, 4, 2), edge_index=EDGE_INDEX, y=torch.arange(3), unit="counts")
    data.x[1, 2, 0] = torch.nan
    assert_transform_static_equals_batched(Double(), data)


@pytest.mark.parametrize(
    ("transform", "match"),
    [
        (CenterSamples(), r"sample 0, in 'x': the largest difference"),
        (AddNumber(), r"the attributes differ, \['x'\] and \['number', 'x'\]"),
        (NameKind(), r"in 'kind': 'Data' and 'StaticData' differ"),
    ],
)
def test_assert_transform_static_equals_batched_red(transform, match):
    match = f"{type(transform).__name__} must give the same attributes on StaticData .*{match}"
    with pytest.raises(AssertionError, match=match):
        assert_transform_static_equals_batched(transform, StaticData(x=normal(3, 4, 2)))


def test_assert_transform_static_equals_batched_red_on_batch():
    def number_nodes(data):
        x = data.x + torch.arange(data.x.size(-2)).view(-1, 1)
        data = data.clone()
        data.x = x
        return data

    with pytest.raises(
        AssertionError, match=r"must give the same attributes on PyG's batch .* in 'x'"
    ):
        assert_transform_static_equals_batched(number_nodes, StaticData(x=normal(3, 4, 2)))
    with pytest.raises(ValueError, match="at least one sample"):
        assert_transform_static_equals_batched(Double(), StaticData(x=normal(0, 4, 2)))


class Average(torch.nn.Module):
    """The mean of the last frames, also one by one; it can be told to do something wrong."""

    receptive_field = 3

    def __init__(self, wrong: str = "") -> None:
        super().__init__()
        self.wrong = wrong

    def forward(self, x: Tensor, edge_index: Tensor | None = None) -> Tensor:
        last = x[..., -3:].sum(dim=-1)
        return last + 1 if self.wrong == "window" and x.size(-1) == 3 else last

    def initial_state(self, batch_size: int, device: object, dtype: torch.dtype) -> Tensor:
        return torch.full((batch_size, 4, 2), 1.0 if self.wrong == "state" else 0.0, dtype=dtype)

    def step(
        self, frame: Tensor, edge_index: Tensor | None, state: Tensor
    ) -> tuple[Tensor, Tensor]:
        rows = torch.cat([state, frame], dim=-1)
        return rows.sum(dim=-1), rows[..., 1:]


def test_assert_streaming_equals_window_green():
    for dtype in (torch.float, torch.double):
        assert_streaming_equals_window(Average(), normal(2, 4, 6).to(dtype), 6)


def test_assert_streaming_equals_window_red():
    law = r"Average must give the same output after frame 0 as on frames 0 to 0: the largest diff"
    with pytest.raises(AssertionError, match=law):
        assert_streaming_equals_window(Average("state"), normal(2, 4, 6), 6)
    model = Average("window")
    with pytest.raises(AssertionError, match=r"after frame 2 .* frames 0 to 2: the largest"):
        assert_streaming_equals_window(model, normal(2, 4, 6), 6)
    model.wrong, model.receptive_field = "", 2  # less than is seen
    with pytest.raises(AssertionError, match=r"after frame 2 .* frames 1 to 2: the largest"):
        assert_streaming_equals_window(model, normal(2, 4, 6), 6)
    model.receptive_field = None  # as of a recurrent model: from the first frame alone
    assert_streaming_equals_window(model, normal(2, 4, 6), 6)


@pytest.mark.parametrize("size", [(4, 6), (0, 4, 6)])
def test_assert_streaming_equals_window_shape(size):
    with pytest.raises(ValueError, match=r"'x' must have shape .* with at least one window"):
        assert_streaming_equals_window(Average(), torch.zeros(size), 6)
