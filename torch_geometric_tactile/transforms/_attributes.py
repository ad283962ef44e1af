r"""Checks of the attributes that transforms read."""

from typing import Any

from torch import Tensor
from torch_geometric.data import Batch, Data

EDGES = ("edge_index", "edge_attr", "edge_weight")
FRAMES = ("num_frames", "valid_frames")  # of windows
# Advice for attributes that a sample may lack.
_ADVICE = {
    "pos": ": samples on a layout with several links have none, since the links move relative to "
    "each other: put TaxelPose before it, or use an 'adjacency' of the layout if edges are enough",
    "edge_index": ": use an 'adjacency' of the layout, or put KNNGraph before it",
}


def require(transform: object, data: Data, key: str) -> Tensor:
    r"""Returns an attribute of the samples.

    Raises:
        ValueError: If the samples lack the attribute. The message names the transform.
    """
    value: Any = getattr(data, key, None)  # a default of PyG such as `pos=None` is not an attribute
    if value is None:
        raise ValueError(
            f"{type(transform).__name__} needs '{key}' (got none){_ADVICE.get(key, '')}"
        )
    return value


def require_pos(transform: object, data: Data) -> Tensor:
    r"""Returns the positions :math:`(N, 3)` or :math:`(B, N, 3)`.

    Raises:
        ValueError: If there are none, or they have the wrong shape.
    """
    pos = require(transform, data, "pos")
    dims = (2,) if isinstance(data, Batch) else (2, 3)
    if pos.dim() not in dims or pos.size(-1) != 3:
        raise ValueError(
            "'pos' must have shape (num_taxels, 3) or (num_samples, num_taxels, 3) "
            f"(got {tuple(pos.shape)})"
        )
    return pos


def require_x(transform: object, data: Data) -> Tensor:
    r"""Returns the readings :math:`(N, F)` or :math:`(B, N, F)`.

    Raises:
        ValueError: If there are none, or they have the wrong number of dimensions.
    """
    x = require(transform, data, "x")
    dims = (2,) if isinstance(data, Batch) else (2, 3)
    if x.dim() not in dims:
        raise ValueError(
            "'x' must have shape (num_taxels, num_features) or (num_samples, num_taxels, "
            f"num_features) (got {tuple(x.shape)})"
        )
    return x


def require_floats(transform: object, data: Data) -> Tensor:
    r"""Returns the readings as floating-point numbers, converted if they are integers."""
    x = require_x(transform, data)
    return x if x.is_floating_point() else x.float()


def check_num_taxels(data: Data, num_taxels: int, source: str) -> None:
    r"""Checks the number of taxels of each sample.

    Args:
        data (torch_geometric.data.Data): The samples.
        num_taxels (int): The number of taxels that they must have.
        source (str): The reason for this number in the message, such as :obj:`"layout 'a'"`.

    Raises:
        ValueError: If a sample has more or fewer taxels.
    """
    x = getattr(data, "x", None)
    if isinstance(data, Batch) and "ptr" in data:
        counts = data.ptr.diff().unique().tolist()
    elif isinstance(x, Tensor) and x.dim() > 1:
        counts = [x.size(-2)]
    else:
        counts = [data.num_nodes]
    for count in counts:
        if count != num_taxels:
            raise ValueError(
                f"a sample must have {num_taxels} taxels, as in {source} (got {count})"
            )


def add_mark(data: Data, key: str, mark: Tensor) -> None:
    r"""Marks taxels in an attribute, in addition to the taxels that are already marked.

    Args:
        data (torch_geometric.data.Data): The samples, which are changed.
        key (str): Name of the attribute.
        mark (torch.Tensor): Booleans :math:`(N,)` or :math:`(B, N)`.

    Raises:
        ValueError: If the attribute exists with a different shape.
    """
    old_mark: Any = getattr(data, key, None)
    if old_mark is not None:
        if old_mark.shape not in (mark.shape, mark.shape[-1:]):
            raise ValueError(
                f"'{key}' must have shape {tuple(mark.shape)}, a mark for each taxel "
                f"(got {tuple(old_mark.shape)})"
            )
        mark = mark | old_mark.bool()
    data[key] = mark
