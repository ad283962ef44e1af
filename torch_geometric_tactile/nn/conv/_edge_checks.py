r"""Checks the node features and edges that layers receive."""

import weakref
from collections.abc import Callable
from typing import Any, Optional, Self

import torch
from torch import Tensor
from torch_geometric import EdgeIndex
from torch_geometric.typing import Adj, OptTensor
from torch_geometric.utils import is_torch_sparse_tensor, to_edge_index

from torch_geometric_tactile.nn._sizes import check_sizes


class StatelessCopy:
    r"""A base class for objects whose pickles and deep copies have no state."""

    def __deepcopy__(self, memo: object) -> Self:
        return type(self)()

    def __reduce__(self) -> tuple[type[Self], tuple[()]]:
        return type(self), ()


class TensorCheck(StatelessCopy):
    r"""A check of the values of a tensor that is skipped as long as the tensor does not change. On
    a GPU, each check has to wait for all pending work.
    """

    def __init__(self) -> None:
        self._last_tensor: Optional[tuple[weakref.ref[Tensor], tuple[int, int]]] = None

    def _check(self, tensor: Tensor, size: int, check: Callable[[Tensor, int], None]) -> None:
        if is_traced() or tensor.is_inference():  # an inference tensor has no version counter
            check(tensor, size)
            return
        state = (tensor._version, size)
        last_tensor = self._last_tensor
        if last_tensor is None or last_tensor[0]() is not tensor or last_tensor[1] != state:
            check(tensor, size)
            self._last_tensor = (weakref.ref(tensor), state)


class EdgeCheck(TensorCheck):
    r"""A check of edges that is skipped as long as they do not change; see :class:`TensorCheck`."""

    def __call__(self, edge_index: Adj, num_nodes: int) -> None:
        r"""Checks edges.

        Shapes:
            - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
              :math:`(N, N)`.
            - **num_nodes:** Number of nodes :math:`N`.
        """
        self._check(edge_index, num_nodes, check_edge_index)


def is_traced() -> bool:
    r"""Returns whether a compiler, an export or a trace is recording the operations. If so, the
    code must not depend on values.
    """
    return bool(torch.compiler.is_compiling() or torch.jit.is_tracing())


def is_exported() -> bool:
    r"""Returns whether operations are being recorded for another runtime, not for a compiler."""
    return torch.compiler.is_exporting() or torch.jit.is_tracing()


def check_conv_sizes(in_channels: Any, **sizes: Any) -> None:
    r"""Checks the sizes of a convolution: :obj:`in_channels`, which may be -1, and further sizes by
    name.

    Raises:
        ValueError: If a size is not a positive integer.
    """
    check_lazy_size("in_channels", in_channels)
    check_sizes(**sizes)


def check_lazy_size(name: str, size: Any) -> None:
    r"""Checks a size that may be -1.

    Raises:
        ValueError: If the size is neither -1 nor a positive integer.
    """
    if size != -1:
        check_sizes(", or -1 to infer it from the first input", **{name: size})


def compute_on_edges(
    compute: Callable[..., Tensor],
    num_nodes: int,
    x: Tensor,
    edge_index: Adj,
    *edge_inputs: OptTensor,
) -> Tensor:
    r"""Returns :obj:`compute(x, edge_index, *edge_inputs)`. The shape and type of the edges must
    have been checked.

    Node indices are checked only after an error. On a CPU, indices out of range always raise an
    error, so that edges need not be checked in advance.

    Raises:
        ValueError: If a node index is out of range.
    """
    if is_traced():
        return compute(x, edge_index, *edge_inputs)
    try:
        return compute(x, edge_index, *edge_inputs)
    except (IndexError, RuntimeError, ValueError):
        check_edge_index(edge_index, num_nodes)
        raise


def check_edge_features(edge_attr: Tensor, edge_dim: int) -> None:
    r"""Checks the number of features of each edge."""
    if edge_attr.size(-1) != edge_dim:
        raise ValueError(f"'edge_attr' must have {edge_dim} features (got {edge_attr.size(-1)})")


def check_tensor(x: Any) -> None:
    r"""Checks that node features are a single tensor."""
    if not isinstance(x, Tensor):
        raise ValueError(
            f"'x' must be a tensor with the features of one set of nodes (got {type(x).__name__})"
        )


