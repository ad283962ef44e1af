r"""The page of the demo: models of grasp stability, and what each protocol says of them."""

import json
import math
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import torch
import torch_geometric
from sklearn.metrics import confusion_matrix, roc_auc_score, roc_curve
from tabulate import tabulate
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile import __version__
from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._scores import RULE
from torch_geometric_tactile.experiments.comparison import Summary
from torch_geometric_tactile.experiments.differences import Difference
from torch_geometric_tactile.experiments.plan import Plan
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.experiments.tables import cell_config
from torch_geometric_tactile.papers._grasp_numbers import (
    Judged,
    grasp_differences,
    grasp_predictions,
    grasp_records,
    grasp_summary,
)
from torch_geometric_tactile.reports.html import ReportPicture, ReportTable, write_report
from torch_geometric_tactile.sensors import layout_sectors
from torch_geometric_tactile.transforms import CommonMode, ZScore, fit_transform
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_grasps,
    plot_protocols,
    plot_roc,
    save_figure,
)

CHECKPOINT = "grasp_common_mode.ckpt"
MAIN = "net_common_mode"
_MAIN = "TaxelNet"
_READINGS = "common mode, middle + thumb"
_TWIN = "TaxelNet without edges"
_CHANCE = "Majority"
_UNSEEN = "unseen objects"
_FINGERS = ("index finger", "middle finger", "thumb")
_Scores = dict[str, dict[str, dict[str, dict[str, Summary]]]]


class GraspReport(NamedTuple):
    r"""What was written: the content of :obj:`metrics.json`, and what of it a terminal shows."""

    content: dict[str, Any]
    text: str


