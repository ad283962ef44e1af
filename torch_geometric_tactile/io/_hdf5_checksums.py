r"""Checksums of what an HDF5 file says about a recording, and of its frames.

The Fletcher-32 of HDF5 sees every flipped bit, but takes two bytes of ones for two of zeros. Each
frame therefore has a CRC-32 as well.
"""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.io._recording_schema import FORMAT

FRAMES = "checksums"


def head_checksum(
    version: int, num_frames: int, texts: Mapping[str, str], datasets: Mapping[str, Any]
) -> np.uint32:
    r"""Returns the CRC-32 of the attributes of a file, and of the names, types and shapes of its
    arrays.
    """
    fields = [[name, d.dtype.str, *d.shape[1:]] for name, d in sorted(datasets.items())]
    content = [FORMAT, version, num_frames, texts["label"], texts["meta"], fields]
    return np.uint32(zlib.crc32(json.dumps(content).encode()))


def frame_checksums(stored: Mapping[str, np.ndarray]) -> np.ndarray:
    r"""Returns the CRC-32 of each frame, over the arrays in the order of their names.

    Shapes:
        - **returns:** numpy.ndarray: Checksums, uint32 :math:`(T,)`.
    """
    rows = [_bytes_of_frames(array) for _, array in sorted(stored.items())]
    sums = [0] * len(rows[0])
    for row in rows:
        sums = [zlib.crc32(frame, sum_) for frame, sum_ in zip(row, sums, strict=True)]
    return np.array(sums, dtype=np.uint32)


def check_frames(path: Path, stored: Mapping[str, np.ndarray], sums: np.ndarray) -> None:
    r"""Compares frames with their checksums."""
    other = np.flatnonzero(frame_checksums(stored) != sums)
    if len(other):
        raise ValueError(
            f"'{path}' must hold the frames that its checksums are of (got others from frame "
            f"{other[0]} on, {len(other)} in all): it is damaged, copy or record it again"
        )


def _bytes_of_frames(array: np.ndarray) -> np.ndarray:
    width = array.itemsize * int(np.prod(array.shape[1:]))
    return np.ascontiguousarray(array).view(np.uint8).reshape(len(array), width)
