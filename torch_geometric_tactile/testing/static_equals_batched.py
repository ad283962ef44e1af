r"""Asserts that a layer returns the same output for static and block-diagonal batches."""

from collections.abc import Callable

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.testing._compare import assert_equal_numbers


def assert_static_equals_batched(
    layer: Callable[..., Tensor],
    x: Tensor,
    edge_index: Tensor,
    edge_attr: Tensor | None = None,
    atol: float = 1e-5,
) -> None:
    r"""Asserts that a layer or model returns the same numbers for a static batch :math:`(B, N, F)`,
    for each sample :math:`(N, F)`, and for PyG's block-diagonal batch :math:`(B \cdot N, F)`.

    The layer is called as :obj:`layer(x, edge_index)`, or as :obj:`layer(x, edge_index, edge_attr)`
    with edge features. Its output may have one row for each node or for each sample. If the layer
    draws random numbers, call :meth:`~torch.nn.Module.eval` first.

    Args:
        layer (callable): The layer.
        x (torch.Tensor): Node features :math:`(B, N, F)`.
        edge_index (torch.Tensor): Edges, which all samples share :math:`(2, |\mathcal{E}|)`.
        edge_attr (torch.Tensor, optional): Edge features or weights that all samples share
            :math:`(|\mathcal{E}|, D)` or :math:`(|\mathcal{E}|,)`, or separate edge features for
            each sample :math:`(B, |\mathcal{E}|, D)`.
        atol (float): The largest allowed difference.

    Raises:
        AssertionError: If the numbers differ.
        ValueError: If :obj:`x` does not have three dimensions, or holds no sample.

    Examples:
        >>> from torch_geometric_tactile.nn.conv import StaticGCNConv
        >>> edge_index = torch.tensor([[0, 1], [1, 0]])
        >>> assert_static_equals_batched(StaticGCNConv(3, 8), torch.randn(5, 4, 3), edge_index)
    """
    if x.dim() != 3 or x.size(0) == 0:
        raise ValueError(
            f"'x' must have shape (batch_size, num_nodes, num_features) with at least one sample "
            f"(got {tuple(x.shape)})"
        )
    samples = []
    for i in range(x.size(0)):
        sample = Data(x=x[i], edge_index=edge_index)
        if edge_attr is not None:
            sample.edge_attr = edge_attr[i] if edge_attr.dim() == 3 else edge_attr
        samples.append(sample)
    batch = Batch.from_data_list(samples)
    with torch.no_grad():
        static = layer(x, edge_index) if edge_attr is None else layer(x, edge_index, edge_attr)
        # Rows of nodes or samples, so that outputs with either shape can be compared.
        rows = static.reshape(-1, static.size(-1))
        for name, parts in (("each sample", samples), ("PyG's batch", [batch])):
            outs = [
                layer(part.x, part.edge_index)
                if edge_attr is None
                else layer(part.x, part.edge_index, part.edge_attr)
                for part in parts
            ]
            expected = torch.cat([out.reshape(-1, out.size(-1)) for out in outs])
            law = f"{type(layer).__name__} must give the same output on (B, N, F) as on {name}"
            assert_equal_numbers(law, rows, expected, atol)
