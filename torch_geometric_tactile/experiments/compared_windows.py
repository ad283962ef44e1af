r"""Data sources of comparisons: the samples of a file, folder or class, or windows and trials cut
from its frames.
"""

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset, Windows
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.experiments._building import argument_names
from torch_geometric_tactile.experiments.source import DataSource

_DATASETS = "torch_geometric_tactile.datasets"
_PITCH = 0.005  # in metres, for a grid with unknown distances
_IMPORT_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
_WINDOWS = "torch_geometric_tactile.data.Windows"
_TRIALS = "torch_geometric_tactile.data.Trials"
_RESAMPLE = "torch_geometric_tactile.transforms.Resample"


@dataclass(frozen=True)
class FrameCut:
    r"""Settings to cut the frames of a data set into samples of several frames: windows or whole
    trials.

    Args:
        window (int, optional): Number of frames per window.
        hop (int, optional): Number of frames from the start of one window to the next. Defaults to
            :obj:`window`.
        horizon (int, optional): Labels a window by the frame that follows its last frame by this
            number of frames. By default, the last frame labels the window.
        trials (int, optional): Number of frames to which whole trials are resampled.

    Raises:
        ValueError: If both or neither of :obj:`window` and :obj:`trials` are given, or a number is
            too small.

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
        for name, minimum in (("window", 2), ("hop", 1), ("horizon", 1), ("trials", 2)):
            number = getattr(self, name)
            if number is not None and number < minimum:
                raise ArgumentError(Argument(name), f" must be at least {minimum} (got {number})")

    def cut(self, frames: DataSource) -> DataSource:
        r"""Returns the windows or trials as a data source. Arguments that select frames, such as
        :obj:`stride`, are applied before cutting.
        """
        if self.window is None:
            resample = {"class_path": _RESAMPLE, "init_args": {"num": self.trials}}
            arguments: dict[str, Any] = {"ragged": "pad", "pre_transform": resample}
        else:
            arguments = {"length": self.window, "hop": self.hop or self.window}
        if self.horizon is not None:
            arguments |= {"label": "ahead", "horizon": self.horizon}
        return DataSource(
            _TRIALS if self.window is None else _WINDOWS,
            arguments,
            kind=frames.kind,
            frames=replace(
                frames,
                arguments={**frames.arguments, **frames.selection},
                selection={},
                kind="",
                caption="",
                fingerprint="",
            ),
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
    r"""Returns the data source of a file, a folder of recordings, a data set's name or an import
    path.

    Args:
        data (str or PathLike): An npz file of samples, a folder of recordings, the name of a class
            of :mod:`torch_geometric_tactile.datasets`, or an import path.
        layout (str, optional): The layout of a file or of recordings.
        grid (str, optional): Rows and columns of a grid in place of a layout, such as
            :obj:`"28x50"`.
        task (str, optional): The task of a file.
        time_axis (int, optional): The time axis of the readings in a file.
        arguments (Mapping, optional): Further arguments of the class.
        stride (int, optional): Keeps every :obj:`stride`-th frame of each trial.
        resample (float, optional): Frame rate in hertz to which recordings are resampled.
        cut (FrameCut, optional): Cuts windows or whole trials from the frames.

    Raises:
        FileNotFoundError: If there is no such file, folder or class.
        ValueError: If an argument does not fit the kind of data.
    """
    if time_axis is not None and cut is not None:
        raise ArgumentError(
            Argument("time_axis"),
            f" must be left out if windows or trials are cut (got {time_axis})",
        )
    frames = _find_data(data, layout, grid, task, time_axis, arguments)
    if resample is not None:
        if "resample" not in (argument_names(frames.class_path) or ["resample"]):
            raise ArgumentError(
                Argument("resample"),
                f" must be left out for {frames.class_path.rpartition('.')[2]}, whose "
                f"frames are not read from recordings (got {resample:g})",
            )
        frames = replace(frames, arguments={**frames.arguments, "resample": resample})
    frames = frames if stride is None else _with_stride(frames, stride)
    return frames if cut is None else cut.cut(frames)


def _find_data(
    data: PathLike,
    layout: str | None,
    grid: str | None,
    task: str | None,
    time_axis: int | None,
    arguments: Mapping[str, Any] | None,
) -> DataSource:
    text, path = str(data), Path(data)
    arguments = dict(arguments or {})
    if path.is_file() or path.suffix == ".npz":
        if path.suffix != ".npz":
            raise ArgumentError(
                Argument("data"), f" must be an npz file, a folder or a class (got '{text}')"
            )
        options = {"layout": layout, "grid": grid, "task": task, "time_axis": time_axis}
        arguments |= {key: value for key, value in options.items() if value is not None}
        return DataSource(f"{_DATASETS}.SamplesFile", {"path": text, **arguments})
    for key, option in {"task": task, "time_axis": time_axis}.items():
        if option is not None:
            raise ValueError(
                f"'{key}' must be left out for anything but an npz file (got {option!r})"
            )
    if path.is_dir():
        if grid is not None:
            arguments["layout"] = _parse_grid(grid)
        elif layout is not None:
            arguments["layout"] = layout
        return DataSource(f"{_DATASETS}.RecordingFrames", {"root": text, **arguments})
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
                f"'{text}' is not a file, a folder or a data set of this package: "
                f"{', '.join(names)}"
            )
        text = f"{_DATASETS}.{text}"
    for key, value in {"layout": layout, "grid": grid}.items():
        if value is not None:
            raise ValueError(f"'{key}' must be left out for a class of data (got '{value}')")
    return DataSource(text, arguments)


def _parse_grid(text: str) -> dict[str, Any]:
    rows, _, cols = text.lower().partition("x")
    if not (rows.isascii() and rows.isdigit() and cols.isascii() and cols.isdigit()):
        raise ArgumentError(
            Argument("grid"), f" must be rows and columns such as 28x50 (got '{text}')"
        )
    size = {"rows": int(rows), "cols": int(cols), "pitch": _PITCH}
    return {"class_path": "torch_geometric_tactile.sensors.grid", "init_args": size}


def _with_stride(frames: DataSource, stride: int) -> DataSource:
    r"""Returns a source with every :obj:`stride`-th frame of each trial."""
    names = argument_names(frames.class_path)
    if names is None or "stride" in names:
        return replace(frames, selection={**frames.selection, "stride": stride})
    return replace(frames, stride=stride)


def describe_left_out(dataset: StaticDataset) -> str:
    r"""Returns a sentence that counts the trials and windows left out when samples were cut, or an
    empty text if there are none.
    """
    parts = []
    if isinstance(dataset, FrameView) and dataset.too_short:
        parts.append(f"trials shorter than a window: {len(dataset.too_short)}")
    if isinstance(dataset, Windows) and dataset.num_beyond:
        parts.append(
            f"windows whose label lies beyond the end of their trial: {dataset.num_beyond}"
        )
    return f"Left out: {'; '.join(parts)}." if parts else ""


def describe_cut(source: DataSource) -> str:
    r"""Returns a sentence that describes the frames of a sample, or an empty text for single
    frames.

    Examples:
        >>> frames = DataSource("torch_geometric_tactile.datasets.BiGS", {"root": "bigs"})
        >>> describe_cut(FrameCut(trials=60).cut(frames))
        'A sample is a whole trial, resampled to 60 frames.'
    """
    arguments = source.arguments
    if source.class_path == _WINDOWS:
        length, hop = arguments["length"], arguments.get("hop", 1)
        horizon = arguments.get("horizon")
        label = f"the frame {horizon} frames after its last" if horizon else "its last frame"
        spacing = "without overlap" if hop == length else f"one every {hop} frames"
        text = f"A sample is a window of {length} frames, {spacing}, with the label of {label}"
    elif source.class_path == _TRIALS:
        step = arguments.get("pre_transform")
        is_resampled = isinstance(step, Mapping) and step.get("class_path") == _RESAMPLE
        num_frames = step["init_args"]["num"] if is_resampled and step is not None else None
        text = "A sample is a whole trial"
        text += f", resampled to {num_frames} frames" if num_frames else ""
    else:
        return ""
    if source.frames is not None and source.frames.tare is not None:
        text += "; the reading at rest of each trial was subtracted first"
    return f"{text}."
