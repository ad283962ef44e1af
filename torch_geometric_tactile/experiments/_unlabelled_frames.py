r"""The frames of trials, without labels: of recordings, a folder of them, a file of samples or a
data set."""

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data import Recording, StaticData, apply_transform
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._folder_tables import TABLES
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, stock_names
from torch_geometric_tactile.sensors import grid as planar_grid

_RECORDINGS = (".h5", ".hdf5", ".npz", ".mcap", ".csv")
_PITCH = 0.005


class UnlabelledFrames(NamedTuple):
    r"""Readings :math:`(S, N, C)`, the trial of each frame :math:`(S,)`, the taxels, and where they
    are from.
    """

    x: np.ndarray
    trial: np.ndarray
    layout: TaxelLayout
    source: str


def unlabelled_frames(
    data: Sequence[str],
    *,
    layout: str | None = None,
    grid: str | None = None,
    init: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
    stride: int = 1,
    rest: int | None = None,
) -> UnlabelledFrames:
    r"""Reads frames. Of each trial, every so manieth frame is taken, and of these the mean of the
    first ones, which are at rest, is subtracted if :obj:`rest` says how many.
    """
    paths = _recordings(data)
    if paths and init:
        raise ValueError(f"'init' must be left out for recordings (got {sorted(init)})")
    if not paths and options:
        raise ValueError(
            f"the options of recordings, {sorted(options)}, must be left out for '{data[0]}', "
            "which has none"
        )
    if paths:
        found = _of_recordings(paths, layout, grid, options or {})
    else:
        found = _of_data_set(data[0], layout, grid, init or {})
    return _taken(found, stride, rest)


def _recordings(data: Sequence[str]) -> list[Path]:
    # The files of recordings; none if the one text stands for samples or a data set.
    if len(data) == 1:
        path = Path(data[0])
        if path.is_dir():
            raw = path / "raw" if (path / "raw").is_dir() else path
            files = (p for p in raw.iterdir() if p.name not in TABLES)
            found = sorted(p for p in files if p.suffix.lower() in _RECORDINGS)
            if not found:
                raise FileNotFoundError(
                    f"'{raw}' has no recordings ({', '.join(_RECORDINGS)}); each file is a trial"
                )
            return found
        if not path.is_file() and path.suffix.lower() not in _RECORDINGS:
            return []
        return [] if _is_of_samples(path) else [path]
    for text in data:
        if Path(text).is_file() and _is_of_samples(Path(text)):
            raise ValueError(
                f"'{text}' is a file of samples, which must be given alone (got {len(data)} files)"
            )
    return [Path(text) for text in data]


def _is_of_samples(path: Path) -> bool:
    # A recording names its format.
    if path.suffix.lower() != ".npz":
        return False
    try:
        with zipfile.ZipFile(path) as file:
            return "format.npy" not in file.namelist()
    except (OSError, zipfile.BadZipFile):
        return True  # whose reader says what is wrong


def _of_recordings(
    paths: Sequence[Path], layout: str | None, grid: str | None, options: Mapping[str, Any]
) -> UnlabelledFrames:
    recordings = [read_recording(path, **options) for path in paths]
    found = _layout(recordings[0], paths[0], layout, grid)
    sizes = [(r.num_taxels, r.num_channels) for r in recordings]
    others = [str(p) for p, size in zip(paths, sizes, strict=True) if size != sizes[0]]
    if others:
        raise ValueError(
            f"all recordings must be of one sensor, of {sizes[0][0]} taxels and {sizes[0][1]} "
            f"channels as '{paths[0]}' (got others in {short_list(others, 3)})"
        )
    recordings[0].check(found)
    trial = np.repeat(np.arange(len(paths)), [r.num_frames for r in recordings])
    x = np.concatenate([r.tactile for r in recordings])
    return UnlabelledFrames(x, trial, found, f"{len(paths)} recordings")


def _layout(recording: Recording, path: Path, layout: str | None, grid: str | None) -> TaxelLayout:
    if layout is not None:
        return as_layout(layout)
    if grid is not None:
        rows, _, cols = grid.lower().partition("x")
        if not (rows.isascii() and rows.isdigit() and cols.isascii() and cols.isdigit()):
            raise ValueError(f"'grid' must be rows and columns such as 28x50 (got '{grid}')")
        return planar_grid(int(rows), int(cols), _PITCH)
    sensor = recording.meta.get("sensor")
    if sensor not in stock_names():
        raise ValueError(
            f"a 'layout' or a 'grid' must be given: '{path}' does not name its sensor (got "
            f"{sensor!r})"
        )
    return as_layout(sensor)


def _of_data_set(
    text: str, layout: str | None, grid: str | None, arguments: Mapping[str, Any]
) -> UnlabelledFrames:
    is_file = Path(text).suffix == ".npz"
    given = {**arguments, "labelled": False} if is_file else arguments
    dataset = data_source(text, layout=layout, grid=grid, arguments=given).load()
    data: StaticData = dataset.data
    data = data if dataset.transform is None else apply_transform(dataset.transform, data)
    if data.get("num_frames") is not None:
        raise ValueError(f"'{text}' must hold single frames (got windows of {data.num_frames})")
    trial = dataset.column("trial")
    if trial is None:
        raise ValueError(
            f"'{text}' must have a 'trial' for each frame: frames of one trial are contrasted with "
            "those of others (got none)"
        )
    return UnlabelledFrames(data.x.numpy(), trial.numpy(), dataset.layout, Path(text).name)


def _taken(found: UnlabelledFrames, stride: int, rest: int | None) -> UnlabelledFrames:
    order = np.argsort(found.trial, kind="stable")
    x, trial = found.x[order].astype(np.float32), found.trial[order]
    _, begin, count = np.unique(trial, return_index=True, return_counts=True)
    place = np.arange(len(trial)) - np.repeat(begin, count)
    kept = place % stride == 0
    x, trial, place = x[kept], trial[kept], place[kept] // stride
    if rest is not None:
        for number in np.unique(trial):
            mine = trial == number
            with np.errstate(invalid="ignore"):
                x[mine] -= np.nanmean(x[mine & (place < rest)], axis=0)
    return found._replace(x=x, trial=trial)
