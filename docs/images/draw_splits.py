"""Draws docs/images/splits_light.svg and splits_dark.svg from docs/results/grasp_stability.json."""

import json
from pathlib import Path
from statistics import mean

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
RESULTS = HERE.parent / "results" / "grasp_stability.json"
TESTS = {
    "random folds": "new\ngrasps",
    "leave objects out": "new\nobjects",
    "objects and sessions": "new objects,\nnew sessions",
    "unseen objects": "official\ntest",
}
PREPARED, RAW = "common mode, middle + thumb", "raw"
LINES = (("TaxelNet", PREPARED), ("SVM", PREPARED), ("SVM", RAW), ("GCN-DF", RAW))
STYLES = {"TaxelNet": "o-", "SVM": "s--", "GCN-DF": "^-."}
# Ground, text, prepared readings, raw readings.
THEMES = {
    "light": ("#ffffff", "#222832", "#0072b2", "#b85000"),
    "dark": ("#14181e", "#ced6dd", "#56b4e9", "#e69f00"),
}


def accuracies(model: str, readings: str) -> list[float]:
    """Mean accuracy over the seeds in percent, by what is new in the test."""
    results = json.loads(RESULTS.read_text("utf-8"))["results"]
    return [
        100
        * mean(
            one["accuracy"]
            for one in results
            if (one["model"], one["readings"], one["protocol"]) == (model, readings, protocol)
        )
        for protocol in TESTS
    ]


def draw(theme: str) -> None:
    """Draws the figure for a theme of the site."""
    ground, ink, prepared, raw = THEMES[theme]
    plt.rcParams.update({"svg.hashsalt": "splits", "text.color": ink, "font.size": 9})
    figure, axes = plt.subplots(figsize=(4.0, 3.2), facecolor=ground, layout="constrained")
    axes.set_facecolor(ground)
    for model, readings in LINES:
        color = prepared if readings == PREPARED else raw
        kind = "prepared" if readings == PREPARED else "raw"
        label = f"{model}, {kind} readings"
        axes.plot([*TESTS.values()], accuracies(model, readings), STYLES[model], color=color,
                  markersize=5, label=label)  # fmt: skip
    axes.set_ylim(48, 96)
    axes.set_ylabel("accuracy in %", color=ink)
    axes.tick_params(colors=ink, length=0)
    axes.grid(axis="y", color=ink, alpha=0.15)
    axes.spines[:].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=8, handlelength=2.6,
                  columnspacing=1)  # fmt: skip
    figure.savefig(HERE / f"splits_{theme}.svg", metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    for name in THEMES:
        draw(name)
