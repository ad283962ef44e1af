r"""The data of a comparison: a file of samples, a folder of recordings, or a class."""

import inspect
import logging
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments.compared_windows import FrameCut, with_stride
from torch_geometric_tactile.experiments.source import DataSource

_DATASETS = "torch_geometric_tactile.datasets"
_PITCH = 0.005
_IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


def data_source(
    data: PathLike,
    *,
    layout: str | None = None,
    grid: str | None = None,
    task: str | None = None,
    time_axis: int | None = None,
    arguments: Mapping[str, Any] | None = None,
    stride: int | None = None,
    cut: FrameCut | None = None,
) -> DataSource:
    r"""Returns the data set that a text stands for."""
    if time_axis is not None and cut is not None:
        raise ValueError(
            f"'time_axis' must be left out where windows or trials are cut (got {time_axis})"
        )
    frames = _frames(data, layout, grid, task, time_axis, arguments)
    frames = frames if stride is None else with_stride(frames, stride)
    return frames if cut is None else cut.cut(frames)


def _frames(
    data: PathLike,
    layout: str | None,
    grid: str | None,
    task: str | None,
    time_axis: int | None,
    arguments: Mapping[str, Any] | None,
) -> DataSource:
    text, path = str(data), Path(data)
    given = dict(arguments or {})
    if path.is_file() or path.suffix == ".npz":
        if path.suffix != ".npz":
            raise ValueError(f"'data' must be an npz file, a folder or a class (got '{text}')")
        own = {"layout": layout, "grid": grid, "task": task, "time_axis": time_axis}
        given |= {key: value for key, value in own.items() if value is not None}
        return DataSource(f"{_DATASETS}.SamplesFile", {"path": text, **given})
    for key, of_file in {"task": task, "time_axis": time_axis}.items():
        if of_file is not None:
            raise ValueError(
                f"'{key}' must be left out for anything but an npz file (got {of_file!r})"
            )
    if path.is_dir():
        found: Any = layout if grid is None else _grid(grid)
        if found is not None:
            given["layout"] = found
        return DataSource(f"{_DATASETS}.RecordingFrames", {"root": text, **given})
    if not _IMPORT_PATH.fullmatch(text):
        raise FileNotFoundError(
            f"'{text}' does not exist; give an npz file of samples, a folder of recordings, or the "
            "import path of a data set"
        )
    if "." not in text:
        from torch_geometric_tactile import datasets

        names = [name for name in datasets.__all__ if inspect.isclass(getattr(datasets, name))]
        if text not in names:
            raise FileNotFoundError(
                f"'{text}' is neither a file, nor a folder, nor one of our data sets: "
                f"{', '.join(names)}"
            )
        text = f"{_DATASETS}.{text}"
    for key, value in {"layout": layout, "grid": grid}.items():
        if value is not None:
            raise ValueError(f"'{key}' must be left out for a class of data (got '{value}')")
    return DataSource(text, given)


def _grid(text: str) -> dict[str, Any]:
    rows, _, cols = text.lower().partition("x")
    if not (rows.isascii() and rows.isdigit() and cols.isascii() and cols.isdigit()):
        raise ValueError(f"'grid' must be rows and columns such as 28x50 (got '{text}')")
    size = {"rows": int(rows), "cols": int(cols), "pitch": _PITCH}
    return {"class_path": "torch_geometric_tactile.sensors.grid", "init_args": size}


def predicts_numbers(dataset: StaticDataset) -> bool:
    r"""Tells whether numbers are predicted from the samples, not classes."""
    y = dataset.column("y")
    if y is None:
        raise ValueError("'data' must have 'y', a class or numbers for each sample (got none)")
    if y.dim() == 1 and not y.is_floating_point():
        return False
    if y.dim() > 1 and bool(((y == 0) | (y == 1)).all()):
        raise ValueError(
            f"'y' must be one class a sample, or numbers (got 0 and 1 for each of {y.size(1)} "
            "labels): choose one of them, or another target"
        )
    return True


@contextmanager
def said_before() -> Iterator[None]:
    r"""Silences the warnings of data that was loaded before, which need not say again what they
    leave out, as long as the context lasts.
    """
    loggers = [
        logging.getLogger(f"torch_geometric_tactile.{room}") for room in ("data", "datasets")
    ]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
