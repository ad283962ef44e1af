r"""Letters at the paper's numbers of images and epochs: the accuracy of the traditional CNN and of
the BMF-CNN on presses that were held out, after every epoch. Nothing is chosen by it.

The networks are trained by `tactile fit`, which goes on from its last checkpoint:
    tactile simulate --objects letters --presses 500 --out letters500
    tactile fit --config p5_tables/cnn --data.dataset.init_args.root letters500 \
        --data.val 0.2 --data.test 0

Examples:
    PYTHONPATH=benchmarks python studies/letter_epochs.py --runs runs
"""

import csv
import sys
from pathlib import Path

import numpy as np
from shared import parse, table, write_json

from torch_geometric_tactile.visualization import plot_curves, save_figure

_NAMES = {"cnn": "traditional CNN", "bmf_cnn": "BMF-CNN"}
_STEP = 10  # epochs that a point is the mean of
_SHOWN = (10, 20, 50, 100, 150, 200)


def accuracies(runs: Path, name: str) -> list[float]:
    """Returns the accuracy after each epoch in percent. A run that was stopped goes on in the
    folder of another version."""
    found: dict[int, float] = {}
    for path in sorted(runs.glob(f"{name}/version_*/metrics.csv"), key=lambda p: p.stat().st_mtime):
        for row in csv.DictReader(path.open(encoding="utf-8")):
            if row["val/accuracy"]:
                found[int(row["epoch"])] = 100 * float(row["val/accuracy"])
    return [found[epoch] for epoch in range(len(found))]


def points(values: list[float]) -> list[tuple[float, float, float]]:
    """Returns the last epoch, mean and standard deviation of every ten epochs."""
    parts = np.array(values[: len(values) // _STEP * _STEP]).reshape(-1, _STEP)
    return [
        (_STEP * (i + 1), float(part.mean()), float(part.std(ddof=1)))
        for i, part in enumerate(parts)
    ]


def main() -> int:
    """Writes numbers and picture."""
    arguments = parse(
        __doc__,
        {
            "--runs": (Path, "folder of tactile fit"),
            "--json": (Path("docs/results/letter_epochs.json"), "where numbers are written"),
            "--image": (Path("docs/images/p5-epochs.png"), "where the picture is written"),
        },
    )
    found = {name: accuracies(arguments.runs, name) for name in _NAMES}
    curves = {_NAMES[name]: points(values) for name, values in found.items()}
    write_json(arguments.json, {name: np.round(v, 2).tolist() for name, v in found.items()})
    title = "Simulated letters, 31,200 images to train, one fold by press, ± over ten epochs"
    figure = plot_curves(curves, "epochs", "Accuracy in % on presses held out", title)
    figure.axes[0].set_ylim(top=100)
    save_figure(figure, arguments.image)
    lines = [
        [f"{end - _STEP + 1} to {end}", *(_shown(curve, end) for curve in curves.values())]
        for end in _SHOWN
    ]
    print("\n".join(table(["epochs", *curves], lines)))
    return 0


def _shown(curve: list[tuple[float, float, float]], end: int) -> str:
    told = [f"{mean:.1f} ± {spread:.1f}" for epoch, mean, spread in curve if epoch == end]
    return told[0] if told else ""


if __name__ == "__main__":
    sys.exit(main())
