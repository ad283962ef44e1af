r"""The samples of a comparison: of a file, a folder or a class, as they are, or windows of
frames and whole trials cut from them.
"""

import copy
import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset, Windows
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.experiments._building import argument_names, find_class
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.transforms import Tare

_DATASETS = "torch_geometric_tactile.datasets"
_PITCH = 0.005
_IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
_WINDOWS = "torch_geometric_tactile.data.Windows"
_TRIALS = "torch_geometric_tactile.data.Trials"
_RESAMPLE = "torch_geometric_tactile.transforms.Resample"
_TARED = f"{__name__}.tared_frames"
_STRIDED = f"{__name__}.strided_frames"


@dataclass(frozen=True)
class FrameCut:
    r"""How samples of several frames are cut from the frames of a data set: windows, or whole
    trials.

    Examples:
        >>> frames = DataSource("torch_geometric_tactile.datasets.BiGS", {"root": "bigs"})
        >>> windows = FrameCut(window=20, hop=5).cut(frames)
        >>> windows.arguments["length"], windows.arguments["hop"]
        (20, 5)
    """

    window: int | None = None
    hop: int | None = None
    horizon: int | None = None
    trials: int | None = None

    def __post_init__(self) -> None:
        if self.window is None:
            for name, number in (("hop", self.hop), ("horizon", self.horizon)):
                if number is not None:
                    raise ArgumentError(
                        Argument(name),
                        " must come with ",
                        Argument("window"),
                        f", the number of frames of a window (got {number} without)",
                    )
            if self.trials is None:
                raise ArgumentError(
                    *("one of ", Argument("window"), " and ", Argument("trials")),
                    " must be given (got none)",
                )
        elif self.trials is not None:
            raise ArgumentError(
                *("only one of ", Argument("window"), " and ", Argument("trials")),
                f" may be given (got {self.window} and {self.trials})",
            )
        for name, least in (("window", 2), ("hop", 1), ("horizon", 1), ("trials", 2)):
            number = getattr(self, name)
            if number is not None and number < least:
                raise ArgumentError(Argument(name), f" must be at least {least} (got {number})")

    def cut(self, frames: DataSource) -> DataSource:
        r"""Returns the samples as a data source. What only chose among the frames, such as a
        stride, chooses those that windows are cut from.
        """
        inner = {
            "class_path": frames.class_path,
            "init_args": {**frames.arguments, **frames.selection},
        }
        arguments: dict[str, Any] = {"dataset": inner}
        if self.window is None:
            resample = {"class_path": _RESAMPLE, "init_args": {"num": self.trials}}
            arguments |= {"ragged": "pad", "pre_transform": resample}
        else:
            arguments |= {"length": self.window, "hop": self.hop or self.window}
        if self.horizon is not None:
            arguments |= {"label": "ahead", "horizon": self.horizon}
        path = _TRIALS if self.window is None else _WINDOWS
        return replace(
            frames, class_path=path, arguments=arguments, selection={}, caption="", fingerprint=""
        )


def data_source(
    data: PathLike,
    *,
    layout: str | None = None,
    grid: str | None = None,
    task: str | None = None,
    time_axis: int | None = None,
    arguments: Mapping[str, Any] | None = None,
    stride: int | None = None,
    resample: float | None = None,
    cut: FrameCut | None = None,
) -> DataSource:
    r"""Returns the data set that a text stands for."""
    if time_axis is not None and cut is not None:
        raise ArgumentError(
            Argument("time_axis"),
            f" must be left out where windows or trials are cut (got {time_axis})",
        )
    frames = _frames(data, layout, grid, task, time_axis, arguments)
    if resample is not None:
        if "resample" not in (argument_names(frames.class_path) or ["resample"]):
            raise ArgumentError(
                Argument("resample"),
                f" must be left out for {frames.class_path.rpartition('.')[2]}, whose "
                f"frames are not read from recordings (got {resample:g})",
            )
        frames = replace(frames, arguments={**frames.arguments, "resample": resample})
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
            raise ArgumentError(
                Argument("data"), f" must be an npz file, a folder or a class (got '{text}')"
            )
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
        raise ArgumentError(
            Argument("grid"), f" must be rows and columns such as 28x50 (got '{text}')"
        )
    size = {"rows": int(rows), "cols": int(cols), "pitch": _PITCH}
    return {"class_path": "torch_geometric_tactile.sensors.grid", "init_args": size}


