r"""The argument :obj:`layout` of the models, and the taxels that they see."""

import os
from typing import Any, Union

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import has_taxels
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, stock_names

# What models call the features whose number is their argument `in_channels`.
_CHANNELS = ("features", "channels")
# A layout, the name of a stock layout or the path of a layout file, or the number of taxels.
LayoutLike = Union[TaxelLayout, int, PathLike]


def load_layout(layout: LayoutLike, purpose: str) -> TaxelLayout:
    r"""Returns the layout of a model that needs more than the number of taxels."""
    if isinstance(layout, int):
        raise ValueError(
            f"'layout' must be a layout, the name of one or its file for {purpose} (got the number "
            f"of taxels {layout})"
        )
    with torch.device("cpu"):  # on the meta device, a file would lose its numbers
        return as_layout(layout)


def count_taxels(layout: LayoutLike) -> int:
    r"""Returns the number of taxels :math:`N`."""
    if not isinstance(layout, int):
        return load_layout(layout, "its number of taxels").num_taxels
    need(layout >= 1, "'layout' must have at least 1 taxel", layout)
    return layout


def portable_layout(layout: Any) -> Any:
    r"""Returns the contents of a layout file, which need not exist elsewhere, and anything else as
    it is.
    """
    is_file = isinstance(layout, os.PathLike) or (
        isinstance(layout, str) and layout not in stock_names()
    )
    return load_layout(layout, "a saved model") if is_file else layout


def stacked_readings(x: Tensor, num_taxels: int, num_channels: int, what: str) -> Tensor:
    r"""Returns readings of any form sample by sample.

    Shapes:
        - **x:** Readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch.
        - **num_taxels:** Number of taxels :math:`N`.
        - **num_channels:** Number of channels :math:`F`.
        - **output:** :math:`(B, N, F)`
    """
    if x.dim() not in (2, 3) or x.size(-1) != num_channels:
        advice = f": give the model in_channels={x.size(-1)}" if what in _CHANNELS else ""
        raise ValueError(
            f"'x' must have {num_channels} {what} (got shape {tuple(x.shape)}){advice}"
        )
    count_samples(x, num_taxels)
    return x if x.dim() == 3 else x.reshape(-1, num_taxels, num_channels)


def count_samples(x: Tensor, num_taxels: int) -> int:
    r"""Returns the number of samples in readings of any form."""
    if not has_taxels(x, num_taxels):
        raise ValueError(
            f"'x' must have {num_taxels} taxels in each sample (got shape {tuple(x.shape)})"
        )
    return x.size(0) if x.dim() == 3 else x.size(0) // num_taxels


def check_taxel_dropout(part: float) -> float:
    r"""Returns the part of the taxels that are not seen in training."""
    need(0 <= part < 1, "'taxel_dropout' must be at least 0 and below 1", part)
    return part


def seen_taxels(x: Tensor, taxel_dropout: float) -> OptTensor:
    r"""Returns which taxels are seen, drawn for each sample; of one that would lose all, all.

    Shapes:
        - **x:** Readings :math:`(B, N, F)`.
        - **output:** :math:`(B, N)`; nothing where none is dropped
    """
    if taxel_dropout == 0:
        return None
    seen = torch.rand(x.shape[:2], device=x.device) >= taxel_dropout
    return seen | ~seen.any(dim=1, keepdim=True)
