r"""The normalised adjacency of one topology, made once."""

import warnings
from typing import Optional

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor


class StaticAdjacency:
    r"""The matrix of a graph convolution :math:`(N, N)`, in the forms that products need.

    Args:
        dense (torch.Tensor): The matrix.
    """

    def __init__(self, dense: Tensor) -> None:
        self.dense = dense
        self._rows: dict[tuple[int, int], Tensor] = {}
        self._blocks: dict[int, Tensor] = {}
        self._transposed: OptTensor = None

    @property
    def transposed(self) -> Tensor:
        r"""The transposed matrix, in CSR format."""
        if self._transposed is None:
            self._transposed = _sparse(self.dense.t())
        return self._transposed

    def rows(self, start: int, stop: int) -> Tensor:
        r"""Returns some rows in CSR format :math:`(S, N)`, made once.

        Args:
            start (int): The first row.
            stop (int): The row behind the last.
        """
        key = (start, stop)
        if key not in self._rows:
            self._rows[key] = _sparse(self.dense[start:stop])
        return self._rows[key]

    def blocks(self, group: int, nodes: Tensor) -> Tensor:
        r"""Returns the matrices of some segments of equal size, made once for each group.

        Args:
            group (int): Number of the group.
            nodes (torch.Tensor): The taxels of each segment :math:`(S, n)`.

        Returns:
            torch.Tensor: The matrices :math:`(S, n, n)`.
        """
        if group not in self._blocks:
            self._blocks[group] = adjacency_blocks(self.dense, nodes)
        return self._blocks[group]


class AdjacencyCache:
    r"""Keeps the adjacency for as long as the same tensors come in, unchanged.

    A pickled or copied cache is empty.
    """

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._value: Optional[StaticAdjacency] = None

    def clear(self) -> None:
        r"""Forgets what was kept."""
        self._key, self._value = (), None

    def get(
        self,
        edge_index: Tensor,
        edge_weight: OptTensor,
        num_nodes: int,
        dtype: torch.dtype,
        segment: OptTensor = None,
    ) -> Optional[StaticAdjacency]:
        r"""Returns the adjacency of a topology, or :obj:`None` where it must not be kept: for
        tensors that need a gradient or do not tell whether they changed, and while compiling.

        Args:
            edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
            edge_weight (torch.Tensor, optional): Their weights :math:`(|\mathcal{E}|,)`.
            num_nodes (int): Number of taxels :math:`N`.
            dtype (torch.dtype): Of the matrix.
            segment (torch.Tensor, optional): The segment of each taxel :math:`(N,)`, always the
                same; edges between segments do not count.
        """
        given = [edge_index] if edge_weight is None else [edge_index, edge_weight]
        if torch.compiler.is_compiling() or any(
            tensor.requires_grad or tensor.is_inference() for tensor in given
        ):
            return None
        # In-place changes raise the version, so that a changed tensor is never taken for the old.
        key = (*given, *(tensor._version for tensor in given), num_nodes, dtype)
        if len(key) != len(self._key) or any(
            a is not b if isinstance(a, Tensor) else a != b
            for a, b in zip(key, self._key, strict=True)
        ):
            # A matrix made in inference mode (by a validation before the training) could not take
            # part in a later training step.
            with torch.inference_mode(False), torch.no_grad():
                dense = dense_norm(edge_index, edge_weight, num_nodes, dtype, segment)
                self._value = StaticAdjacency(dense)
            self._key = key
        return self._value

    def __deepcopy__(self, memo: object) -> "AdjacencyCache":
        return AdjacencyCache()

    def __reduce__(self) -> tuple[type["AdjacencyCache"], tuple[()]]:
        return AdjacencyCache, ()


def _sparse(dense: Tensor) -> Tensor:
    with warnings.catch_warnings(), torch.inference_mode(False):
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return dense.contiguous().to_sparse_csr()


def adjacency_blocks(dense: Tensor, nodes: Tensor) -> Tensor:
    r"""Returns the matrices of some segments of equal size.

    Args:
        dense (torch.Tensor): The matrix of all taxels :math:`(N, N)`.
        nodes (torch.Tensor): The taxels of each segment :math:`(S, n)`.

    Returns:
        torch.Tensor: The matrices :math:`(S, n, n)`.
    """
    return dense[nodes.unsqueeze(2), nodes.unsqueeze(1)]


def dense_norm(
    edge_index: Tensor,
    edge_weight: OptTensor,
    num_nodes: int,
    dtype: torch.dtype,
    segment: OptTensor = None,
) -> Tensor:
    r"""Returns PyG's :func:`~torch_geometric.nn.conv.gcn_conv.gcn_norm` as one matrix
    :math:`(N, N)`.

    It drops no edges by a mask, whose result has an unknown size, so that ``torch.compile`` sees
    one graph.

    Args:
        edge_index (torch.Tensor): Edges :math:`(2, |\mathcal{E}|)`.
        edge_weight (torch.Tensor, optional): Their weights :math:`(|\mathcal{E}|,)`.
        num_nodes (int): Number of taxels :math:`N`.
        dtype (torch.dtype): Of the matrix.
        segment (torch.Tensor, optional): The segment of each taxel :math:`(N,)`; edges between
            segments do not count.
    """
    source, target = edge_index[0], edge_index[1]
    if edge_weight is None:
        edge_weight = torch.ones(edge_index.size(1), dtype=dtype, device=edge_index.device)
    weight = edge_weight.view(-1).to(dtype)
    if segment is not None:
        weight = weight.masked_fill(segment[source] != segment[target], 0.0)
    is_loop = source == target
    adjacency = weight.new_zeros(num_nodes * num_nodes).scatter_add(
        0, target * num_nodes + source, weight.masked_fill(is_loop, 0.0)
    )
    # Self-loops keep their weight, missing ones get one; the last place takes all other edges.
    loop = weight.new_ones(num_nodes + 1).scatter(
        0, source.masked_fill(~is_loop, num_nodes), weight
    )
    adjacency = adjacency.view(num_nodes, num_nodes) + loop[:-1].diag_embed()
    scale = adjacency.sum(dim=1).pow(-0.5)
    scale = scale.masked_fill(scale == float("inf"), 0.0)
    return scale.view(-1, 1) * adjacency * scale
