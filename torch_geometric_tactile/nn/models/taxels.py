r"""The argument :obj:`layout` of the models."""

import os
from pathlib import Path
from typing import Any, Union

import torch

from torch_geometric_tactile.sensors import TaxelLayout, stock_layout, stock_path
from torch_geometric_tactile.typing import PathLike

# A layout, the name of a stock layout or the path of a layout file, or the number of taxels.
LayoutLike = Union[TaxelLayout, int, PathLike]


def load_layout(layout: LayoutLike, purpose: str) -> TaxelLayout:
    r"""Returns the layout of a model that needs more than the number of taxels.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, its name or its file.
        purpose (str): What it is needed for, for the message.

    Raises:
        ValueError: If it is a number, or no layout has this name.
    """
    if isinstance(layout, int):
        raise ValueError(
            f"'layout' must be a layout, the name of one or its file for {purpose} (got the number "
            f"of taxels {layout})"
        )
    with torch.device("cpu"):  # on the meta device, a file would lose its numbers
        return as_layout(layout)


def count_taxels(layout: LayoutLike) -> int:
    r"""Returns the number of taxels :math:`N`.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, its name or its file, or the number.

    Raises:
        ValueError: If the number is below one, or no layout has this name.
    """
    if not isinstance(layout, int):
        return load_layout(layout, "its number of taxels").num_taxels
    if layout < 1:
        raise ValueError(f"'layout' must have at least 1 taxel (got {layout})")
    return layout


def portable_layout(layout: Any) -> Any:
    r"""Returns the contents of a layout file, which need not exist elsewhere, and anything else as
    it is.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, its name or its file, or the number.
    """
    if isinstance(layout, os.PathLike):
        return load_layout(layout, "a saved model")
    if isinstance(layout, str):
        try:
            stock_path("layouts", layout)
        except ValueError:  # not a stock layout: its file, or an error that lists the stock names
            return load_layout(layout, "a saved model")
    return layout


def as_layout(layout: Union[TaxelLayout, PathLike]) -> TaxelLayout:
    r"""Returns a layout.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
    """
    if isinstance(layout, TaxelLayout):
        return layout
    if isinstance(layout, str) and Path(layout).suffix != ".json":
        return stock_layout(layout)
    return TaxelLayout.load(layout)
