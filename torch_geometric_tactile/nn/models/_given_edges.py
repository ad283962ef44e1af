r"""What the layers of a thread take as edges, and the weights of edges."""

from torch import Tensor
from torch_geometric.typing import OptTensor


def weight_like(edge_weight: OptTensor, x: Tensor) -> OptTensor:
    r"""Returns edge weights in the precision of the node features, in which several layers
    compute.
    """
    if edge_weight is None or not edge_weight.is_floating_point():
        return edge_weight
    return edge_weight.to(x.dtype)


def given_edges(edge_index: OptTensor) -> Tensor:
    r"""Returns edges, which a graph convolution needs."""
    if edge_index is None:
        raise ValueError(
            "'edge_index' must be given (got None): the samples need edges, of an adjacency of the "
            "layout or of the transform KNNGraph"
        )
    return edge_index
