"""The pictures of the study of the simulated hand."""

from pathlib import Path
from typing import Any

from torch_geometric_tactile.visualization._style import new_figure, open_plot, title_axes
from torch_geometric_tactile.visualization.figure import save_figure

# The colours of all pictures, paler for variants of a model.
_COLORS = {
    "posed": "#d55e00",
    "open": "#eba678",
    "taxel_net": "#56b4e9",
    "taxel_net_dropped": "#0072b2",
    "taxel_net_joint": "#b1dcf5",
    "fnn": "#1b1f24",
    "fnn_dropped": "#cc79a7",
    "fnn_touch": "#9aa3ad",
    "flat_forest": "#009e73",
    "flat_forest_touch": "#86cfba",
    "posed_forest": "#e69f00",
    "posed_ridge": "#f4d592",
}
_MARKS = dict(zip(_COLORS, "osDphdxX^v*P", strict=True))
_DARK = (
    "posed",
    "taxel_net_dropped",
    "fnn",
    "flat_forest",
)
_CURVES = (
    "posed",
    "taxel_net_dropped",
    "taxel_net",
    "fnn_dropped",
    "fnn",
    "flat_forest",
    "posed_forest",
)


_PATCH = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}


def draw(found: dict[str, Any], titles: dict[str, str], folder: Path) -> None:
    """Writes all for which there are numbers."""
    names = {name: title.replace("`", "") for name, title in titles.items()}
    tasks = [task for task in ("shape", "width") if task in found["scores"]]
    bars(found, names, tasks, folder / "hand_study_models.png")
    curves(found, names, tasks, folder / "hand_study_dead.png")
    if "shape" in found["trials"]:
        trials(found, names, folder / "hand_study_trials.png")


def bars(found: dict[str, Any], names: dict[str, str], tasks: list[str], file: Path) -> None:
    figure = new_figure(4.0 * len(tasks), 5.8)
    is_hatched = False
    for i, task in enumerate(tasks):
        axes = figure.add_subplot(1, len(tasks), i + 1)
        scores = found["scores"][task]
        shown = [name for name in names if name in scores["trial"]]
        both = [by for by in ("trial", "placement") if by in scores]
        for j, by in enumerate(both):
            there = [(place, name) for place, name in enumerate(shown) if name in scores[by]]
            values = [scores[by][name] for _, name in there]
            drawn = axes.barh(
                [place + (j - (len(both) - 1) / 2) * 0.4 for place, _ in there],
                [value["mean"] for value in values],
                0.38,
                xerr=[value["sd"] or 0.0 for value in values],
                color=[_COLORS[name] for _, name in there],
                alpha=1.0 if by == "trial" else 0.5,
                error_kw={"lw": 1.0, "ecolor": "#1b1f24"},
            )
            for bar, (_, name), value in zip(drawn, there, values, strict=True):
                if value["sd"] is None:  # of one split
                    bar.set(facecolor="white", edgecolor=_COLORS[name], hatch="////")
                    is_hatched = True
            for place, name in there:
                digits = 1 if task == "shape" else 2
                axes.annotate(
                    f"{scores[by][name]['mean']:.{digits}f}",
                    (0, place + (j - (len(both) - 1) / 2) * 0.4),
                    (4, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize=7,
                    color="white" if by == "trial" and name in _DARK else "#1b1f24",
                    bbox=_PATCH if scores[by][name]["sd"] is None else None,
                )
        axes.set_yticks(range(len(shown)), [names[name] for name in shown])
        axes.tick_params(axis="y", length=0, labelcolor="#1b1f24")
        axes.invert_yaxis()
        axes.set_xlabel("accuracy in %, higher is better" if task == "shape" else
                        "mean error in mm, lower is better")  # fmt: skip
        title_axes(axes, task)
        open_plot(axes, "x")
    note = "; hatched: one split, no spread known" if is_hatched else ""
    figure.suptitle(f"Dark: by trial; pale: unseen placements{note}")
    save_figure(figure, file)


def curves(found: dict[str, Any], names: dict[str, str], tasks: list[str], file: Path) -> None:
    figure = new_figure(4.0 * len(tasks), 3.9)
    for i, task in enumerate(tasks):
        axes = figure.add_subplot(1, len(tasks), i + 1)
        tested = found["tests"][task]
        for name in (name for name in _CURVES if name in tested):
            levels = tested[name]["dead"]
            line(axes, [int(level) for level in levels], list(levels.values()), name, names)
        axes.set_xlabel("dead taxels at the test, %")
        axes.set_ylabel("accuracy, %" if task == "shape" else "mean error, mm")
        title_axes(axes, f"{task}, by trial")
        handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    save_figure(figure, file)


def trials(found: dict[str, Any], names: dict[str, str], file: Path) -> None:
    figure = new_figure(6.0, 4.4)
    axes = figure.add_subplot(1, 1, 1)
    fewer, full = found["trials"]["shape"], found["scores"]["shape"]["trial"]
    for name in (name for name in _CURVES if any(name in part for part in fewer.values())):
        levels = sorted((level for level in fewer if name in fewer[level]), key=int)
        values = [fewer[level][name] for level in levels]
        folds = full[name]["folds"][: len(values[0]["folds"])]
        mean = sum(folds) / len(folds)
        sd = (sum((x - mean) ** 2 for x in folds) / max(1, len(folds) - 1)) ** 0.5
        values.append({"mean": mean, "sd": sd})
        line(axes, [*(int(level) for level in levels), 480], values, name, names)
    axes.set_xscale("log")
    axes.set_xticks([60, 150, 300, 480], ["60", "150", "300", "480"])
    axes.minorticks_off()
    axes.set_xlabel("training trials")
    axes.set_ylabel("accuracy, %")
    title_axes(axes, "shape, by trial")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    save_figure(figure, file)


def line(
    axes: Any, places: list[int], values: list[dict[str, Any]], name: str, names: dict[str, str]
) -> None:
    axes.errorbar(
        places,
        [value["mean"] for value in values],
        [value["sd"] or 0.0 for value in values],
        color=_COLORS[name],
        marker=_MARKS[name],
        markersize=5,
        lw=1.5,
        elinewidth=0.7,
        capsize=2,
        label=names[name],
    )
    open_plot(axes)
