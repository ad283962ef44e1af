r"""Writes the tables, the numbers and the pictures of the study of the simulated hand from its runs
(see hand_study.py). What is above the marker of the page stays as it is.

Examples:
    PYTHONPATH=benchmarks python studies/hand_study_report.py --runs runs
"""

import platform
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from hand_study_numbers import Found, difference, load, of_answer, of_devices, of_other_hand
from hand_study_pictures import draw
from shared import parse, write, write_json

import torch_geometric_tactile

MARK = "<!-- below: written by studies/hand_study_report.py -->\n"
TITLES = {
    "posed": "`PosedTaxelNet`",
    "open": "`PosedTaxelNet`, open hand",
    "taxel_net_dropped": "`TaxelNet`",
    "taxel_net": "`TaxelNet`, no taxel dropout",
    "taxel_net_joint": "`TaxelNet` + joints",
    "fnn": "FNN + joints",
    "fnn_dropped": "FNN + joints, taxel dropout",
    "fnn_touch": "FNN",
    "flat_forest": "flat forest + joints",
    "flat_forest_touch": "flat forest",
    "posed_forest": "forest on posed sums",
    "posed_ridge": "ridge on posed sums",
}
_SPLITS = {
    ("shape", "trial"): "by trial",
    ("shape", "placement"): "unseen placements",
    ("width", "trial"): "by trial",
    ("width", "placement"): "unseen placements",
    ("width", "size"): "unseen largest size",
}
_PLAIN = ("flat_forest", "flat_forest_touch", "fnn", "fnn_touch", "fnn_dropped", "posed_forest")
_PAIRS = (
    *(("shape", "taxel_net_dropped", other) for other in _PLAIN),
    *(("shape", "posed", other) for other in _PLAIN),
    ("shape", "posed", "open"),
    ("shape", "taxel_net_dropped", "taxel_net"),
    ("shape", "posed", "taxel_net_dropped"),
    ("shape", "taxel_net_joint", "taxel_net_dropped"),
    ("shape", "fnn_dropped", "fnn"),
    ("width", "posed", "open"),
    *(("width", "posed", other) for other in _PLAIN if not other.endswith("touch")),
    ("width", "posed", "posed_ridge"),
    ("width", "posed", "taxel_net_joint"),
    ("width", "fnn_dropped", "fnn"),
)


def numbers(found: Found) -> dict[str, Any]:
    """All numbers of the page."""
    out: dict[str, Any] = {"scores": {}, "tests": {}, "trials": {}, "differences": []}
    for (task, by, trials), models in found.items():
        if trials is not None:
            continue
        scores = {}
        for name, runs in models.items():
            scores[name] = {
                **of_answer(runs, "test"),
                "weights": runs[0]["size"],
                "seconds": sum(run["seconds"] for run in runs) / len(runs),
                "train": [run["train"] for run in runs],
            }
        out["scores"].setdefault(task, {})[by] = scores
        if by == "trial":
            out["tests"][task] = {name: tests(runs) for name, runs in models.items()}
    for (task, _, trials), models in found.items():
        if trials is not None:
            part = out["trials"].setdefault(task, {}).setdefault(str(trials), {})
            part.update({name: of_answer(runs, "test") for name, runs in models.items()})
    for task, a, b in _PAIRS:
        for by in ("trial", "placement"):
            models = found.get((task, by, None), {})
            if a in models and b in models:
                pair = {"task": task, "by": by, "a": a, "b": b}
                out["differences"].append({**pair, **difference(models[a], models[b])})
    return out


