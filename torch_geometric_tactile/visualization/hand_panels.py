r"""Pictures of several values on the taxels of one hand, side by side."""

from collections.abc import Mapping
from math import ceil
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.visualization._style import (
    MAX_WIDTH,
    new_figure,
    plain_text,
    title_figure,
)
from torch_geometric_tactile.visualization._taxel_map import checked_values, value_scale
from torch_geometric_tactile.visualization.hand import plot_hand

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_PANEL_WIDTH = 3.2  # inches
_BAR_WIDTH = 0.9  # inches


def plot_hand_panels(
    layout: TaxelLayout,
    values: Mapping[str, Tensor],
    kinematics: HandKinematics | None = None,
    joint: Tensor | None = None,
    *,
    label: str = "attribution",
    limit: float | None = None,
    columns: int = 4,
    title: str | None = None,
) -> "Figure":
    r"""Draws a hand for each of several sets of taxel values, such as the attribution of each
    label. All hands share one colour scale: zero is pale, positive values are red, and negative
    values are blue.

    Args:
        layout (TaxelLayout): The layout.
        values (Mapping of str to torch.Tensor): The values by the title of their picture. Taxels
            with a missing value (NaN) have a dashed outline.
        kinematics (HandKinematics, optional): The hand, as in :func:`plot_hand`.
        joint (torch.Tensor, optional): Joint angles in radians, as in :func:`plot_hand`.
        label (str): Name and unit of the values, which are shown beside the colour bar.
        limit (float, optional): Absolute value at the ends of the colour scale (default: the
            largest absolute value). Larger values have the colour of the end.
        columns (int): Largest number of pictures side by side.
        title (str, optional): Title of all pictures.

    Shapes:
        - **values:** one per taxel :math:`(N,)`
        - **joint:** :math:`(J,)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no values, if values do not fit the layout, if :obj:`limit` is not
            positive, or if :obj:`columns` is below one.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> values = {"soft": torch.randn(384), "heavy": torch.randn(384)}
        >>> figure = plot_hand_panels(allegro_uskin(), values)
        >>> [ax.get_title() for ax in figure.axes[:2]]
        ['soft', 'heavy']
    """
    need(values, "'values' must hold the values of at least one picture (got none)")
    need(columns >= 1, "'columns' must be at least 1", columns)
    taxel_values = {
        name: checked_values(f"values['{name}']", value, layout.num_taxels)
        for name, value in values.items()
    }
    largest = float(torch.cat(list(taxel_values.values())).nan_to_num().abs().max()) or 1.0
    need(limit is None or limit > 0, "'limit' must be positive", limit)
    scale_end = largest if limit is None else limit
    limits = (-scale_end, scale_end)
    columns = min(columns, len(taxel_values))
    rows = ceil(len(taxel_values) / columns)
    width = min(_MAX_PANEL_WIDTH, (MAX_WIDTH - _BAR_WIDTH) / columns)
    title_height = 0.4 if title else 0.1
    figure = new_figure(width * columns + _BAR_WIDTH, (width + 0.2) * rows + title_height)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax, (name, value) in zip(axes.flat, taxel_values.items(), strict=False):
        plot_hand(
            layout,
            kinematics,
            joint,
            value=value,
            ax=ax,
            limits=limits,
            cmap="diverging",
            label=None,
            title=name,
        )
        ax.set_axis_off()
    for ax in axes.flat[len(taxel_values) :]:
        ax.set_visible(False)
    figure.colorbar(
        value_scale(None, limits, "diverging"),
        ax=axes,
        shrink=0.8,
        aspect=30,
        extend="both" if largest > scale_end else "neither",
        label=plain_text(label),
    )
    title_figure(figure, title)
    return figure
