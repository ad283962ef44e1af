r"""Conversion of a sequence of recordings to frames on disk and trials."""

import logging
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._column_order import column_names, in_column_order
from torch_geometric_tactile.datasets._trial import Trial, check_compatible, make_trial
from torch_geometric_tactile.sensors import TaxelLayout

_logger = logging.getLogger(__name__)


class FrameFiles:
    r"""Named arrays with a row for each frame, each in an anonymous temporary file that is removed
    when the context ends. Data sets larger than memory are processed with them.
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
            # An unbuffered file may write only a part of the bytes, as on a full disk.
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
class FrameReader:
    r"""Reads recordings that fit a layout and have the same columns and units."""

    layout: TaxelLayout
    pattern: str
    needs: tuple[str, ...] = ()
    num_channels: int | None = None
    num_joints: int | None = None
    unit: str | None = None

    def read(
        self, recordings: Iterable[tuple[str, str, Recording]], folder: Path | None
    ) -> tuple[Tensor, list[Trial]]:
        r"""Returns the readings of all frames, mapped from a temporary file, and the trials.

        Named columns are put into the order of the first recording that names them.

        Shapes:
            - **output:** readings :math:`(S, N, C)`
        """
        trials: list[Trial] = []
        num_missing, num_channels = 0, self.num_channels
        columns: dict[str, list[str]] = {}
        with FrameFiles(folder) as files:
            for where, name, original in recordings:
                try:
                    recording = in_column_order(original, columns)
                    columns = {**column_names(recording), **columns}
                except ValueError as error:
                    raise ValueError(f"{where}: {error}") from error
                trials.append(self._trial(where, name, recording))
                num_channels = num_channels or recording.num_channels
                if recording.num_channels != num_channels:
                    raise ValueError(
                        f"{where} must have {num_channels} channels per taxel, as "
                        f"{trials[0].where} (got {recording.num_channels})"
                    )
                files.add("x", recording.tactile)
                num_missing += int(recording.missing.sum())
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
