r"""The page of the demo: models of grasp stability, and what each protocol says of them."""

import json
import math
import platform
from pathlib import Path
from typing import Any, NamedTuple

import torch
import torch_geometric
from sklearn.metrics import confusion_matrix, roc_auc_score, roc_curve
from tabulate import tabulate
from torch import Tensor

from torch_geometric_tactile import __version__
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments.grasp_numbers import (
    Judged,
    Score,
    grasp_judgements,
    grasp_records,
    grasp_summary,
)
from torch_geometric_tactile.experiments.judgement import Judgement
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.experiments.tables import cell_config
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.reports.html import ReportPicture, ReportTable, write_report
from torch_geometric_tactile.transforms import SessionZScore
from torch_geometric_tactile.typing import PathLike
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_grasps,
    plot_protocols,
    plot_roc,
    save_figure,
)

CHECKPOINT = "grasp_gcn_df.ckpt"
MAIN = "gcn_df_session"
_MAIN = "GCN-DF"
_UNSEEN = "unseen objects"
_FINGERS = ("index finger", "middle finger", "thumb")
_SCALINGS = {"session": "scaled by session", "raw": "raw"}
_Summary = dict[str, dict[str, dict[str, dict[str, Score]]]]


class GraspReport(NamedTuple):
    r"""What was written: the content of :obj:`metrics.json`, and the table as text."""

    content: dict[str, Any]
    text: str


