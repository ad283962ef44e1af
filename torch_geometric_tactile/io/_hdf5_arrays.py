r"""Arrays as HDF5 keeps them."""

from typing import Any

import numpy as np

_VALUES_PER_CHUNK = 2**15
_MOST_FRAMES_PER_CHUNK = 512
_GZIP_LEVEL = 1  # counts shrink about as much as at 9, several times faster
_SHORTEST_TEXT = 32  # bytes of a text in a file that grows
_ELEMENTS = 64  # texts of version 1 that are read at once: each may be as long as the file


def as_stored(array: np.ndarray) -> np.ndarray:
    r"""Returns an array of a recording as a file keeps it: texts as UTF-8 of a fixed length."""
    if array.dtype.kind != "U":
        return array
    texts: np.ndarray = np.char.encode(array, "utf-8")
    return texts.astype(f"S{max(texts.dtype.itemsize, 1)}")


def with_room(array: np.ndarray) -> np.ndarray:
    r"""Returns texts with room for longer ones in frames to come, and other arrays as they are."""
    if array.dtype.kind != "S":
        return array
    return array.astype(f"S{max(_SHORTEST_TEXT, 2 * array.itemsize)}")


def create_dataset(file: Any, name: str, array: np.ndarray, growing: bool) -> Any:
    r"""Writes an array as a data set whose first dimension is resizable."""
    import h5py

    texts = array.dtype.kind == "S"
    frames = max(1, _VALUES_PER_CHUNK // max(1, int(np.prod(array.shape[1:]))))
    frames = 1 if growing else min(frames, _MOST_FRAMES_PER_CHUNK)
    return file.create_dataset(
        name,
        data=array.astype(h5py.string_dtype("utf-8", array.itemsize)) if texts else array,
        maxshape=(None, *array.shape[1:]),
        chunks=(frames, *(max(1, size) for size in array.shape[1:])),
        fillvalue=np.nan if array.dtype.kind == "f" else None,
        fletcher32=True,
        shuffle=not growing,
        compression=None if growing else "gzip",
        compression_opts=None if growing else _GZIP_LEVEL,
    )


def read_rows(dataset: Any, num_frames: int, max_bytes: int) -> np.ndarray:
    r"""Reads the first rows of a data set. Texts of a fixed length stay as they are stored."""
    if dataset.dtype.kind == "O":
        return _long_texts(dataset, num_frames, max_bytes)
    array: np.ndarray = dataset[:num_frames]
    return array


def as_texts(array: np.ndarray) -> np.ndarray:
    r"""Returns texts for UTF-8 of a fixed length, and other arrays as they are."""
    return np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array


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
