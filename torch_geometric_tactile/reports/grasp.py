r"""The main job: from data to a judged model and a report."""

import json
import math
import platform
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import torch_geometric
from sklearn.metrics import confusion_matrix, roc_auc_score, roc_curve
from tabulate import tabulate
from torch import Tensor

from torch_geometric_tactile import __version__
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.datasets import BioTacSP, FakeTactileDataset, default_root
from torch_geometric_tactile.experiments import evaluation
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.reports.html import ReportPicture, ReportTable, write_report
from torch_geometric_tactile.training.checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training.config import load_config
from torch_geometric_tactile.transforms import KNNGraph, SessionZScore
from torch_geometric_tactile.typing import PathLike
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_grasps,
    plot_protocols,
    plot_roc,
    save_figure,
)

_MAIN = "GCN-DF"
_CHECKPOINT = "grasp_gcn_df.ckpt"
_FINGERS = ("index finger", "middle finger", "thumb")
_SCALING_NAMES = {"raw": "raw", "session": "scaled by session"}


class _Data(NamedTuple):
    train: StaticDataset
    test: StaticDataset
    notice: str
    generated: bool


def main(
    root: PathLike | None = None,
    out: PathLike = "report",
    seeds: int = 3,
    folds: int = 5,
    epochs: int | None = None,
    num_processes: int = 1,
    generated: bool = False,
) -> dict[str, Any]:
    r"""Trains and judges all models and writes the report folder.

    Args:
        root (str or PathLike, optional): Folder of the data; downloaded if left out, generated if
            it cannot be downloaded.
        out (str or PathLike): Folder of the report.
        seeds (int): Number of seeds.
        folds (int): Number of folds.
        epochs (int, optional): Epochs, instead of those of the configurations.
        num_processes (int): How many models are trained at a time.
        generated (bool): Whether to generate the data in any case.

    Returns:
        dict: What :obj:`metrics.json` holds.

    Raises:
        ValueError: If the data is damaged or :obj:`folds` is below two.
    """
    if folds < 2:
        raise ValueError(f"'folds' must be at least 2 (got {folds})")
    start = time.perf_counter()
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    data = open_data(root, generated)
    print(data.notice)  # noqa: T201 - the first line that the user reads
    jobs = evaluation.make_jobs(list(evaluation.MODELS), seeds, folds)
    results = evaluation.run_jobs(jobs, data.train, data.test, folds, epochs, num_processes)
    pooled = evaluation.pool_folds(results)
    records = list(evaluation.summarize(pooled, data.train.session_names))
    checkpoint = _train_main(data, out, epochs)
    summary = _summary(records)
    table = _table(summary, seeds)
    print(f"\n{_terminal_table(table)}")  # noqa: T201
    pictures = _pictures(data, pooled, summary, out)
    content = {
        "data": {
            "source": data.notice,
            "generated": data.generated,
            "train_samples": len(data.train),
            "train_objects": _count_groups(data.train),
            "test_samples": len(data.test),
            "test_objects": _count_groups(data.test),
        },
        "machine": _machine(),
        "seeds": list(range(seeds)),
        "folds": folds,
        "epochs": epochs or "as configured",
        "seconds": round(time.perf_counter() - start, 1),
        "checkpoint": checkpoint,
        "results": records,
    }
    with atomic_path(out / "metrics.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
    write_report(
        out / "report.html",
        title="Grasp stability from touch",
        notice=data.notice,
        facts=_facts(content),
        tables=[table],
        pictures=pictures,
    )
    print(f"\nReport: {out / 'report.html'} ({content['seconds']:.0f} s)")  # noqa: T201
    return content


def open_data(root: PathLike | None, generated: bool = False) -> _Data:
    r"""Finds the data set, downloads it, or generates a stand-in.

    Args:
        root (str or PathLike, optional): Folder of the data.
        generated (bool): Whether to generate it in any case.
    """
    graph = KNNGraph(k=_num_neighbours())
    reason = "generated data was asked for"
    if not generated:
        home = default_root("BioTacSP") if root is None else Path(root).expanduser()
        try:
            if root is not None:
                home = _find(home)
            train = BioTacSP(home, "train", pre_transform=graph)
            notice = (
                "Data: real. BioTac SP stability set v2 (BTS3), "
                "github.com/3dperceptionlab/biotacsp-stability-set-v2, checksums verified."
            )
            return _Data(train, BioTacSP(home, "test", pre_transform=graph), notice, False)
        except ConnectionError as error:
            reason = str(error)
    notice = (
        "Data: GENERATED, not measured (FakeTactileDataset, seed 0); no number below says anything "
        f"about a real hand. Why not real data: {reason}."
    )
    train = FakeTactileDataset(2000, "train", num_objects=20, pre_transform=graph)
    test = FakeTactileDataset(600, "test", num_objects=20, pre_transform=graph)
    return _Data(train, test, notice, True)


def _num_neighbours() -> int:
    dataset = load_config(str(evaluation.MODELS[_MAIN]))["data"]["dataset"]
    return int(dataset["init_args"]["pre_transform"]["init_args"]["k"])


def _find(folder: Path) -> Path:
    r"""Returns the root of the data set; loose files are copied out of a folder that may not be
    ours to write to.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"'--root' must be a folder (got '{folder}')")
    for home in (folder, folder / "BioTacSP"):
        if (home / "raw").is_dir():
            return home
    home = default_root("BioTacSP")
    if home.parent.resolve() == folder.resolve():  # $TACTILE_DATA itself
        BioTacSP.import_raw(folder, home)
        return home
    return home if BioTacSP.import_raw(folder, home) else folder / "BioTacSP"


def _train_main(data: _Data, out: Path, epochs: int | None) -> dict[str, Any]:
    r"""Trains the model that is kept, with session scaling and seed 0."""
    config = load_config(str(evaluation.MODELS[_MAIN]))
    module = evaluation.data_module(config, data.train, data.test, "session")
    classifier = evaluation.train_classifier(
        config,
        module,
        seed=0,
        epochs=epochs,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        plugins=[AtomicCheckpointIO()],
    )
    classifier.trainer.save_checkpoint(out / _CHECKPOINT, weights_only=False)
    metrics = evaluation.judge(classifier, module).metrics()
    return {"file": _CHECKPOINT, "config": config, "seed": 0, "scaling": "session", **metrics}


def _summary(records: list[dict[str, Any]]) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    r"""Returns mean and standard deviation over seeds by model, protocol and scaling."""
    summary: dict[str, dict[str, dict[str, dict[str, Any]]]] = {}
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for record in records:
        key = (record["model"], record["protocol"], record["scaling"])
        groups.setdefault(key, []).append(record)
    for (model, protocol, scaling), group in groups.items():
        cell = {}
        for name in ("accuracy", "f1"):
            values = np.array([record[name] for record in group])
            # One seed has no deviation, which is not a deviation of zero.
            sd = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
            cell[name] = (float(values.mean()), sd)
        summary.setdefault(model, {}).setdefault(protocol, {})[scaling] = cell
    return {model: summary[model] for model in evaluation.MODELS if model in summary}


def _table(summary: dict[str, Any], seeds: int) -> ReportTable:
    protocols = list(summary[_MAIN])
    rows = []
    for model, cells in summary.items():
        for scaling in reversed(evaluation.SCALINGS):
            row = [f"*{model}" if model == _MAIN else model, scaling]
            for protocol in protocols:
                accuracy, f1 = (cells[protocol][scaling][name] for name in ("accuracy", "f1"))
                row.append(f"{_percent(*accuracy)} / {_percent(*f1)}")
            rows.append(row)
    return ReportTable(
        title="Accuracy / F1 score of slip, in %",
        caption=_CAPTION.format(seeds=seeds),
        header=["model", "scaling", *protocols],
        rows=rows,
    )


def _percent(mean: float, sd: float) -> str:
    return f"{100 * mean:.1f}" + ("" if math.isnan(sd) else f" ± {100 * sd:.1f}")


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
    data: _Data, pooled: dict[evaluation.Job, evaluation.Judgement], summary: Any, out: Path
) -> list[ReportPicture]:
    main_job = evaluation.Job(_MAIN, "unseen objects", "session", 0, 0)
    judged = pooled[main_job]
    curves = {
        model: (
            *roc_curve(other.y, other.score)[:2],
            float(roc_auc_score(other.y, other.score)),
        )
        for model in evaluation.MODELS
        if model != "Majority"
        for other in [pooled[main_job._replace(model=model)]]
    }
    means = {
        model: {
            protocol: {
                _SCALING_NAMES[scaling]: cell["accuracy"] for scaling, cell in scalings.items()
            }
            for protocol, scalings in protocols.items()
        }
        for model, protocols in summary.items()
    }
    grasps, place = _example_grasps(data.train)
    figures = {
        "grasps": (
            plot_grasps(
                data.train.layout,
                grasps,
                finger_names=list(_FINGERS),
                edge_index=data.train[0].edge_index,
            ),
            "Electrodes of the three fingers",
            f"A stable and a slipping grasp of one object in one session ({place}): the grasp of "
            "each outcome that is nearest to the mean of its kind. Lines are the graph, "
            f"k = {_num_neighbours()}. Readings scaled by session.",
        ),
        "protocols": (
            plot_protocols(means, chance=0.5),
            "Accuracy by protocol",
            "Means over seeds; bars are standard deviations.",
        ),
        "confusion": (
            plot_confusion(
                confusion_matrix(judged.y, judged.prediction, labels=[0, 1]),
                data.train.class_names,
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
