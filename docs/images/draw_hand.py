r"""Draws the pictures of docs/hand.md beside this file: ``python docs/images/draw_hand.py``."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin
from torch_geometric_tactile.visualization import plot_hand, save_figure
from torch_geometric_tactile.visualization._style import new_figure

FOLDER = Path(__file__).parent


def save(figure: Figure, name: str) -> None:
    """Writes a picture of few colours in a small file."""
    save_figure(figure, FOLDER / name)
    with Image.open(FOLDER / name) as picture:
        small = picture.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    small.save(FOLDER / name, optimize=True)


def draw_patches(layout: TaxelLayout) -> None:
    """All patches with their names, and the digits that they belong to."""
    figure = new_figure(8.0, 11.4)
    above, below = figure.subplots(2, 1, height_ratios=[1.5, 1])
    plot_hand(layout, ax=above, color_by="patch", names="patch", title="22 patches, 384 taxels")
    plot_hand(layout, ax=below, names="digit", title="5 digits")
    save(figure, "hand_patches.png")


def draw_adjacencies(layout: TaxelLayout) -> None:
    """The hand with each adjacency, and a part of it magnified."""
    figure = new_figure(8.0, 8.3)
    panels: list[Axes] = list(figure.subplots(2, 2).flat)
    for ax, name in zip(panels, ("sparse", "slanted", "original", "dense"), strict=True):
        edges = layout.edge_index(name)
        plot_hand(layout, adjacency=edges, ax=ax, title=f"{name}: {edges.size(1)} directed edges")
        magnify(ax, layout, name)
    handles, labels = panels[2].get_legend_handles_labels()
    # A legend would show the arrow as a block of its colour.
    color = handles[-1].get_edgecolor()
    handles[-1] = Line2D([0, 1], [0, 0], color=color, marker=">", markersize=8, markevery=[-1])
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    save(figure, "hand_adjacencies.png")


def magnify(ax: Axes, layout: TaxelLayout, name: str) -> None:
    """The upper half of the index finger, three times as large, where the hand leaves room."""
    low, high = (38.0, 88.0), (72.0, 159.0)
    place = (92.0, -55.0, 3 * (high[0] - low[0]), 3 * (high[1] - low[1]))
    inset = ax.inset_axes(place, transform=ax.transData)
    plot_hand(layout, adjacency=name, ax=inset)
    inset.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="", ylabel="")
    inset.set(xticks=[], yticks=[])
    ax.indicate_inset_zoom(inset, edgecolor="#888888")


if __name__ == "__main__":
    draw_patches(allegro_uskin())
    draw_adjacencies(allegro_uskin())