def check_features(x: Tensor, in_channels: Optional[int]) -> None:
    r"""Checks the shape and the type of node features. If :obj:`in_channels` is not :obj:`None`,
    also checks their number.
    """
    if x.dim() < 2:
        raise ValueError(
            "'x' must have shape (num_nodes, in_channels) or (batch_size, num_nodes, "
            f"in_channels) (got {tuple(x.shape)})"
        )
    if not (x.is_floating_point() or x.is_complex()):
        raise ValueError(f"'x' must hold floating-point numbers (got {x.dtype})")
    if in_channels is not None and x.size(-1) != in_channels:
        raise ValueError(f"'x' must have {in_channels} features (got shape {tuple(x.shape)})")


def check_edge_form(edge_index: Adj, num_nodes: int) -> None:
    r"""Checks the shape and the type of edges, but not their values.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)`.
        - **num_nodes:** Number of nodes :math:`N`.
    """
    if is_torch_sparse_tensor(edge_index):
        if tuple(edge_index.shape) != (num_nodes, num_nodes):
            raise ValueError(
                f"'edge_index' must have shape ({num_nodes}, {num_nodes}) if it is sparse, since "
                f"'x' has {num_nodes} nodes (got {tuple(edge_index.shape)})"
            )
        return
    if edge_index.dim() != 2 or edge_index.size(0) != 2:
        raise ValueError(
            f"'edge_index' must have shape (2, num_edges) (got {tuple(edge_index.shape)})"
        )
    dtype = edge_index.dtype
    if dtype.is_floating_point or dtype.is_complex or dtype == torch.bool:
        raise ValueError(f"'edge_index' must hold integers (got {dtype})")


def check_edge_index(edge_index: Adj, num_nodes: int) -> None:
    r"""Checks the shape and the type of edges and, unless a compiler is recording, their node
    indices.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)`.
        - **num_nodes:** Number of nodes :math:`N`.
    """
    check_edge_form(edge_index, num_nodes)
    if (
        is_traced()
        or is_torch_sparse_tensor(edge_index)
        or edge_index.device.type == "meta"
        or edge_index.numel() == 0
    ):
        return
    extremes = torch.stack(torch.aminmax(edge_index)).cpu()  # one synchronisation on a GPU
    # `tolist` does not work inside torch.func in PyTorch 2.4.
    low, high = int(extremes[0]), int(extremes[1])
    if low < 0 or high >= num_nodes:
        raise ValueError(
            f"'edge_index' must hold node indices from 0 to {num_nodes - 1}, the rows of 'x' "
            f"(got {low} to {high})"
        )


def check_edge_weight(edge_index: Adj, edge_weight: OptTensor) -> None:
    r"""Checks the shape and the type of edge weights."""
    if edge_weight is None:
        return
    if is_torch_sparse_tensor(edge_index):
        raise ValueError(
            "'edge_weight' must be None if 'edge_index' is sparse, since its values are the "
            f"weights (got shape {tuple(edge_weight.shape)})"
        )
    num_edges = edge_index.size(1)
    if tuple(edge_weight.shape) not in ((num_edges,), (num_edges, 1)):
        raise ValueError(
            f"'edge_weight' must have shape ({num_edges},), one weight per edge "
            f"(got {tuple(edge_weight.shape)})"
        )
    if edge_weight.dtype == torch.bool or edge_weight.is_complex():
        raise ValueError(f"'edge_weight' must hold real numbers (got {edge_weight.dtype})")


def sorted_form(edge_index: Adj) -> Adj:
    r"""Returns edges, with sorted indices if they are a sparse COO matrix and unchanged otherwise.

    PyG's functions mark the caller's matrix as coalesced even if it is not. Later products with
    this matrix would then be incorrect.
    """
    if edge_index.layout == torch.sparse_coo and not edge_index.is_coalesced():
        return edge_index.coalesce()
    return edge_index


def as_edges(edge_index: Adj, edge_weight: OptTensor = None) -> tuple[Tensor, OptTensor]:
    r"""Returns edges and their weights as tensors. PyG's transposed sparse adjacency is also
    supported.

    Shapes:
        - **edge_index:** Edges :math:`(2, |\mathcal{E}|)`, or a sparse matrix
          :math:`(N, N)` of targets and sources.
    """
    if isinstance(edge_index, EdgeIndex):
        return edge_index.as_tensor(), edge_weight
    if not is_torch_sparse_tensor(edge_index):
        return edge_index, edge_weight
    index, value = to_edge_index(sorted_form(edge_index))
    return index.flip(0), value
