r"""What the transforms ask of the attributes that they read."""

from typing import Any

from torch import Tensor
from torch_geometric.data import Batch, Data

EDGES = ("edge_index", "edge_attr", "edge_weight")
FRAMES = ("num_frames", "valid_frames")  # of windows
# What gives a sample the attributes that it may lack.
_SOURCES = {
    "pos": ": on a layout with several links samples have none, as these move against each other: "
    "put TaxelPose before it, or use an 'adjacency' of the layout where edges are enough",
    "edge_index": ": use an 'adjacency' of the layout, or put KNNGraph before it",
}


def require(transform: object, data: Data, key: str) -> Tensor:
    r"""Returns an attribute that must be there."""
    value: Any = getattr(data, key, None)  # PyG's empty slots (`pos=None`) are no attributes
    if value is None:
        raise ValueError(
            f"{type(transform).__name__} needs '{key}' (got none){_SOURCES.get(key, '')}"
        )
    return value


def require_pos(transform: object, data: Data) -> Tensor:
    r"""Returns the positions :math:`(N, 3)` or :math:`(B, N, 3)`."""
    pos = require(transform, data, "pos")
    dims = (2,) if isinstance(data, Batch) else (2, 3)
    if pos.dim() not in dims or pos.size(-1) != 3:
        raise ValueError(
            "'pos' must have shape (num_taxels, 3) or (num_samples, num_taxels, 3) "
            f"(got {tuple(pos.shape)})"
        )
    return pos


def require_x(transform: object, data: Data) -> Tensor:
    r"""Returns the readings :math:`(N, F)` or :math:`(B, N, F)`."""
    x = require(transform, data, "x")
    dims = (2,) if isinstance(data, Batch) else (2, 3)
    if x.dim() not in dims:
        raise ValueError(
            "'x' must have shape (num_taxels, num_features) or (num_samples, num_taxels, "
            f"num_features) (got {tuple(x.shape)})"
        )
    return x


def require_floats(transform: object, data: Data) -> Tensor:
    r"""Returns the readings in floating point; counts may be integers."""
    x = require_x(transform, data)
    return x if x.is_floating_point() else x.float()


def check_num_taxels(data: Data, num_taxels: int, model: str) -> None:
    r"""Checks that each sample has as many taxels as something else."""
    x = getattr(data, "x", None)
    if isinstance(data, Batch) and "ptr" in data:
        counts = data.ptr.diff().unique().tolist()
    elif isinstance(x, Tensor) and x.dim() > 1:
        counts = [x.size(-2)]
    else:
        counts = [data.num_nodes]
    for count in counts:
        if count != num_taxels:
            raise ValueError(f"a sample must have {num_taxels} taxels, as {model} (got {count})")


def add_mark(data: Data, key: str, mark: Tensor) -> None:
    r"""Marks taxels, beside those that are marked already.

    Shapes:
        - **mark:** Booleans :math:`(N,)` or :math:`(B, N)`.
    """
    old: Any = getattr(data, key, None)
    if old is not None:
        if old.shape not in (mark.shape, mark.shape[-1:]):
            raise ValueError(
                f"'{key}' must have shape {tuple(mark.shape)}, a mark for each taxel "
                f"(got {tuple(old.shape)})"
            )
        mark = mark | old.bool()
    data[key] = mark
