r"""Analysis of the weights in the dense encoder of edge features."""

import copy
from typing import NamedTuple

import torch
from sklearn.decomposition import PCA
from sklearn.metrics import roc_auc_score
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need


class EdgeSeparation(NamedTuple):
    r"""The result of :func:`edge_separation`: how well a value of each edge separates edges between
    segments from edges within segments.

    Args:
        auc (float): Probability that an edge between segments has a larger value than an edge
            within a segment. Ties count half. The AUC is 0.5 by chance, 1 if all edges between
            segments have larger values, and 0 if all have smaller values.
        between_mean (float): Mean value of edges between segments.
        within_mean (float): Mean value of edges within a segment.
        num_between (int): Number of edges between segments.
        num_within (int): Number of edges within a segment.

    Examples:
        >>> EdgeSeparation(1.0, 2.0, 0.5, num_between=4, num_within=8).auc
        1.0
    """

    auc: float
    between_mean: float
    within_mean: float
    num_between: int
    num_within: int


def encoder_blocks(
    weight: Tensor | Module,
    num_nodes: int | None = None,
    num_edges: int | None = None,
    edge_dim: int = 4,
    out_channels: int = 4,
) -> Tensor:
    r"""Returns how strongly each edge influences each node in a dense encoder of edge features. The
    strength is the mean absolute weight between the features of the edge and the features of the
    node.

    Args:
        weight (torch.Tensor or torch.nn.Module): The weight, or an encoder with this weight as
            :obj:`lin.weight`. The rows are the features of one node after another, and the columns
            are the features of one edge after another.
        num_nodes (int, optional): Number of taxels :math:`N`, to check the weight.
        num_edges (int, optional): Number of edges :math:`|\mathcal{E}|`, to check the weight.
        edge_dim (int): Number of features per edge :math:`D`.
        out_channels (int): Number of features per node :math:`C`.

    Shapes:
        - **weight:** :math:`(N \cdot C, |\mathcal{E}| \cdot D)`
        - **output:** :math:`(|\mathcal{E}|, N)`, in double precision

    Raises:
        ValueError: If there is no weight, or the weight has the wrong shape.

    Examples:
        >>> encoder_blocks(torch.tensor([[1.0, -3.0, 0.0, 4.0]]), edge_dim=2, out_channels=1)
        tensor([[2.],
                [2.]], dtype=torch.float64)
    """
    weight = _encoder_weight(weight).detach().cpu().double()
    for name, size in (("edge_dim", edge_dim), ("out_channels", out_channels)):
        if size < 1:
            raise ValueError(f"'{name}' must be at least 1 (got {size})")
    rows = None if num_nodes is None else num_nodes * out_channels
    columns = None if num_edges is None else num_edges * edge_dim
    if (
        weight.dim() != 2
        or weight.numel() == 0
        or weight.size(0) % out_channels
        or weight.size(1) % edge_dim
        or rows not in (None, weight.size(0))
        or columns not in (None, weight.size(1))
    ):
        raise ValueError(
            f"'weight' must have shape ({rows or f'num_nodes * {out_channels}'}, "
            f"{columns or f'num_edges * {edge_dim}'}) (got {tuple(weight.shape)})"
        )
    blocks = weight.view(weight.size(0) // out_channels, out_channels, -1, edge_dim)
    return blocks.abs().mean(dim=(1, 3)).t().contiguous()


def encoder_map(
    weight: Tensor | Module,
    num_nodes: int | None = None,
    num_edges: int | None = None,
    edge_dim: int = 4,
    out_channels: int = 4,
) -> Tensor:
    r"""Returns the map of edges in fig. 7 of the "Tactile Object Property Recognition using
    Geometrical Graph Edge Features and Multi-Thread Graph Convolutional Network" paper. The value
    of an edge is the first principal component of :func:`encoder_blocks`, where edges are samples
    and nodes are variables.

    The sign of a principal component is arbitrary. Here, it is chosen so that larger values mean
    larger weights: the correlation between the component and the mean absolute weight of the edges
    over all nodes is not negative. The paper does not define the sign, so red and blue may be
    swapped in its maps.

    Args:
        weight (torch.Tensor or torch.nn.Module): As in :func:`encoder_blocks`.
        num_nodes (int, optional): Number of taxels :math:`N`, to check the weight.
        num_edges (int, optional): Number of edges :math:`|\mathcal{E}|`, to check the weight.
        edge_dim (int): Number of features per edge.
        out_channels (int): Number of features per node.

    Shapes:
        - **weight:** :math:`(N \cdot C, |\mathcal{E}| \cdot D)`
        - **output:** :math:`(|\mathcal{E}|,)`, with mean zero

    Raises:
        ValueError: If there is no weight, the weight has the wrong shape, or there are fewer than
            two edges.

    Examples:
        >>> weight = torch.tensor([[1.0, -2.0, 6.0]])  # one node, three edges
        >>> encoder_map(weight, edge_dim=1, out_channels=1)
        tensor([-2., -1.,  3.])
    """
    blocks = encoder_blocks(weight, num_nodes, num_edges, edge_dim, out_channels)
    need(len(blocks) >= 2, "'weight' must have at least two edges", len(blocks))
    need(blocks.isfinite().all(), "'weight' must hold finite numbers only (got NaN or infinity)")
    # Centred here, since scikit-learn divides by the variance, which may be zero.
    centred = blocks - blocks.mean(dim=0)
    if not centred.any():
        return torch.zeros(len(blocks))
    component = PCA(n_components=1, svd_solver="full").fit_transform(centred.numpy())
    edge_values = torch.from_numpy(component).view(-1)
    sign = -1.0 if float(edge_values @ centred.mean(dim=1)) < 0 else 1.0
    return (sign * edge_values).float()


def edge_separation(value: Tensor, edge_index: Tensor, segment: Tensor) -> EdgeSeparation:
    r"""Measures how well a value of each edge separates edges between segments from edges within
    segments.

    With patches as segments, this quantifies the paper's interpretation of its map. To check
    whether the separation was learnt, compare it with :func:`untrained_separation` and with the
    separation by edge length (:obj:`edge_attr[:, 0]`), since longer edges have larger gradients.

    Args:
        value (torch.Tensor): One value for each edge.
        edge_index (torch.Tensor): The edges.
        segment (torch.Tensor): Segment of each taxel, such as
            :meth:`layout.segments("patch") <torch_geometric_tactile.sensors.TaxelLayout.segments>`.
            With :obj:`layout.link`, the edges between segments are those across a joint.

    Shapes:
        - **value:** :math:`(|\mathcal{E}|,)`
        - **edge_index:** :math:`(2, |\mathcal{E}|)`
        - **segment:** :math:`(N,)`

    Raises:
        ValueError: If a shape does not match, a value is not finite, all edges are between
            segments, or all edges are within segments.

    Examples:
        >>> edge_index = torch.tensor([[0, 1, 1], [1, 0, 2]])
        >>> edge_separation(torch.tensor([0.1, 0.2, 0.9]), edge_index, torch.tensor([0, 0, 1])).auc
        1.0
    """
    value = value.detach().cpu().double()
    edge_index, segment = edge_index.detach().cpu(), segment.detach().cpu()
    if edge_index.dim() != 2 or edge_index.size(0) != 2:
        raise ValueError(
            f"'edge_index' must have shape (2, num_edges) (got {tuple(edge_index.shape)})"
        )
    if value.shape != edge_index.shape[1:]:
        raise ValueError(
            f"'value' must have shape ({edge_index.size(1)},), one for each edge "
            f"(got {tuple(value.shape)})"
        )
    need(value.isfinite().all(), "'value' must hold finite numbers only (got NaN or infinity)")
    if segment.dim() != 1 or (edge_index.numel() and int(edge_index.max()) >= len(segment)):
        raise ValueError(
            "'segment' must have shape (num_nodes,), one for each node of 'edge_index' "
            f"(got {tuple(segment.shape)})"
        )
    between = segment[edge_index[0]] != segment[edge_index[1]]
    if between.all() or not between.any():
        raise ValueError(
            "'segment' must leave edges within segments and edges between segments "
            f"(got {int(between.sum())} of {len(between)} between)"
        )
    return EdgeSeparation(
        auc=float(roc_auc_score(between.numpy(), value.numpy())),
        between_mean=float(value[between].mean()),
        within_mean=float(value[~between].mean()),
        num_between=int(between.sum()),
        num_within=int((~between).sum()),
    )


def untrained_separation(
    encoder: Module,
    edge_index: Tensor,
    segment: Tensor,
    num_seeds: int = 5,
    edge_dim: int = 4,
    out_channels: int = 4,
) -> Tensor:
    r"""Returns the AUC from :func:`edge_separation` for copies of an encoder with random weights.
    Only the difference between a trained encoder and these values was learnt.

    Args:
        encoder (torch.nn.Module): The encoder, with :obj:`lin.weight` and :obj:`reset_parameters`.
            Neither the encoder nor the state of the global random generator changes.
        edge_index (torch.Tensor): The edges :math:`(2, |\mathcal{E}|)`.
        segment (torch.Tensor): Segment of each taxel :math:`(N,)`.
        num_seeds (int): Number of copies. Their seeds are 0, 1, 2 and so on.
        edge_dim (int): Number of features per edge.
        out_channels (int): Number of features per node.

    Shapes:
        - **output:** :math:`(S,)` for :math:`S` seeds

    Raises:
        ValueError: If :obj:`num_seeds` is below one, or :func:`encoder_map` or
            :func:`edge_separation` would reject an argument.

    Examples:
        >>> from torch_geometric_tactile.nn import EdgeFeatureEncoder
        >>> edge_index = torch.tensor([[0, 1, 1, 2, 2, 3], [1, 0, 2, 1, 3, 2]])
        >>> encoder = EdgeFeatureEncoder(4, 6)
        >>> untrained_separation(encoder, edge_index, torch.tensor([0, 0, 1, 1]), num_seeds=2).shape
        torch.Size([2])
    """
    need(num_seeds >= 1, "'num_seeds' must be at least 1", num_seeds)
    untrained = copy.deepcopy(encoder).cpu()
    aucs = []
    for seed in range(num_seeds):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            untrained.reset_parameters()  # type: ignore[operator]
        value = encoder_map(
            untrained,
            len(segment),
            edge_index.size(1),
            edge_dim=edge_dim,
            out_channels=out_channels,
        )
        aucs.append(edge_separation(value, edge_index, segment).auc)
    return torch.tensor(aucs)


def _encoder_weight(weight: Tensor | Module) -> Tensor:
    if isinstance(weight, Tensor):
        return weight
    lin_weight = getattr(getattr(weight, "lin", None), "weight", None)
    if not isinstance(lin_weight, Tensor):
        raise ValueError(
            "'weight' must be a tensor or an encoder with 'lin.weight' "
            f"(got {type(weight).__name__})"
        )
    return lin_weight
