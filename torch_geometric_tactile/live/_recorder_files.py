r"""The files that a recorder writes into."""

import dataclasses
import logging
import shlex
from pathlib import Path
from typing import Any

from torch_geometric_tactile.data.live_frame import LiveFrame

_log = logging.getLogger(__name__)
SUFFIXES = (".mcap", ".h5", ".hdf5")


class McapFile:
    r"""An MCAP file, which grows frame by frame, is handed on every quarter of a second and holds
    all that comes. One thread at a time writes it.
    """

    def __init__(self, path: Path, overwrite: bool, **content: Any) -> None:
        from torch_geometric_tactile.io import McapWriter

        self._writer = McapWriter(path, overwrite=overwrite, **content)

    def frame(self, frame: LiveFrame) -> None:
        r"""Writes a frame."""
        self._writer.write_frame(frame)

    def idle(self) -> None:
        r"""Hands what waits to the operating system."""
        self._writer.flush()

    def close(self) -> None:
        r"""Writes the end, and closes it."""
        self._writer.close()

    def prediction(self, judgement: Any) -> None:
        r"""Writes what a model said."""
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
        r"""Writes how the stream fares."""
        self._writer.write_health(now, dataclasses.asdict(health))

    def event(self, now: float, kind: str, text: str) -> None:
        r"""Writes that something happened."""
        self._writer.write_event(now, kind, text)

    def points(self, now: float, points: Any) -> None:
        r"""Writes the taxels in space."""
        self._writer.write_points(now, points.pos, points.fields, points.frame_id)


class Hdf5File(McapFile):
    r"""An HDF5 file, which is written once, at the end: until then there is an MCAP file beside it,
    which stays if that fails.
    """

    def __init__(self, path: Path, overwrite: bool, **content: Any) -> None:
        check_new(path, overwrite)
        self._path, self._growing = path, growing_path(path)
        super().__init__(self._growing, overwrite=False, **content)

    def close(self) -> None:
        from torch_geometric_tactile.io import read_mcap, write_hdf5

        try:
            super().close()
            write_hdf5(read_mcap(self._growing, recover=False, allow_large=True), self._path)
        except BaseException:
            _log.error(
                "'%s' was not written; the recording is in '%s': tactile convert %s",
                self._path,
                self._growing,
                _words(self._growing, self._path),
            )
            raise
        self._growing.unlink()


def growing_path(path: Path) -> Path:
    r"""Returns the path of the file that grows frame by frame: MCAP, beside an HDF5 file."""
    return path.with_suffix(".mcap") if path.suffix.lower() != ".mcap" else path


def new_file(path: Path, overwrite: bool, **content: Any) -> McapFile:
    r"""Returns a new file of the format that its suffix names."""
    return (McapFile if path.suffix.lower() == ".mcap" else Hdf5File)(path, overwrite, **content)


def check_new(path: Path, overwrite: bool) -> None:
    r"""Checks that nothing is replaced unasked."""
    if path.exists() and not overwrite:
        raise FileExistsError(f"'{path}' exists: give another name, or overwrite it (--overwrite)")
    growing = growing_path(path)
    if growing != path and growing.exists():
        raise FileExistsError(
            f"'{growing}' exists, from which '{path}' would be made: convert it (tactile convert "
            f"{_words(growing, path)}), move it, or give another name"
        )


def _words(*paths: Path) -> str:
    return " ".join(shlex.quote(str(path)) for path in paths)


def require_format(path: Path) -> None:
    r"""Checks that files of a suffix can be written."""
    from torch_geometric_tactile.io._hdf5_file import require_h5py
    from torch_geometric_tactile.io._mcap_output import require_mcap

    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"'{path}' must end in one of {', '.join(SUFFIXES)} (got '{suffix}')")
    require_mcap()
    if suffix != ".mcap":
        require_h5py()