def tests(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """What becomes of a model in other tests than it was trained for."""
    dead = sorted(
        (key for key in runs[0]["answers"] if key.startswith("dead")), key=lambda key: int(key[4:])
    )
    return {
        "dead": {"0": of_answer(runs, "test"), **{key[4:]: of_answer(runs, key) for key in dead}},
        "devices": of_devices(runs),
        "other_hand": of_other_hand(runs),
    }


def cell(value: dict[str, Any] | None, digits: int = 1) -> str:
    if value is None:
        return ""
    sd = "" if value["sd"] is None else f" ± {value['sd']:.{digits}f}"
    return f"{value['mean']:.{digits}f}{sd}"


def table(head: list[str], rows: Iterator[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"


def sections(found: dict[str, Any]) -> Iterator[str]:
    """The parts of the page below the marker."""
    for task, what in (("shape", "Shape, accuracy in %"), ("width", "Width, mean error in mm")):
        if task not in found["scores"]:
            continue
        digits = 1 if task == "shape" else 2
        yield f"## {what}\n\n" + score_table(found["scores"][task], task, digits)
        yield from difference_tables(found, task, digits)
    for task, tested in found["tests"].items():
        digits = 1 if task == "shape" else 2
        unit = "accuracy in %" if task == "shape" else "mean error in mm"
        yield f"## Other conditions at the test: {task}, {unit}, by trial\n\n"
        yield dead_table(tested, digits) + hand_table(tested, digits)
    if "shape" in found["trials"]:
        yield "## Number of training trials: shape, accuracy in %, by trial\n\n"
        yield trials_table(found)


def score_table(scores: dict[str, Any], task: str, digits: int) -> str:
    columns = [by for (kind, by) in _SPLITS if kind == task and by in scores]
    head = ["", *(heading(scores[by], task, by) for by in columns), "weights", "s"]
    first = scores[columns[0]]

    def rows() -> Iterator[list[str]]:
        for name in (name for name in TITLES if name in first):
            cells = [of_splits(scores[by], name, digits) for by in columns]
            weights = first[name]["weights"]
            yield [
                TITLES[name],
                *cells,
                "" if weights is None else f"{weights:,}",
                f"{first[name]['seconds']:.0f}",
            ]

    return table(head, rows())


def of_splits(models: dict[str, Any], name: str, digits: int) -> str:
    if name not in models:
        return ""
    count = len(models[name]["folds"])
    few = "" if count == most_splits(models) else f" ({count} split{'s' if count > 1 else ''})"
    return cell(models[name], digits) + few


def most_splits(models: dict[str, Any]) -> int:
    return max(len(model["folds"]) for model in models.values())


def heading(models: dict[str, Any], task: str, by: str) -> str:
    count = most_splits(models)
    return f"{_SPLITS[task, by]}, {count} split{'s' if count > 1 else ''}"


def difference_tables(found: dict[str, Any], task: str, digits: int) -> Iterator[str]:
    head = ["", "mean", "s.e. over splits", "s.e. over trials", "better in", "verdict"]
    for by in ("trial", "placement"):
        rows = (
            [
                f"{TITLES[pair['a']]} minus {TITLES[pair['b']]}",
                f"{pair['mean']:+.{digits}f}",
                "" if pair["over_splits"] is None else f"{pair['over_splits']:.{digits}f}",
                f"{pair['over_trials']:.{digits}f}",
                f"{pair['wins']} of {pair['splits']}",
                pair["verdict"],
            ]
            for pair in found["differences"]
            if (pair["task"], pair["by"]) == (task, by)
        )
        yield f"Paired differences ({task}, {_SPLITS[task, by]}):\n\n" + table(head, rows)


def dead_table(tested: dict[str, Any], digits: int) -> str:
    levels = list(next(iter(tested.values()))["dead"])
    rows = (
        [TITLES[name], *(cell(tested[name]["dead"][level], digits) for level in levels)]
        for name in TITLES
        if name in tested
    )
    return table(["", *(f"{level} % dead" for level in levels)], rows)


def hand_table(tested: dict[str, Any], digits: int) -> str:
    rows = (
        [
            TITLES[name],
            cell(tested[name]["devices"], digits),
            *(cell(tested[name]["other_hand"].get(key), digits) for key in ("trained on", "moved")),
        ]
        for name in TITLES
        if name in tested
    )
    head = ["", "other device", "trials of the other hand: 384 taxels", "240 taxels"]
    return table(head, rows)


def trials_table(found: dict[str, Any]) -> str:
    fewer = found["trials"]["shape"]
    levels = sorted(fewer, key=int)
    full = found["scores"]["shape"]["trial"]
    folds = max(len(one["folds"]) for models in fewer.values() for one in models.values())

    def rows() -> Iterator[list[str]]:
        for name in (name for name in TITLES if any(name in fewer[level] for level in levels)):
            last = full[name]["folds"][:folds]
            mean = f"{sum(last) / len(last):.1f}"
            yield [TITLES[name], *(cell(fewer[level].get(name)) for level in levels), mean]

    return table([f"{folds} splits", *levels, "480"], rows())


OPTIONS = {
    "--runs": (..., "folder of hand_study.py"),
    "--out": ("docs/results", "where page and numbers are written"),
    "--images": ("docs/images", "where pictures are written"),
}


def main(argv: list[str] | None = None) -> int:
    arguments = parse(__doc__, OPTIONS, argv)
    found = numbers(load(Path(arguments.runs)))
    found["versions"] = {
        "torch": torch.__version__,
        "torch_geometric_tactile": torch_geometric_tactile.__version__,
        "machine": platform.machine(),
    }
    out = Path(arguments.out)
    write_json(out / "hand_study.json", found)
    page = out / "hand_study.md"
    above = page.read_text("utf-8").partition(MARK)[0] if page.is_file() else ""
    write(page, (above + MARK + "\n" + "".join(sections(found))).rstrip() + "\n")
    draw(found, TITLES, Path(arguments.images))
    return 0


if __name__ == "__main__":
    sys.exit(main())
