r"""Conversion of a sequence of recordings to frames on disk and trials."""

import logging
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import GroupedError, need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._column_order import column_names, in_column_order
from torch_geometric_tactile.datasets._trial import Trial, check_compatible, make_trial
from torch_geometric_tactile.sensors import TaxelLayout

_logger = logging.getLogger(__name__)


class FrameFiles:
    r"""Named arrays with a row for each frame, used to process data sets larger than memory. Each
    array is in an anonymous temporary file, which is removed when the context ends.
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._open = ExitStack()
        self._files: dict[str, IO[bytes]] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._types: dict[str, np.dtype] = {}

    def add(self, name: str, rows: np.ndarray) -> None:
        r"""Appends rows to an array. The first rows set its type and the shape of a row.

        Shapes:
            - **rows:** The rows :math:`(T, ...)`.
        """
        if name not in self._files:
            self._files[name] = self._open.enter_context(
                tempfile.TemporaryFile(dir=self._folder, buffering=0)  # noqa: SIM115
            )
            self._shapes[name] = (0, *rows.shape[1:])
            self._types[name] = rows.dtype
        length, *shape = self._shapes[name]
        if rows.shape[1:] != (*shape,):
            raise ValueError(f"'{name}' must have rows of shape {(*shape,)} (got {rows.shape[1:]})")
        rows = np.ascontiguousarray(rows, dtype=self._types[name])
        remaining = rows.reshape(-1).view(np.uint8).data
        try:
            # An unbuffered file may write only a part of the bytes, for example on a full disk.
            while len(remaining):
                remaining = remaining[self._files[name].write(remaining) :]
        except OSError as error:
            folder = str(self._folder or tempfile.gettempdir())
            raise OSError(error.errno, os.strerror(error.errno or 0), folder) from error
        self._shapes[name] = (length + len(rows), *shape)

    def shape(self, name: str) -> tuple[int, ...] | None:
        r"""Returns the shape of an array, or :obj:`None` if it has no rows yet."""
        return self._shapes.get(name)

    def tensor(self, name: str) -> Tensor:
        r"""Returns an array as a memory-mapped tensor. Writing to the tensor does not change the
        file.
        """
        shape, dtype = self._shapes[name], self._types[name]
        if 0 in shape:  # An empty file cannot be mapped.
            return torch.from_numpy(np.zeros(shape, dtype))
        return torch.from_numpy(np.memmap(self._files[name], dtype, mode="c", shape=shape))

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.close()


@dataclass(frozen=True)
class UnreadRecording:
    r"""A recording that is read later: its file (for error messages), its name, and the function
    that reads it.
    """

    where: str
    name: str
    read: Callable[[], Recording]


@dataclass
class _Expected:
    # The properties that a recording must share with the valid recordings before it.
    num_channels: int | None
    columns: dict[str, list[str]] = field(default_factory=dict)
    where: str = ""


def raise_all(errors: Sequence[ValueError], num_recordings: int) -> None:
    r"""Raises the errors of several recordings as one error, whose message lists them.

    Args:
        errors (sequence of ValueError): The errors, one for each invalid recording.
        num_recordings (int): The number of recordings.
    """
    if (
        len({str(error) for error in errors}) == 1
    ):  # such as an option with which no file can be read
        raise errors[0]
    if errors:
        raise GroupedError(f"{len(errors)} of {num_recordings} recordings cannot be used", errors)


@dataclass(frozen=True)
class FrameReader:
    r"""Reads recordings that fit a layout and have the same columns and units."""

    layout: TaxelLayout
    pattern: str
    needs: tuple[str, ...] = ()
    num_channels: int | None = None
    num_joints: int | None = None
    unit: str | None = None

    def read(
        self,
        recordings: Sequence[UnreadRecording],
        folder: Path | None,
        known_errors: Mapping[str, ValueError] | None = None,
    ) -> tuple[Tensor, list[Trial]]:
        r"""Returns the readings of all frames, mapped from a temporary file, and the trials.

        Named columns are sorted in the order of the first recording that names them. All recordings
        are checked before an error is raised.

        Args:
            recordings (sequence of UnreadRecording): The recordings.
            folder (Path, optional): The folder of the temporary file.
            known_errors (Mapping, optional): The errors of :meth:`first_frame_errors`, whose
                recordings are not read again.

        Shapes:
            - **output:** readings :math:`(S, N, C)`
        """
        trials: list[Trial] = []
        errors: list[ValueError] = []
        num_missing = 0
        expected = _Expected(num_channels=self.num_channels)
        with FrameFiles(folder) as files:
            for unread in recordings:
                try:
                    if known_errors and unread.where in known_errors:
                        raise known_errors[unread.where]
                    trial, recording = self._check(unread, unread.read(), expected)
                except ValueError as error:
                    errors.append(error)
                    continue
                if not errors:
                    trials.append(trial)
                    files.add("x", recording.tactile)
                    num_missing += int(recording.missing.sum())
            raise_all(errors, len(recordings))
            need(trials, "'recordings' must hold at least one recording (got none)")
            num_frames = sum(trial.num_frames for trial in trials)
            x = files.tensor("x")
        if num_missing:
            _logger.warning(
                "%d of %d readings of taxels are missing (NaN); see FillMissing and DropTaxels",
                num_missing,
                num_frames * self.layout.num_taxels,
            )
        check_compatible(trials, self.unit)
        return x, trials

    def first_frame_errors(self, recordings: Sequence[UnreadRecording]) -> dict[str, ValueError]:
        r"""Returns the errors of recordings by file, from recordings of one frame each. The column
        names of the majority are assumed to be correct.
        """
        errors: dict[str, ValueError] = {}
        first_frames: list[tuple[UnreadRecording, Recording]] = []
        for unread in recordings:
            try:
                first_frames.append((unread, unread.read()))
            except ValueError as error:
                errors[unread.where] = error
        names = [str(sorted(chain(*column_names(r).values()))) for _, r in first_frames]
        common_names = Counter(names).most_common(1)[0][0] if names else ""
        expected = _Expected(num_channels=self.num_channels)
        # A recording with the most common names comes first; the others are compared with it.
        for i in sorted(range(len(names)), key=lambda i: names[i] != common_names):
            unread, recording = first_frames[i]
            try:
                self._check(unread, recording, expected)
            except ValueError as error:
                errors[unread.where] = error
        return errors

    def _check(
        self, unread: UnreadRecording, original: Recording, expected: "_Expected"
    ) -> tuple[Trial, Recording]:
        # Checks a recording. The next recordings must have its columns and channels.
        where = unread.where
        try:
            recording = in_column_order(original, expected.columns)
            columns = column_names(recording)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error
        trial = self._trial(where, unread.name, recording)
        num_channels = expected.num_channels or recording.num_channels
        if recording.num_channels != num_channels:
            raise ValueError(
                f"{where} must have {num_channels} channels per taxel, like "
                f"{expected.where} (got {recording.num_channels})"
            )
        expected.columns = {**columns, **expected.columns}
        expected.num_channels, expected.where = num_channels, expected.where or where
        return trial, recording

    def _trial(self, where: str, name: str, recording: Recording) -> Trial:
        trial = make_trial(
            recording,
            self.layout,
            where=where,
            name=name,
            pattern=self.pattern,
            needs=self.needs,
        )
        for columns, count, expected in (
            ("channels per taxel", recording.num_channels, self.num_channels),
            ("joint angles per frame in 'joint'", recording.num_joints, self.num_joints),
        ):
            if expected not in (None, count):
                raise ValueError(f"{where} must have {expected} {columns} (got {count or 'none'})")
        return trial
