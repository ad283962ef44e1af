r"""Pictures of grasps with the readings from all fingers."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.visualization._style import (
    MAX_WIDTH,
    TEXT,
    current_theme,
    new_figure,
    plain_text,
    symmetric_limit,
)
from torch_geometric_tactile.visualization._taxel_map import figure_size, value_scale
from torch_geometric_tactile.visualization.layout import layout_plane, plot_layout

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_QUANTILE = 0.98


def plot_grasps(
    layout: TaxelLayout,
    readings: Mapping[str, Tensor],
    finger_names: Sequence[str],
    edge_index: Tensor | None = None,
    unit: str = "standard deviations",
) -> "Figure":
    r"""Draws several grasps with one row per grasp and one column per finger.

    All grasps share one colour scale. It is symmetric about zero and ends at the 98th percentile of
    the absolute readings, so that a single broken taxel does not make all other taxels pale.

    Args:
        layout (TaxelLayout): The layout of one finger.
        readings (Mapping of str to torch.Tensor): The readings of each grasp by title.
        finger_names (sequence of str): Names of the :math:`K` fingers.
        edge_index (torch.Tensor, optional): Edges to draw below the taxels.
        unit (str): Unit of the readings.

    Shapes:
        - **readings:** :math:`(N, K)` each
        - **edge_index:** directed edges :math:`(2, |\mathcal{E}|)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no grasps or no fingers, or if readings have another shape.

    Examples:
        >>> from torch_geometric_tactile.sensors import biotac_sp
        >>> readings = {"stable": torch.randn(24, 2), "slip": torch.randn(24, 2)}
        >>> figure = plot_grasps(biotac_sp(), readings, ["index", "thumb"])
        >>> figure.axes[-1].get_ylabel()
        'reading (standard deviations)'
    """
    need(readings, "'readings' must hold at least one grasp (got none)")
    need(finger_names, "'finger_names' must hold at least one name (got none)")
    shape = (layout.num_taxels, len(finger_names))
    for title, reading in readings.items():
        if tuple(reading.shape) != shape:
            raise ValueError(
                f"'readings' must have shape {shape} (got {tuple(reading.shape)} for '{title}')"
            )
    values = torch.stack(list(readings.values())).detach().cpu().double().numpy()
    limit, is_clipped = symmetric_limit(values, _QUANTILE)
    max_width = min(2.3, (MAX_WIDTH - 1.0) / len(finger_names))
    width, height = figure_size(layout_plane(layout), max_width)
    heading_height = 0.3
    figure = new_figure(
        width * len(finger_names) + 1.0, (height + heading_height + 0.35) * len(readings) + 0.2
    )
    grid = figure.add_gridspec(
        2 * len(readings), len(finger_names), height_ratios=[heading_height, height] * len(readings)
    )
    panels = []
    for row, (title, reading) in enumerate(readings.items()):
        heading = figure.add_subplot(grid[2 * row, :])
        heading.axis("off")
        text = heading.text(0, 0.2, plain_text(title), fontsize=TEXT + 1, weight="bold")
        text.set(color=current_theme().ink, in_layout=False)
        panels.append(heading)
        for column, name in enumerate(finger_names):
            ax = figure.add_subplot(grid[2 * row + 1, column])
            plot_layout(
                layout,
                reading[:, column],
                edge_index,
                ax,
                limits=(-limit, limit),
                cmap="diverging",
                label=None,
                title=name,
            )
            if row < len(readings) - 1:
                ax.set_xlabel("")
                ax.tick_params(labelbottom=False)
            if column > 0:
                ax.set_ylabel("")
                ax.tick_params(labelleft=False)
            panels.append(ax)
    figure.colorbar(
        value_scale(None, (-limit, limit), "diverging"),
        ax=panels,
        extend="both" if is_clipped else "neither",
        shrink=0.8,
        aspect=15 * len(readings),
        label=plain_text(f"reading ({unit})"),
    )
    return figure
