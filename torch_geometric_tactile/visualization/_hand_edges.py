r"""The edges below the taxels of a hand."""

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.visualization._style import current_theme
from torch_geometric_tactile.visualization._taxel_map import checked_edges

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_edges(ax: "Axes", plane: Tensor, edge_index: Tensor, layout: TaxelLayout) -> None:
    r"""Draws each pair once, in the colour of its kind, and edges without their reverse as arrows.

    Shapes:
        - **plane:** The taxels in the plane, in millimetres :math:`(N, 2)`.
        - **edge_index:** Directed edges :math:`(2, |\mathcal{E}|)`.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patches import FancyArrowPatch

    look = current_theme()
    pieces, joins, arrows = _sorted_edges(edge_index, layout)
    for pairs, color, kind in (
        (pieces, look.soft, "within a patch"),
        (joins, look.join, "between patches"),
    ):
        if len(pairs):
            ax.add_collection(
                LineCollection(
                    list(plane[pairs].numpy()), colors=color, linewidths=0.7, zorder=1, label=kind
                )
            )
    for i, (tail, head) in enumerate(plane[arrows].tolist()):
        ax.add_patch(
            FancyArrowPatch(
                tail,
                head,
                arrowstyle="-|>",
                mutation_scale=12,
                shrinkA=0,
                shrinkB=2,
                color=look.one_way,
                linewidth=1.6,
                zorder=3,
                label="one way only" if i == 0 else None,
            )
        )


def draw_edge_values(
    ax: "Axes", plane: Tensor, edge_index: Tensor, value: Tensor, scale: Any, linewidth: float
) -> None:
    r"""Draws each directed edge in the colour of its value: the half next to its target, or all of
    it if it has no reverse.

    Shapes:
        - **plane:** The taxels in the plane, in millimetres :math:`(N, 2)`.
        - **edge_index:** Directed edges :math:`(2, |\mathcal{E}|)`.
        - **value:** Their values :math:`(|\mathcal{E}|,)`.
    """
    from matplotlib.collections import LineCollection

    source, target = edge_index
    returns = _returns(source, target, len(plane)).view(-1, 1)
    start = torch.where(returns, (plane[source] + plane[target]) / 2, plane[source])
    ax.add_collection(
        LineCollection(
            list(torch.stack([start, plane[target]], dim=1).numpy()),
            colors=scale.to_rgba(value.numpy()),
            linewidths=linewidth,
            capstyle="butt",
            zorder=1,
            label="edge value",
        )
    )


def _returns(source: Tensor, target: Tensor, num_taxels: int) -> Tensor:
    return torch.isin(target * num_taxels + source, source * num_taxels + target)


def _sorted_edges(edge_index: Tensor, layout: TaxelLayout) -> tuple[Tensor, Tensor, Tensor]:
    # Pairs within a patch, pairs between patches, and edges without their reverse, all (n, 2).
    num_taxels = layout.num_taxels
    source, target = checked_edges("adjacency", edge_index, num_taxels).unique(dim=1)
    returns = _returns(source, target, num_taxels)
    pairs = torch.stack([source, target], dim=1)
    both = pairs[returns & (source < target)]
    patch = layout.segments("patch")[both]
    within = patch[:, 0] == patch[:, 1]
    return both[within], both[~within], pairs[~returns]
