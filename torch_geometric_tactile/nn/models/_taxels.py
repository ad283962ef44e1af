r"""Loads the :obj:`layout` argument of models, checks readings and drops taxels."""

import os
from typing import Any, Union

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import has_taxels
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, stock_names

# Names of features whose number is the argument `in_channels` of the model.
_CHANNEL_NAMES = ("features", "channels")
# A layout, the name of a stock layout or the path of a layout file, or the number of taxels.
LayoutLike = Union[TaxelLayout, int, PathLike]


def load_layout(layout: LayoutLike, purpose: str) -> TaxelLayout:
    r"""Returns the layout for a model that needs more than the number of taxels.

    Args:
        layout (TaxelLayout, int, str or PathLike): Argument of the model.
        purpose (str): What the layout is needed for, for the error message.

    Raises:
        ValueError: If the argument is a number.
    """
    if isinstance(layout, int):
        raise ValueError(
            f"'layout' must be a layout, the name of a layout or a layout file for {purpose} (got "
            f"the number of taxels {layout})"
        )
    with torch.device("cpu"):  # on the meta device, a layout would lose its values
        return as_layout(layout)


def count_taxels(layout: LayoutLike) -> int:
    r"""Returns the number of taxels :math:`N`."""
    if not isinstance(layout, int):
        return load_layout(layout, "its number of taxels").num_taxels
    need(layout >= 1, "'layout' must have at least 1 taxel", layout)
    return layout


def portable_layout(layout: Any) -> Any:
    r"""Returns the layout if the argument is the path of a layout file, since the file may not
    exist on other machines. All other arguments are returned unchanged.
    """
    is_file = isinstance(layout, os.PathLike) or (
        isinstance(layout, str) and layout not in stock_names()
    )
    return load_layout(layout, "a saved model") if is_file else layout


def stacked_readings(x: Tensor, num_taxels: int, num_channels: int, channel_name: str) -> Tensor:
    r"""Returns readings as :math:`(B, N, F)`.

    Args:
        x (torch.Tensor): Readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
            :math:`(B \cdot N, F)`.
        num_taxels (int): Number of taxels :math:`N`.
        num_channels (int): Number of channels :math:`F`.
        channel_name (str): Name of the channels in the error message.

    Raises:
        ValueError: If the readings have the wrong number of taxels or channels.
    """
    if x.dim() not in (2, 3) or x.size(-1) != num_channels:
        is_argument = channel_name in _CHANNEL_NAMES
        advice = f": create the model with in_channels={x.size(-1)}" if is_argument else ""
        raise ValueError(
            f"'x' must have {num_channels} {channel_name} (got shape {tuple(x.shape)}){advice}"
        )
    count_samples(x, num_taxels)
    return x if x.dim() == 3 else x.reshape(-1, num_taxels, num_channels)


def count_samples(x: Tensor, num_taxels: int) -> int:
    r"""Returns the number of samples in readings :math:`(N, F)`, :math:`(B, N, F)` or in the
    readings of a PyG batch.

    Raises:
        ValueError: If the readings have the wrong number of taxels.
    """
    if not has_taxels(x, num_taxels):
        raise ValueError(
            f"'x' must have {num_taxels} taxels in each sample (got shape {tuple(x.shape)})"
        )
    return x.size(0) if x.dim() == 3 else x.size(0) // num_taxels


def check_taxel_dropout(probability: float) -> float:
    r"""Returns the probability of dropping a taxel during training.

    Raises:
        ValueError: If the probability is below zero or not below one.
    """
    need(0 <= probability < 1, "'taxel_dropout' must be at least 0 and below 1", probability)
    return probability


def taxel_mask(x: Tensor, taxel_dropout: float) -> OptTensor:
    r"""Returns a random mask :math:`(B, N)` that is true for taxels that are not dropped. If all
    taxels of a sample would be dropped, none of them is dropped. Returns :obj:`None` for a
    probability of zero.

    Args:
        x (torch.Tensor): Readings :math:`(B, N, F)`.
        taxel_dropout (float): Probability of dropping a taxel.
    """
    if taxel_dropout == 0:
        return None
    mask = torch.rand(x.shape[:2], device=x.device) >= taxel_dropout
    return mask | ~mask.any(dim=1, keepdim=True)
