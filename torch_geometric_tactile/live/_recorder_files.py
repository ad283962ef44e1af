r"""The files that a recorder writes into."""

import dataclasses
import logging
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame

_log = logging.getLogger(__name__)
SUFFIXES = (".mcap", ".h5", ".hdf5")
_NANO = 1_000_000_000
_HDF5_SECONDS = 1.0


class RecordingFile:
    r"""A file that grows frame by frame. One thread at a time writes it."""

    def frame(self, frame: LiveFrame) -> None:
        r"""Writes a frame."""
        raise NotImplementedError

    def idle(self) -> None:
        r"""Hands what waits to the operating system, if it has waited for long enough."""
        raise NotImplementedError

    def close(self) -> None:
        r"""Writes the end, and closes it."""
        raise NotImplementedError

    def prediction(self, judgement: Any) -> None:
        r"""Writes what a model said, if the format can."""

    def health(self, now: float, health: Any) -> None:
        r"""Writes how the stream fares, if the format can."""

    def event(self, now: float, kind: str, text: str) -> None:
        r"""Writes that something happened, if the format can."""

    def points(self, now: float, points: Any) -> None:
        r"""Writes the taxels in space, if the format can."""


class McapFile(RecordingFile):
    r"""An MCAP file, which is handed on every quarter of a second and holds all that comes."""

    def __init__(self, path: Path, overwrite: bool, **content: Any) -> None:
        from torch_geometric_tactile.io import McapWriter

        self._writer = McapWriter(path, overwrite=overwrite, **content)

    def frame(self, frame: LiveFrame) -> None:
        self._writer.write_frame(frame)

    def idle(self) -> None:
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()

    def prediction(self, judgement: Any) -> None:
        label = judgement.label
        self._writer.write_prediction(
            judgement.time,
            judgement.probability,
            judgement.class_names,
            label if isinstance(label, str) else ", ".join(map(str, label)),
            sequence=judgement.sequence,
            task=str(judgement.task),
            latency=judgement.latency.get("total"),
        )

    def health(self, now: float, health: Any) -> None:
        self._writer.write_health(now, dataclasses.asdict(health))

    def event(self, now: float, kind: str, text: str) -> None:
        self._writer.write_event(now, kind, text)

    def points(self, now: float, points: Any) -> None:
        self._writer.write_points(now, points.pos, points.fields, points.frame_id)


class Hdf5File(RecordingFile):
    r"""An HDF5 file, to which the frames of a second are added at once. It holds frames only."""

    def __init__(
        self,
        path: Path,
        overwrite: bool,
        meta: Mapping[str, Any],
        anchor: tuple[int, int],
        label: str | int | None,
        layout: str | None = None,
    ) -> None:
        if overwrite:
            path.unlink(missing_ok=True)
        elif path.exists():
            raise FileExistsError(
                f"'{path}' exists: give another name, or overwrite it (--overwrite)"
            )
        self._path, self._meta, self._label = path, dict(meta), label
        self._anchor = anchor[1] / _NANO
        self._frames: list[LiveFrame] = []
        self._first: LiveFrame | None = None

    def frame(self, frame: LiveFrame) -> None:
        self._first = self._first or frame
        self._frames.append(frame)
        if frame.received - self._frames[0].received >= _HDF5_SECONDS * _NANO:
            self._add()

    def idle(self) -> None:
        waited = time.perf_counter_ns() - self._frames[0].received if self._frames else 0
        if waited >= _HDF5_SECONDS * _NANO:
            self._add()

    def _add(self) -> None:
        from torch_geometric_tactile.data import Recording
        from torch_geometric_tactile.io import append_hdf5

        frames, first = self._frames, self._first
        if not frames or first is None:
            return
        clocks = [math.nan if f.device_time is None else f.device_time for f in frames]
        extra = {
            "sequence": np.array([frame.sequence for frame in frames]),
            "device_time": np.array(clocks),
        }
        for name in first.extra.keys() - extra.keys():
            value = first.extra[name]
            extra[name] = np.stack([_value(f.extra.get(name), value, name) for f in frames])
        recording = Recording(
            time=np.array([frame.time for frame in frames]) - self._anchor,
            tactile=np.stack([frame.tactile for frame in frames]),
            joint=None
            if first.joint is None
            else np.stack([_value(f.joint, first.joint, "joint") for f in frames]),
            label=self._label,
            meta=self._meta,
            extra=extra,
        )
        append_hdf5(recording, self._path)
        self._frames = []

    def close(self) -> None:
        self._add()

    def event(self, now: float, kind: str, text: str) -> None:
        _log.warning("'%s' is HDF5 and cannot hold the event '%s'", self._path, kind)


def _value(value: np.ndarray | None, first: np.ndarray, name: str) -> np.ndarray:
    if value is not None:
        return value
    if np.asarray(first).dtype.kind != "f":
        raise ValueError(f"'{name}' must be in each frame of a recording (got one without)")
    return np.full_like(first, np.nan)


def new_file(path: Path, overwrite: bool, **content: Any) -> RecordingFile:
    r"""Returns a new file of the format that its suffix names."""
    return (McapFile if path.suffix.lower() == ".mcap" else Hdf5File)(path, overwrite, **content)


def require_format(path: Path) -> None:
    r"""Checks that files of a suffix can be written."""
    from torch_geometric_tactile.io._hdf5_file import require_h5py
    from torch_geometric_tactile.io._mcap_output import require_mcap

    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"'{path}' must end in one of {', '.join(SUFFIXES)} (got '{suffix}')")
    if suffix == ".mcap":
        require_mcap()
    else:
        require_h5py()
