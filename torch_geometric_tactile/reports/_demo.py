r"""The report of ``tactile demo``: a table of accuracies, pictures and a conclusion."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from sklearn.metrics import confusion_matrix
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._compared_models import FLOOR
from torch_geometric_tactile.experiments._demo import (
    COMMON_MODE,
    OFFICIAL_TEST,
    RANDOM_GRASPS,
    RAW,
)
from torch_geometric_tactile.experiments.advice import advice, recommended, to_dict
from torch_geometric_tactile.experiments.comparison import Comparison, Summary
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.reports.html import ReportPicture, ReportTable, write_report
from torch_geometric_tactile.sensors import layout_sectors
from torch_geometric_tactile.transforms import CommonMode, ZScore, fit_transform
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_grasps,
    plot_protocols,
    save_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Comparisons by the preparation of the readings, then by the held-out part.
DemoComparisons = Mapping[str, Mapping[str, Comparison]]

_FINGERS = ("index finger", "middle finger", "thumb")
_CAPTION = (
    "Mean ± standard deviation over the splits; for the official test, over the seeds. The first "
    "three columns are splits of the training set that hold out random grasps, objects, or one of "
    "the three recording sessions (palm poses). The official test has new objects in new "
    "sessions. "
    "Common mode: the mean over each finger's electrodes is subtracted from every reading. "
    "Settings were selected on a part of the training samples; networks were trained for {epochs} "
    "epochs. The bold row is the model that is recommended on the official test."
)


def demo_rows(comparisons: DemoComparisons) -> tuple[list[str], list[list[str]]]:
    r"""Returns the header and the rows of the table of accuracies in percent, with a row for each
    preparation and model. The row of the recommended model, if there is one, begins with :obj:`*`.
    """
    columns = list(next(iter(comparisons.values())))
    best = recommended(comparisons[COMMON_MODE][OFFICIAL_TEST])
    rows = []
    for readings, by_held_out in comparisons.items():
        for result in by_held_out[OFFICIAL_TEST].results:
            name = result.model.name
            is_best = readings == COMMON_MODE and best is not None and best.model.name == name
            scores = [by_held_out[column].of(name).scores["accuracy"] for column in columns]
            rows.append([f"{'*' if is_best else ''}{name}", readings, *map(_percent, scores)])
    return ["model", "readings", *columns], rows


def main_model(comparisons: DemoComparisons) -> str:
    r"""Returns the model that the comparison on the official test recommends for readings without
    common mode, or the best model if none is recommended.
    """
    comparison = comparisons[COMMON_MODE][OFFICIAL_TEST]
    result = recommended(comparison) or comparison.best
    assert result is not None
    return result.model.name


def demo_conclusion(comparisons: DemoComparisons) -> str:
    r"""Returns the result of the demo in one paragraph."""
    name = main_model(comparisons)

    def percent(readings: str, held_out: str, model: str = name) -> str:
        result = comparisons[readings][held_out].of(model)
        return f"{100 * result.scores['accuracy'].mean:.1f} %"

    data = comparisons[COMMON_MODE][OFFICIAL_TEST].run.plan.data
    is_generated = data.kind == "generated"
    texts = [
        "The data is generated: the numbers only show that everything runs."
        if is_generated
        else "",
        "A robot hand holds an object between three sensor fingertips; from one reading, a model "
        "predicts whether the object will slip.",
        f"On raw readings, {name} is correct for {percent(RAW, RANDOM_GRASPS)} of random grasps of "
        f"known objects in known sessions, and for {percent(RAW, OFFICIAL_TEST)} of the grasps in "
        "the official test, where objects and sessions are new.",
        "" if is_generated else "Between sessions, all readings of a finger shift together.",
        f"With the mean of each finger subtracted and the index finger left out, {name} is correct "
        f"for {percent(COMMON_MODE, OFFICIAL_TEST)} of the official test; always predicting the "
        f"more frequent class is correct for {percent(COMMON_MODE, OFFICIAL_TEST, FLOOR)}.",
        "A score holds only for the conditions of its test part: hold out the objects or "
        "sessions that will be new on your robot.",
    ]
    return " ".join(filter(None, texts))


def write_demo(comparisons: DemoComparisons, out: PathLike) -> list[Path]:
    r"""Writes :obj:`report.html`, its pictures and :obj:`comparisons.json`. Returns the paths of
    the report and of the JSON file.
    """
    out = Path(out)
    official = comparisons[COMMON_MODE][OFFICIAL_TEST]
    data = official.run.plan.data
    header, rows = demo_rows(comparisons)
    content = [
        {"readings": readings, "held_out": held_out, **to_dict(comparison)}
        for readings, by_held_out in comparisons.items()
        for held_out, comparison in by_held_out.items()
    ]
    with atomic_path(out / "comparisons.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    experiments = official.run.plan.experiments
    epochs = max(experiment.epochs for experiment in experiments)
    caption = _CAPTION.format(epochs=epochs)
    write_report(
        out / "report.html",
        title="Will it slip? Grasp stability from touch",
        verdict=demo_conclusion(comparisons),
        notice=data.caption,
        is_warning=data.kind == "generated",
        facts=_facts(comparisons),
        tables=[ReportTable("Accuracy in % by held-out part", caption, header, rows)],
        pictures=_pictures(comparisons, out),
    )
    return [out / "report.html", out / "comparisons.json"]


def _percent(score: Summary) -> str:
    # The standard deviation of a single run is NaN.
    spread = "" if score.sd != score.sd else f" ± {100 * score.sd:.1f}"
    return f"{100 * score.mean:.1f}{spread}"


def _facts(comparisons: DemoComparisons) -> list[tuple[str, str]]:
    official = comparisons[COMMON_MODE][OFFICIAL_TEST]
    train, test = _parts(official)
    results = [
        result
        for by_held_out in comparisons.values()
        for comparison in by_held_out.values()
        for _, result in comparison.run.results
    ]
    seconds = sum(result["seconds"] for result in results)
    models = "; ".join(f"{result.model.name}: {result.model.title}" for result in official.results)
    return [
        (
            "Data",
            f"{len(train):,} grasps of {_num_objects(train)} objects for training, {len(test):,} "
            f"grasps of {_num_objects(test)} other objects in the official test",
        ),
        ("Task", "will the object slip, from one reading of 3 fingers x 24 electrodes"),
        ("Models", models),
        (
            "Splits",
            ", ".join(
                f"{held_out} {comparison.num_splits}"
                for held_out, comparison in comparisons[RAW].items()
            ),
        ),
        ("Seeds", ", ".join(map(str, range(comparisons[RAW][RANDOM_GRASPS].run.plan.seeds)))),
        *(
            (f"Verdict, {held_out}", advice(comparison))
            for held_out, comparison in comparisons[COMMON_MODE].items()
        ),
        ("Machine", results[0]["machine"]),
        ("Time", f"{seconds:.0f} s for all runs"),
    ]


def _parts(comparison: Comparison) -> tuple[StaticDataset, StaticDataset]:
    experiment = comparison.run.plan.experiments[0]
    train, test = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
    assert isinstance(train, StaticDataset)
    assert isinstance(test, StaticDataset)
    return train, test


def _num_objects(dataset: StaticDataset) -> int:
    group = dataset.column("group")
    return 0 if group is None else len(group.unique())


def _pictures(comparisons: DemoComparisons, out: Path) -> list[ReportPicture]:
    train, _ = _parts(comparisons[RAW][OFFICIAL_TEST])
    grasps, source = _example_grasps(train)
    name = main_model(comparisons)
    figures: dict[str, tuple[Figure, str, str]] = {
        "protocols": (
            plot_protocols(_accuracies(comparisons), chance=0.5),
            "Accuracy by held-out part",
            "Means in % over the splits (official test: over the seeds). Bars show standard "
            "deviations; the dashed line is at 50 %.",
        ),
        "grasps": (
            plot_grasps(
                train.layout,
                grasps,
                finger_names=list(_FINGERS),
                edge_index=layout_sectors(train.layout).edge_index,
            ),
            "Electrodes of the three fingers",
            f"A stable and a slipping grasp of one object in one session ({source}). Each is the "
            "grasp nearest to the mean of its outcome. The common mode of each finger is "
            "subtracted, and all electrodes share one scale. Lines are the edges of TaxelNet.",
        ),
        "confusion": (
            plot_confusion(
                _confusion(comparisons[COMMON_MODE][OFFICIAL_TEST], name),
                train.class_names,
                f"Official test, {name}, seed 0, {COMMON_MODE}",
            ),
            "Confusion matrix",
            "Rows are true outcomes; columns are predictions.",
        ),
    }
    pictures = []
    for file_name, (figure, title, caption) in figures.items():
        save_figure(figure, out / f"{file_name}.png")
        pictures.append(ReportPicture(out / f"{file_name}.png", title, caption))
    return pictures


def _accuracies(
    comparisons: DemoComparisons,
) -> dict[str, dict[str, dict[str, tuple[float, float]]]]:
    # Mean and standard deviation by model, held-out part and preparation.
    accuracies: dict[str, dict[str, dict[str, tuple[float, float]]]] = {}
    for readings, by_held_out in comparisons.items():
        for held_out, comparison in by_held_out.items():
            for result in comparison.results:
                if result.model.name != FLOOR:
                    by_part = accuracies.setdefault(result.model.name, {})
                    by_part.setdefault(held_out, {})[readings] = result.scores["accuracy"]
    return accuracies


def _confusion(comparison: Comparison, model: str) -> list[list[int]]:
    result = next(
        result for experiment, result in comparison.run.results if experiment.name == model
    )
    predictions = Predictions.from_dict(result["predictions"])
    matrix: list[list[int]] = confusion_matrix(
        predictions.y, predictions.prediction, labels=[0, 1]
    ).tolist()
    return matrix


def _example_grasps(dataset: StaticDataset) -> tuple[dict[str, Tensor], str]:
    r"""Returns a stable and a slipping grasp of one object in one session, and the names of the
    object and session. These have the most grasps of both outcomes.
    """
    # Scaled by channel, so that the electrodes of a picture keep their proportions.
    data = fit_transform(Compose([CommonMode(), ZScore(per="channel")]), dataset)
    object_session = data.group * len(dataset.session_names) + data.session
    counts = torch.stack(
        [
            torch.bincount(object_session[data.y == label], minlength=int(object_session.max()) + 1)
            for label in (0, 1)
        ]
    )
    selected = int(counts.min(dim=0).values.argmax())
    grasps = {}
    for label, name in enumerate(dataset.class_names):
        x = data.x[(object_session == selected) & (data.y == label)]
        grasps[name] = x[(x - x.mean(0)).square().sum((1, 2)).argmin()]
    group, session = divmod(selected, len(dataset.session_names))
    session_name = dataset.session_names[session].replace("_", " ")
    return grasps, f"object '{dataset.group_names[group]}', {session_name}"