def of_frames(
    source: DataSource, tare: Mapping[str, Any] | None, selection: Mapping[str, Any] | None
) -> tuple[DataSource, dict[str, Any] | None, Mapping[str, Any] | None]:
    r"""Returns a source, and what is left to be tared and selected of its samples: of samples that
    are cut from frames nothing, since both is done to the frames. A stride makes other windows.
    """
    found = find_class(source.class_path)
    if not isinstance(found, type) or not issubclass(found, FrameView):
        return source, None if tare is None else dict(tare), selection
    source = source.with_arguments(selection or {})
    return source if tare is None else _without_rest(source, tare), None, None


def _without_rest(source: DataSource, tare: Mapping[str, Any]) -> DataSource:
    r"""Returns the windows of a source with the rest reading of each trial subtracted from its
    frames, before windows are cut.
    """
    given = dict(tare)
    if given.pop("key", "session") != "trial":
        raise ArgumentError(
            Argument("tare"),
            f" must be of each trial, key='trial', for samples of several frames (got {tare})",
        )
    inner = source.arguments.get("dataset")
    if not isinstance(inner, Mapping) or "class_path" not in inner:
        raise ArgumentError(
            Argument("tare"),
            " must be left out for samples of several frames, unless the source has the "
            "'dataset' that they are cut from: subtract rest readings before cutting (got "
            f"{source.class_path.rpartition('.')[2]})",
        )
    frames = {"class_path": _TARED, "init_args": {"dataset": inner, **given}}
    return replace(source, arguments={**source.arguments, "dataset": frames}, fingerprint="")


def tared_frames(
    dataset: StaticDataset, first: int | None = None, seconds: float | None = None
) -> StaticDataset:
    r"""Returns a data set whose frames have the rest reading of their trial subtracted, which is
    measured on that trial alone.
    """
    tare = Tare("trial", first=first, seconds=seconds).fit(dataset, dataset.transform)
    out = copy.copy(dataset)
    out.transform = tare if dataset.transform is None else Compose([dataset.transform, tare])
    return out


def with_stride(frames: DataSource, stride: int) -> DataSource:
    r"""Returns every so manieth frame of each trial of a source: by an argument of its class, if it
    has one of this name.
    """
    names = argument_names(frames.class_path)
    if names is None or "stride" in names:
        return replace(frames, selection={**frames.selection, "stride": stride})
    inner = {"class_path": frames.class_path, "init_args": frames.arguments}
    return replace(frames, class_path=_STRIDED, arguments={"dataset": inner, "stride": stride})


def strided_frames(dataset: StaticDataset, stride: int) -> StaticDataset:
    r"""Returns every so manieth sample of each trial of a data set, in their order."""
    trial = dataset.column("trial")
    trial = torch.zeros(len(dataset)) if trial is None else trial
    order = trial.argsort(stable=True)
    _, counts = trial[order].unique_consecutive(return_counts=True)
    place = torch.arange(len(order)) - (counts.cumsum(0) - counts).repeat_interleave(counts)
    return dataset[order[place % stride == 0].sort().values]


def describe_left_out(dataset: StaticDataset) -> str:
    r"""Returns in words what was left out when samples were cut; an empty text if nothing was."""
    parts = []
    if isinstance(dataset, FrameView) and dataset.too_short:
        parts.append(f"trials shorter than a window: {len(dataset.too_short)}")
    if isinstance(dataset, Windows) and dataset.num_beyond:
        parts.append(f"windows whose label is beyond their trial: {dataset.num_beyond}")
    return f"Left out: {'; '.join(parts)}." if parts else ""


def describe_cut(source: DataSource) -> str:
    r"""Returns in words what a sample is; an empty text for single frames.

    Examples:
        >>> frames = DataSource("torch_geometric_tactile.datasets.BiGS", {"root": "bigs"})
        >>> describe_cut(FrameCut(trials=60).cut(frames))
        'A sample is a whole trial, resampled to 60 frames.'
    """
    given = source.arguments
    if source.class_path == _WINDOWS:
        length, hop, ahead = given["length"], given.get("hop", 1), given.get("horizon")
        label = f"the frame {ahead} after its last" if ahead else "its last frame"
        every = "one after the other" if hop == length else f"one every {hop}"
        text = f"A sample is a window of {length} frames, {every}, with the label of {label}"
    elif source.class_path == _TRIALS:
        once = given.get("pre_transform")
        is_known = isinstance(once, Mapping) and once.get("class_path") == _RESAMPLE
        number = once["init_args"]["num"] if is_known and once is not None else None
        text = "A sample is a whole trial" + (f", resampled to {number} frames" if number else "")
    else:
        return ""
    inner = given.get("dataset")
    if isinstance(inner, Mapping) and inner.get("class_path") == _TARED:
        text += "; rest readings of each trial were subtracted before"
    return f"{text}."