def write_grasp_report(
    run: PlanRun, main: dict[str, Any], out: PathLike, seconds: float
) -> GraspReport:
    r"""Writes :obj:`report.html`, its pictures and :obj:`metrics.json`."""
    need(not run.missing, f"'run' must be complete (got {run.missing} runs missing)")
    out, plan = Path(out), run.plan
    unseen = next(e for e in plan.experiments if e.protocol_name == _UNSEEN)
    train, test = unseen.data.parts(unseen.protocol, unseen.seed, unseen.fold)
    predictions = grasp_predictions(run)
    records = list(grasp_records(predictions, run))
    summary = grasp_summary(records)
    edges = grasp_differences(run, _READINGS, _MAIN, _TWIN)
    pictures = _pictures(train, predictions, _means(summary, plan), out)
    cell = next(cell for cell in plan.table.cells if cell.experiment == MAIN)
    metrics = Predictions.from_dict(main["predictions"]).metrics()
    content = {
        "data": {
            "source": plan.data.caption,
            "generated": plan.data.kind == "generated",
            "train_samples": len(train),
            "train_objects": _count_groups(train),
            "test_samples": len(test),
            "test_objects": _count_groups(test),
        },
        "machine": _machine(),
        "seeds": list(range(plan.seeds)),
        "folds": max(entry.protocol.folds or 1 for entry in plan.protocols),
        "epochs": _epochs(run),
        "seconds": round(seconds, 1),
        "checkpoint": {
            "file": CHECKPOINT,
            "config": cell_config(cell),
            "seed": 0,
            "model": cell.row,
            "readings": cell.column,
            **{name: metrics[name] for name in ("accuracy", "f1", "f1_positive")},
        },
        "edges": {
            protocol: {
                "accuracy": gain.mean,
                "error": gain.error if math.isfinite(gain.error) else None,
                "verdict": gain.verdict,
            }
            for protocol, gain in edges.items()
        },
        "results": records,
    }
    verdict = _verdict(summary, edges, plan.data.kind == "generated")
    with atomic_path(out / "metrics.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
    write_report(
        out / "report.html",
        title="Grasp stability from touch",
        verdict=verdict,
        notice=plan.data.caption,
        is_warning=plan.data.kind == "generated",
        facts=[*_facts(content), ("Edges", _edges(edges))],
        tables=[
            _table(summary, "accuracy", "Accuracy in %", _CAPTION.format(seeds=plan.seeds)),
            _table(summary, "f1_positive", "F1 score of slip in %", ""),
        ],
        pictures=pictures,
    )
    text = f"{_terminal_table(summary, run)}\n\nEdges: {_edges(edges)}\n\n{verdict}"
    return GraspReport(content, text)


def _epochs(run: PlanRun) -> int | str:
    # The number that was asked for, where all have it instead of their configurations' own.
    configured = {
        cell.experiment: cell_config(cell)["trainer"]["max_epochs"]
        for cell in run.plan.table.cells
        if cell.config is not None
    }
    asked = {e.epochs for e in run.plan.experiments if e.name in configured}
    own = all(e.epochs == configured.get(e.name, e.epochs) for e in run.plan.experiments)
    return "as configured" if own else asked.pop()


def _table(summary: _Scores, metric: str, title: str, caption: str) -> ReportTable:
    protocols = list(summary[_MAIN])
    rows = []
    for model, readings, scores in _lines(summary):
        mark = "*" if (model, readings) == (_MAIN, _READINGS) else ""
        cells = [_percent(scores[protocol][metric]) for protocol in protocols]
        rows.append([f"{mark}{model}", readings, *cells])
    return ReportTable(title, caption, ["model", "readings", *protocols], rows)


def _lines(summary: _Scores) -> Iterator[tuple[str, str, dict[str, dict[str, Summary]]]]:
    # Model, readings, and scores by protocol and metric.
    for model, protocols in summary.items():
        for readings in next(iter(protocols.values())):
            yield model, readings, {name: cells[readings] for name, cells in protocols.items()}


def _percent(score: Summary) -> str:
    spread = "" if math.isnan(score.sd) else f" ± {100 * score.sd:.1f}"
    return f"{100 * score.mean:.1f}{spread}"


def _terminal_table(summary: _Scores, run: PlanRun) -> str:
    # Without palm poses and F1 scores, to fit beside one another.
    protocols = [entry.name for entry in run.plan.protocols]
    rows = [
        [
            model.replace(" without", "\nwithout"),
            readings.replace(", ", ",\n"),
            *(_percent(scores[protocol]["accuracy"]) for protocol in protocols),
        ]
        for model, readings, scores in _lines(summary)
    ]
    header = ["model", "readings", *(protocol.replace(" ", "\n") for protocol in protocols)]
    return "Accuracy in %\n" + tabulate(rows, header, tablefmt="simple", disable_numparse=True)


def _edges(edges: dict[str, Difference]) -> str:
    gains = ", ".join(
        f"{protocol} {100 * gain.mean:+.1f} ± {100 * gain.error:.1f}"
        for protocol, gain in edges.items()
    )
    verdicts: dict[str, list[str]] = {}
    for protocol, gain in edges.items():
        verdicts.setdefault(gain.verdict, []).append(protocol)
    said = "; ".join(f"{verdict}: {', '.join(names)}" for verdict, names in verdicts.items())
    return (
        f"accuracy of {_MAIN} with edges less that without, ± standard error, in points: {gains}. "
        f"{said[:1].upper()}{said[1:]}. {RULE}"
    )


def _verdict(summary: _Scores, edges: dict[str, Difference], is_generated: bool) -> str:
    def accuracy(model: str, protocol: str, readings: str) -> float:
        return 100 * summary[model][protocol][readings]["accuracy"].mean

    main, svm = (accuracy(model, _UNSEEN, _READINGS) for model in (_MAIN, "SVM"))
    raw, folds = (accuracy("SVM", protocol, "raw") for protocol in (_UNSEEN, "random folds"))
    gain = edges[_UNSEEN]
    lesson = ": judge a model on unseen objects" if raw < folds and not is_generated else ""
    help_of_edges = f", and edges change this by {100 * gain.mean:+.1f} points, {gain.verdict}"
    texts = [
        f"From the common mode of middle finger and thumb, {_MAIN} tells whether an unseen object "
        f"will slip in {main:.1f} % of the grasps; an SVM on the same readings does so in "
        f"{svm:.1f} %{'' if is_generated else help_of_edges}.",
        f"From raw readings the SVM has {folds:.1f} % on random folds, but {raw:.1f} % on unseen "
        f"objects{lesson}.",
    ]
    if is_generated:
        texts.insert(0, "The data is generated: the numbers show that everything runs, no more.")
    return " ".join(texts)


_CAPTION = (
    "Mean ± standard deviation over {seeds} seed(s). The first three protocols are within the "
    "training set; 'objects and sessions' leaves out objects and one of the three recording "
    "sessions (palm poses) together. 'Unseen objects' is the official test, and the palm poses are "
    "its parts. Common mode: each finger's mean over its electrodes is subtracted within the one "
    "reading, in raw counts, before the training part scales it; this needs nothing but the "
    "reading. Session: scaled by mean and deviation of the recording session, without labels; the "
    "test sessions are measured on the test readings themselves, which a robot has only after some "
    "grasps. Raw: scaled by the training part only. The test recordings have another sensor "
    "offset, so that raw accuracy on folds, even with objects left out, promises more than the "
    "test keeps."
)
_ROC = (
    (_MAIN, _READINGS),
    (_TWIN, _READINGS),
    ("SVM", _READINGS),
    ("LSTM", _READINGS),
    ("GCN-DF", _READINGS),
    ("SVM", "raw"),
    ("GCN-DF", "raw"),
)


def _means(summary: _Scores, plan: Plan) -> dict[str, dict[str, dict[str, tuple[float, float]]]]:
    # Without palm poses, to fit beside one another.
    return {
        model: {
            entry.name: {
                readings: (scores["accuracy"].mean, scores["accuracy"].sd)
                for readings, scores in protocols[entry.name].items()
            }
            for entry in plan.protocols
        }
        for model, protocols in summary.items()
        if model != _CHANCE
    }


def _pictures(
    train: StaticDataset,
    predictions: dict[Judged, Predictions],
    means: dict[str, dict[str, dict[str, tuple[float, float]]]],
    out: Path,
) -> list[ReportPicture]:
    judged = predictions[Judged(_MAIN, _UNSEEN, _READINGS, 0)]
    curves = {}
    for model, readings in _ROC:
        of = predictions[Judged(model, _UNSEEN, readings, 0)]
        false, true, _ = roc_curve(of.y, of.positive_score)
        name = f"{model}, {'raw' if readings == 'raw' else 'common mode'}"
        curves[name] = (false, true, float(roc_auc_score(of.y, of.positive_score)))
    grasps, place = _example_grasps(train)
    figures = {
        "protocols": (
            plot_protocols(means, chance=0.5),
            "Accuracy by protocol",
            "Means over seeds, in %; bars are standard deviations over seeds, the dashed line is "
            "at 50 %.",
        ),
        "grasps": (
            plot_grasps(
                train.layout,
                grasps,
                finger_names=list(_FINGERS),
                edge_index=layout_sectors(train.layout).edge_index,
            ),
            "Electrodes of the three fingers",
            f"A stable and a slipping grasp of one object in one session ({place}): the grasp of "
            "each outcome that is nearest to the mean of its kind. Readings less the common mode "
            f"of each finger, with one scale for its electrodes. Lines are the edges of {_MAIN}, "
            "which sees middle finger and thumb.",
        ),
        "confusion": (
            plot_confusion(
                confusion_matrix(judged.y, judged.prediction, labels=[0, 1]),
                train.class_names,
                f"Unseen objects, {_MAIN}, seed 0, {_READINGS}",
            ),
            "Confusion matrix",
            "Rows are what happened, columns what the model said.",
        ),
        "roc": (
            plot_roc(curves, "Unseen objects, seed 0; common mode: middle + thumb"),
            "Receiver operating characteristic",
            "Positive means slip.",
        ),
    }
    pictures = []
    for name, (figure, title, caption) in figures.items():
        save_figure(figure, out / f"{name}.png")
        pictures.append(ReportPicture(out / f"{name}.png", title, caption))
    return pictures


def _example_grasps(dataset: StaticDataset) -> tuple[dict[str, Tensor], str]:
    r"""Returns a stable and a slipping grasp of the object and session that has most of both."""
    data = fit_transform(Compose([CommonMode(), ZScore(per="channel")]), dataset)
    place = data.group * len(dataset.session_names) + data.session
    counts = torch.stack(
        [torch.bincount(place[data.y == label], minlength=int(place.max()) + 1) for label in (0, 1)]
    )
    best = int(counts.min(dim=0).values.argmax())
    grasps = {}
    for label, name in enumerate(dataset.class_names):
        x = data.x[(place == best) & (data.y == label)]
        grasps[name] = x[(x - x.mean(0)).square().sum((1, 2)).argmin()]
    group, session = divmod(best, len(dataset.session_names))
    session_name = dataset.session_names[session].replace("_", " ")
    return grasps, f"object '{dataset.group_names[group]}', {session_name}"


def _count_groups(dataset: StaticDataset) -> int:
    group = dataset.column("group")
    return 0 if group is None else len(group.unique())


def _machine() -> dict[str, Any]:
    return {
        "processor": platform.processor() or platform.machine(),
        "system": platform.system(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "torch_geometric": torch_geometric.__version__,
        "torch_geometric_tactile": __version__,
    }


def _facts(content: dict[str, Any]) -> list[tuple[str, str]]:
    data, machine, checkpoint = content["data"], content["machine"], content["checkpoint"]
    return [
        (
            "Data",
            f"{data['train_samples']:,} grasps of {data['train_objects']} objects to train, "
            f"{data['test_samples']:,} grasps of {data['test_objects']} unseen objects to test",
        ),
        ("Task", "will the object slip, from one reading of 3 fingers x 24 electrodes"),
        ("Seeds", ", ".join(map(str, content["seeds"]))),
        ("Folds", f"{content['folds']}, drawn anew for each seed; pooled before they are scored"),
        ("Epochs", str(content["epochs"])),
        (
            "Checkpoint",
            f"{checkpoint['file']}: {checkpoint['model']}, seed 0, {checkpoint['readings']}; "
            f"accuracy on unseen objects {checkpoint['accuracy']:.3f}",
        ),
        ("Machine", ", ".join(f"{key} {value}" for key, value in machine.items())),
        ("Time", f"{content['seconds']:.0f} s"),
    ]
