r"""Arrays as HDF5 keeps them."""

from typing import Any

import numpy as np

_ELEMENTS = 64  # texts of version 1 that are read at once: each may be as long as the file


def as_stored(name: str, array: np.ndarray) -> np.ndarray:
    r"""Returns an array as a file keeps it: texts as UTF-8 of a fixed length.

    Args:
        name (str): Its name, for messages.
        array (numpy.ndarray): The array.

    Raises:
        ValueError: If its numbers are wider than 8 bytes, or UTF-8 cannot hold its texts.
    """
    if array.dtype.kind == "U":
        try:
            texts: np.ndarray = np.char.encode(array, "utf-8")
        except UnicodeEncodeError as error:
            raise ValueError(f"'{name}' must hold texts that UTF-8 can hold ({error})") from error
        return texts.astype(f"S{max(texts.dtype.itemsize, 1)}")
    if array.dtype.itemsize > 8:
        raise ValueError(f"'{name}' must hold numbers of at most 8 bytes (got {array.dtype})")
    return array


def read_rows(dataset: Any, num_frames: int, max_bytes: int) -> np.ndarray:
    r"""Reads the first rows of a data set.

    Args:
        dataset (h5py.Dataset): The data set.
        num_frames (int): How many rows.
        max_bytes (int): The most that its texts may take in memory.

    Raises:
        ValueError: If they take more, or are no UTF-8.
    """
    kind = dataset.dtype.kind
    if kind == "O":
        return _long_texts(dataset, num_frames, max_bytes)
    array: np.ndarray = dataset[:num_frames]
    return np.char.decode(array, "utf-8") if kind == "S" else array


def _long_texts(dataset: Any, num_frames: int, max_bytes: int) -> np.ndarray:
    row = int(np.prod(dataset.shape[1:]))
    step = max(1, _ELEMENTS // max(row, 1))
    texts: list[str] = []
    longest = 0
    for start in range(0, num_frames, step):
        part = dataset.asstr()[start : min(start + step, num_frames)].ravel().tolist()
        texts += part
        longest = max(longest, *map(len, part), 0)
        if 4 * longest * num_frames * row > max_bytes:
            raise ValueError(f"its texts must take no more than {max_bytes} bytes in memory")
    return np.array(texts, dtype=str).reshape(num_frames, *dataset.shape[1:])
