r"""Pictures of node features in two or three dimensions."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.visualization._style import (
    MARKERS,
    current_theme,
    new_figure,
    plain_text,
    title_axes,
    title_figure,
)
from torch_geometric_tactile.visualization._taxel_map import digit_color, segment_colors
from torch_geometric_tactile.visualization.hand import plot_hand

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_VIEWS = ((0, 1), (0, 2), (1, 2))  # pairs of axes


def plot_embedding(
    places: Tensor,
    layout: TaxelLayout,
    kinematics: HandKinematics | None = None,
    *,
    color_by: Literal["patch", "digit"] = "patch",
    axis_name: str = "component",
    title: str | None = None,
    untrained: Tensor | None = None,
) -> "Figure":
    r"""Draws each taxel at the position of its features in an embedding, with a hand as the colour
    legend, as in the "Tactile Object Property Recognition using Geometrical Graph Edge
    Features and Multi-Thread Graph Convolutional Network" and the "Multifingered Object Recognition
    with Tactile Sensors and Graph Convolutional Networks using Topological Graph Segmentation"
    papers.

    Embeddings in three dimensions are drawn along each of the three axes. The axes have no numbers,
    because neither the scale nor the direction of an embedding has a meaning.

    Args:
        places (torch.Tensor): Position of each taxel in the embedding.
        layout (TaxelLayout): The layout.
        kinematics (HandKinematics, optional): The hand, as in :func:`plot_hand`.
        color_by (str): Segments of one colour: :obj:`"patch"` (tints of the colour of the digit) or
            :obj:`"digit"`. Digits have different markers in both cases.
        axis_name (str): Name of the axes, to which a number is added, such as :obj:`"t-SNE"`.
        title (str, optional): Title of the picture.
        untrained (torch.Tensor, optional): Positions for the features of an untrained network with
            the same architecture. They are drawn for comparison: only the differences are due to
            training.

    Shapes:
        - **places:** :math:`(N, 2)` or :math:`(N, 3)`
        - **untrained:** like :obj:`places`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If :obj:`places` does not fit the layout or is not finite, or :obj:`color_by` is
            unknown.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> figure = plot_embedding(torch.randn(384, 2), allegro_uskin(), axis_name="t-SNE")
        >>> figure.axes[0].get_xlabel()
        't-SNE 1'
    """
    places = _checked_places("places", places, layout)
    if untrained is not None:
        untrained = _checked_places("untrained", untrained, layout)
        if untrained.shape != places.shape:
            raise ValueError(
                f"'untrained' must have the shape of 'places', {tuple(places.shape)} (got "
                f"{tuple(untrained.shape)})"
            )
    if color_by not in ("patch", "digit"):
        raise ValueError(f"'color_by' must be 'patch' or 'digit' (got '{color_by}')")
    views = _VIEWS[: 3 if places.size(1) == 3 else 1]
    if untrained is not None:
        figure, axes, hand = _axes_of_two_models(len(views))
    elif len(views) == 1:
        figure = new_figure(8.0, 4.3)
        axes = list(figure.subplots(1, 2, width_ratios=[1.25, 1]).flat)
        hand = axes.pop()
    else:
        figure = new_figure(8.0, 7.4)
        axes = list(figure.subplots(2, 2).flat)
        hand = axes.pop()
    colors = segment_colors(layout, color_by)
    panels = [(places, view) for view in views]
    if untrained is not None:
        panels += [(untrained, view) for view in views]
        title_axes(axes[0], "trained")
        title_axes(axes[len(views)], "untrained")
    for ax, (embedding, (first, second)) in zip(axes, panels, strict=True):
        _draw_places(ax, embedding[:, [first, second]], layout, colors)
        ax.set_xlabel(plain_text(f"{axis_name} {first + 1}"))
        ax.set_ylabel(plain_text(f"{axis_name} {second + 1}"))
    plot_hand(layout, kinematics, ax=hand, color_by=color_by, names="digit")
    hand.set_axis_off()
    _draw_legend(figure, layout.digit_names)
    title_figure(figure, title)
    return figure


def _checked_places(name: str, places: Tensor, layout: TaxelLayout) -> Tensor:
    places = torch.as_tensor(places).detach().cpu().double()
    if places.shape not in ((layout.num_taxels, 2), (layout.num_taxels, 3)):
        raise ValueError(
            f"'{name}' must have shape ({layout.num_taxels}, 2) or ({layout.num_taxels}, 3) "
            f"(got {tuple(places.shape)})"
        )
    need(places.isfinite().all(), f"'{name}' must hold finite numbers (got NaN or infinity)")
    return places


def _axes_of_two_models(num_views: int) -> "tuple[Figure, list[Axes], Axes]":
    # Models are drawn side by side if they have one view, otherwise one below the other. The hand
    # is on the right.
    rows, columns = (1, 2) if num_views == 1 else (2, num_views)
    figure = new_figure(8.0, 3.3 if rows == 1 else 4.9)
    hand_width = 1.0 if rows == 1 else 1.5  # in widths of a view; the names of digits need space
    grid = figure.add_gridspec(rows, columns + 1, width_ratios=[1.0] * columns + [hand_width])
    axes = [figure.add_subplot(grid[i // columns, i % columns]) for i in range(rows * columns)]
    return figure, axes, figure.add_subplot(grid[:, columns])


def _draw_places(
    ax: "Axes", places: Tensor, layout: TaxelLayout, colors: list[tuple[float, float, float]]
) -> None:
    digit = layout.segments("digit")
    for i in range(len(layout.digit_names)):
        taxels = (digit == i).nonzero().view(-1).tolist()
        x, y = places[taxels].T.tolist()
        ax.scatter(
            x,
            y,
            s=20,
            c=[colors[k] for k in taxels],
            marker=MARKERS[i % len(MARKERS)],
            edgecolors=current_theme().outline,
            linewidths=0.4,
        )
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.05)
    ax.tick_params(bottom=False, left=False, labelbottom=False, labelleft=False)


def _draw_legend(figure: "Figure", names: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            linestyle="none",
            marker=MARKERS[i % len(MARKERS)],
            markerfacecolor=digit_color(i),
            markeredgecolor=current_theme().outline,
            markeredgewidth=0.4,
            label=plain_text(name),
        )
        for i, name in enumerate(names)
    ]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=len(names),
    )
