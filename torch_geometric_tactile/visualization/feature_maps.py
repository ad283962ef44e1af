r"""Pictures of feature maps and of samples in an embedding of their features."""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.visualization._style import (
    MAX_WIDTH,
    TEXT,
    colormap,
    current_theme,
    fit_text,
    new_figure,
    plain_text,
    series_color,
    series_marker,
    title_axes,
    title_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_feature_maps(
    image: ArrayLike, maps: Mapping[str, ArrayLike], title: str, columns: int = 9
) -> "Figure":
    r"""Draws an image and its feature maps, with separate rows for each kind of map. All maps of
    the same kind share one colour scale from the smallest to the largest number.

    Args:
        image (array): The image.
        maps (Mapping): The maps by the name of their kind.
        title (str): Title of the picture.
        columns (int): Largest number of maps side by side.

    Shapes:
        - **image:** :math:`(H, W)`
        - **maps:** :math:`(K, H', W')` each

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no maps, or maps have another shape.

    Examples:
        >>> figure = plot_feature_maps(np.eye(8), {"first layer": np.ones((3, 4, 4))}, "Maps")
        >>> len(figure.axes)  # the image and three maps
        4
    """
    kinds = {name: np.asarray(values, dtype=np.float64) for name, values in maps.items()}
    if not kinds or any(kind.ndim != 3 or kind.size == 0 for kind in kinds.values()):
        raise ValueError("'maps' must hold maps of shape (number, height, width), at least one")
    columns = min(columns, max(len(kind) for kind in kinds.values()))
    num_rows = {name: ceil(len(kind) / columns) for name, kind in kinds.items()}
    total_rows = sum(num_rows.values())
    figure = new_figure(min(MAX_WIDTH, 0.95 * (columns + 1.4) + 0.4), 0.95 * total_rows + 0.8)
    grid = figure.add_gridspec(total_rows, columns + 1, width_ratios=[1.5, *[1] * columns])
    ax = figure.add_subplot(grid[:, 0])
    _draw_image(ax, np.asarray(image), 0.0, None)
    title_axes(ax, "input")
    first_row = 0
    for name, kind in kinds.items():
        for i, values in enumerate(kind):
            ax = figure.add_subplot(grid[first_row + i // columns, 1 + i % columns])
            _draw_image(ax, values, float(kind.min()), float(kind.max()))
            if i == 0:
                text = ax.text(0, 1.12, plain_text(name), fontsize=TEXT, transform=ax.transAxes)
                # The name may be wider than its map, so the layout must not reserve space for it.
                text.set(color=current_theme().ink, va="bottom", in_layout=False)
        first_row += num_rows[name]
    title_figure(figure, title)
    return figure


def _draw_image(ax: "Axes", values: np.ndarray, low: float, high: float | None) -> None:
    ax.imshow(values, cmap=colormap("sequential"), vmin=low, vmax=high, interpolation="nearest")
    ax.set_xticks(())
    ax.set_yticks(())


def plot_sample_embeddings(
    panels: Mapping[str, tuple[ArrayLike, Sequence[str]]], title: str, columns: int = 4
) -> "Figure":
    r"""Draws samples at the positions of their features in an embedding, with a colour for each
    class and a panel for each model. The axes have no numbers, because neither the scale nor the
    direction of an embedding has a meaning.

    Args:
        panels (Mapping): Positions and class names of the samples, by the name of the model.
        title (str): Title of the picture.
        columns (int): Largest number of panels side by side.

    Shapes:
        - **positions:** :math:`(S, 2)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no panels, or if the numbers of positions and names differ.

    Examples:
        >>> places = np.array([[0.0, 1.0], [2.0, 3.0]])
        >>> figure = plot_sample_embeddings({"GCN": (places, ["A", "B"])}, "t-SNE")
        >>> figure.axes[0].get_title()
        'GCN'
    """
    need(panels, "'panels' must hold at least one model (got none)")
    names = list(dict.fromkeys(name for _, labels in panels.values() for name in labels))
    columns = min(columns, len(panels))
    rows = ceil(len(panels) / columns)
    figure = new_figure(max(4.0, 2.0 * columns), 2.1 * rows + 0.9)
    axes = figure.subplots(rows, columns, squeeze=False).flat
    for ax, (model, (positions, labels)) in zip(axes, panels.items(), strict=False):
        places = np.asarray(positions, dtype=np.float64)
        if places.shape != (len(labels), 2):
            raise ValueError(
                f"'places' of '{model}' must have shape ({len(labels)}, 2) (got {places.shape})"
            )
        for i, name in enumerate(names):
            class_places = places[[label == name for label in labels]]
            ax.scatter(
                *class_places.T,
                s=14,
                color=series_color(i),
                marker=series_marker(i),
                linewidths=0.3,
                edgecolors=current_theme().ground,
                label=plain_text(name),
            )
        title_axes(ax, fit_text(model, 1.9, TEXT))
        ax.set_xticks(())
        ax.set_yticks(())
    for ax in list(figure.axes)[len(panels) :]:
        ax.set_visible(False)
    handles, legend_labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, legend_labels, loc="outside lower center", ncols=min(len(names), 8))
    title_figure(figure, title)
    return figure
