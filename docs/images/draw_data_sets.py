r"""Draws what published data sets hold: ``python docs/images/draw_data_sets.py DIR``, where DIR has
the folders PressureMat and EFleshSlip.
"""

import sys
from pathlib import Path

import torch

from torch_geometric_tactile.datasets import EFleshSlip, PressureMat
from torch_geometric_tactile.visualization import save_figure
from torch_geometric_tactile.visualization._style import new_figure

_HERE = Path(__file__).parent
_PERSON = "S4"
_SHOWN = {"i": ("1", "2", "3", "13"), "ii": ("B2", "C2", "D2", "B5")}


def mats(root: Path) -> None:
    r"""Draws postures on both mats."""
    figure = new_figure(7.0, 2.6)
    axes = figure.subplots(1, 8)
    place = iter(axes)
    for experiment, postures in _SHOWN.items():
        frames = PressureMat(root, experiment)
        sides = PressureMat(root, experiment, "side")
        person = frames.column("group") == frames.group_names.index(_PERSON)
        for posture in postures:
            wanted = person & (frames.column("y") == frames.class_names.index(posture))
            row = int(wanted.nonzero()[0])
            axis = next(place)
            image = frames.column("x")[row].view(64, -1)
            axis.imshow(image.clamp(max=image.quantile(0.99)), cmap="viridis", aspect="equal")
            side = sides.class_names[int(sides.column("y")[row])]
            axis.set_title(f"{experiment.upper()}, {posture}\n{side}", fontsize=8)
            axis.set_xticks([])
            axis.set_yticks([])
    save_figure(figure, _HERE / "pressure_mat.png")


def eflesh(root: Path) -> None:
    r"""Draws a sequence of each run."""
    frames = EFleshSlip(root)
    figure = new_figure(7.0, 2.4)
    axes = figure.subplots(1, 3, sharey=True)
    for session, axis in enumerate(axes):
        trial = int(frames.column("trial")[frames.column("session") == session][0])
        rows = (frames.column("trial") == trial).nonzero().view(-1)
        x = frames.column("x")[rows]
        moved = torch.linalg.vector_norm(x - x[:10].mean(dim=0), dim=2)
        axis.plot(frames.column("time")[rows], moved, linewidth=0.8)
        number, label = frames.session_names[session].split("_")
        axis.set_title(f"run {number}, {label}", fontsize=9)
        axis.set_xlabel("time (s)", fontsize=8)
        axis.tick_params(labelsize=7)
    axes[0].set_ylabel("change of field since\nthe first ten frames", fontsize=8)
    save_figure(figure, _HERE / "eflesh_slip.png")


def main() -> None:
    r"""Draws all."""
    root = Path(sys.argv[1])
    mats(root / "PressureMat")
    eflesh(root / "EFleshSlip")


if __name__ == "__main__":
    main()
