r"""Arrays that grow on disk, since they may be more than fits into memory."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import numpy as np
import torch
from torch import Tensor


class FrameFiles:
    r"""Named arrays with a row for each frame, each in a temporary file that nothing else sees and
    that is gone at the end.
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
        r"""Writes rows behind those that there are.

        Shapes:
            - **rows:** The rows :math:`(T, ...)`, of the shape and type of the first.
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
        left = rows.reshape(-1).view(np.uint8).data
        try:
            while len(left):
                left = left[self._files[name].write(left) :]
        except OSError as error:
            place = str(self._folder or tempfile.gettempdir())
            raise OSError(error.errno, os.strerror(error.errno or 0), place) from error
        self._shapes[name] = (length + len(rows), *shape)

    def shape(self, name: str) -> tuple[int, ...] | None:
        r"""Returns the shape of an array, or nothing if it has no rows yet."""
        return self._shapes.get(name)

    def tensor(self, name: str) -> Tensor:
        r"""Returns an array, memory-mapped; what is written to it stays in memory."""
        shape, dtype = self._shapes[name], self._types[name]
        if 0 in shape:  # which cannot be mapped
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