def write_grasp_report(
    run: PlanRun, main: dict[str, Any], out: PathLike, seconds: float
) -> GraspReport:
    r"""Writes :obj:`report.html`, its pictures and :obj:`metrics.json`.

    Args:
        run (PlanRun): A run of the table :obj:`bts3` of which nothing is missing.
        main (dict): The result of the experiment :obj:`MAIN` on the unseen objects, seed 0, whose
            checkpoint is :obj:`CHECKPOINT` in the same folder.
        out (str or PathLike): The folder.
        seconds (float): How long everything took.

    Raises:
        ImportError: If matplotlib or jinja2 is missing.
        ValueError: If runs are missing.
    """
    if run.missing:
        raise ValueError(f"'run' must be complete (got {run.missing} runs missing)")
    out, plan = Path(out), run.plan
    unseen = next(e for e in plan.experiments if e.protocol_name == _UNSEEN)
    train, test = unseen.data.parts(unseen.protocol, unseen.seed, unseen.fold)
    judgements = grasp_judgements(run)
    records = list(grasp_records(judgements, run))
    summary = grasp_summary(records)
    table = _table(summary, plan.seeds)
    num_neighbours = plan.data.arguments["pre_transform"]["init_args"]["k"]
    pictures = _pictures(train, num_neighbours, judgements, summary, out)
    cell = next(cell for cell in plan.table.cells if cell.experiment == MAIN)
    metrics = Judgement.from_dict(main["predictions"]).metrics()
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
            "scaling": cell.column,
            **{name: metrics[name] for name in ("accuracy", "f1", "f1_positive")},
        },
        "results": records,
    }
    with atomic_path(out / "metrics.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
    write_report(
        out / "report.html",
        title="Grasp stability from touch",
        notice=plan.data.caption,
        facts=_facts(content),
        tables=[table],
        pictures=pictures,
    )
    return GraspReport(content, _terminal_table(table))


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


def _table(summary: _Summary, seeds: int) -> ReportTable:
    protocols = list(summary[_MAIN])
    rows = []
    for model, cells in summary.items():
        for scaling in _SCALINGS:
            row = [f"*{model}" if model == _MAIN else model, scaling]
            for protocol in protocols:
                scores = cells[protocol][scaling]
                row.append(f"{_percent(scores['accuracy'])} / {_percent(scores['f1_positive'])}")
            rows.append(row)
    return ReportTable(
        title="Accuracy / F1 score of slip, in %",
        caption=_CAPTION.format(seeds=seeds),
        header=["model", "scaling", *protocols],
        rows=rows,
    )


def _percent(score: Score) -> str:
    spread = "" if math.isnan(score.spread) else f" ± {100 * score.spread:.1f}"
    return f"{100 * score.mean:.1f}{spread}"


def _terminal_table(table: ReportTable) -> str:
    rows = [[cell.lstrip("*").replace(" / ", "\n") for cell in row] for row in table.rows]
    header = [name.replace(" ", "\n") for name in table.header]
    body = tabulate(rows, header, tablefmt="simple", disable_numparse=True)
    return f"{table.title.replace(' / ', ', below it ')}\n{body}"


_CAPTION = (
    "Mean ± standard deviation over {seeds} seed(s). Random folds and left-out objects are within "
    "the training set; 'unseen objects' is the official test, and the palm poses are its parts. "
    "Scaling 'session': by mean and deviation of the recording session, without labels; the test "
    "sessions are measured on the test readings themselves, which a robot has only after some "
    "grasps. Scaling 'raw': by the training part only. The test recordings have another sensor "
    "offset, so that raw accuracy on folds, even with objects left out, promises more than the "
    "test keeps."
)


def _pictures(
    train: StaticDataset,
    num_neighbours: int,
    judgements: dict[Judged, Judgement],
    summary: _Summary,
    out: Path,
) -> list[ReportPicture]:
    main = Judged(_MAIN, _UNSEEN, "session", 0)
    judged = judgements[main]
    curves = {
        model: (
            *roc_curve(other.y, other.positive_score)[:2],
            float(roc_auc_score(other.y, other.positive_score)),
        )
        for model in summary
        if model != "Majority"
        for other in [judgements[main._replace(model=model)]]
    }
    means = {
        model: {
            protocol: {
                name: (cells[scaling]["accuracy"].mean, cells[scaling]["accuracy"].spread)
                for scaling, name in reversed(_SCALINGS.items())
            }
            for protocol, cells in protocols.items()
        }
        for model, protocols in summary.items()
    }
    grasps, place = _example_grasps(train)
    figures = {
        "grasps": (
            plot_grasps(
                train.layout,
                grasps,
                finger_names=list(_FINGERS),
                edge_index=train[0].edge_index,
            ),
            "Electrodes of the three fingers",
            f"A stable and a slipping grasp of one object in one session ({place}): the grasp of "
            "each outcome that is nearest to the mean of its kind. Lines are the graph, "
            f"k = {num_neighbours}. Readings scaled by session.",
        ),
        "protocols": (
            plot_protocols(means, chance=0.5),
            "Accuracy by protocol",
            "Means over seeds; bars are standard deviations.",
        ),
        "confusion": (
            plot_confusion(
                confusion_matrix(judged.y, judged.prediction, labels=[0, 1]),
                train.class_names,
                "GCN-DF, unseen objects, scaled by session, seed 0",
            ),
            "Confusion matrix",
            "Rows are what happened, columns what the model said.",
        ),
        "roc": (
            plot_roc(curves, "Unseen objects, scaled by session, seed 0"),
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
    data = SessionZScore().fit(dataset)(dataset.data)
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
            f"{data['train_samples']} grasps to train, {data['test_samples']} unseen objects'",
        ),
        ("Task", "will the object slip, from one reading of 3 fingers x 24 electrodes"),
        ("Seeds", ", ".join(map(str, content["seeds"]))),
        ("Folds", f"{content['folds']}, drawn anew for each seed; pooled before they are scored"),
        ("Epochs", str(content["epochs"])),
        (
            "Checkpoint",
            f"{checkpoint['file']}: GCN-DF, seed 0, scaled by session; accuracy on unseen objects "
            f"{checkpoint['accuracy']:.3f}",
        ),
        ("Machine", ", ".join(f"{key} {value}" for key, value in machine.items())),
        ("Time", f"{content['seconds']:.0f} s"),
    ]
