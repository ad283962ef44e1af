r"""Recordings as HDF5 files. The functions need the extra ``io``.

Names are as in :mod:`~torch_geometric_tactile.io._recording_schema`. Arrays are data sets with a
resizable first dimension, and ``privileged`` and ``extra`` are groups. ``format``, ``version``,
``num_frames``, ``label``, ``meta``, ``annotations`` (if any) and ``checksum`` are attributes of the
file. ``checksum`` is the CRC-32 of the other attributes and of the names, types and shapes of the
arrays. ``checksums`` holds the CRC-32 of each frame, uint32 :math:`(T,)`.

The functions write version 2, which has checksums for every part: fletcher32 for each chunk of the
arrays, the CRC-32 of each frame, the checksums of HDF5 1.10 for its structures, and the CRC-32 of
the attributes, whose strings have a fixed length. A damaged file raises an error or reads
correctly. Version 1 can still be read. It has no checksums, so a flipped bit may change a number.
Existing checksums are compared in any version.

Files to which versions up to 0.2 of this package appended are not compressed. They may end in a
journal of an interrupted append, which is applied when reading.

Links to other files are not followed, and only the built-in filters of HDF5 are used.
"""

import io
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._hdf5_checks import (
    check_dataset_sizes,
    check_format,
    find_dataset,
    find_datasets,
    hdf5_path,
    integer_attribute,
    text_attribute,
)
from torch_geometric_tactile.io._hdf5_file import (
    CHECKSUMMED,
    create_dataset,
    decode_texts,
    encode_texts,
    open_hdf5,
    read_rows,
    require_h5py,
)
from torch_geometric_tactile.io._recording_schema import (
    FORMAT,
    recording_from_fields,
    recording_to_arrays,
    recording_to_texts,
)

_FRAME_CHECKSUMS = "checksums"
_VERSION = 2
_READABLE_VERSIONS = (1, 2)
_CHECKSUMS_PER_CHUNK = 1024


def write_hdf5(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a compressed HDF5 file that is either complete or absent.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Raises:
        ImportError: If h5py is missing.
        OSError: If the disk is full. The file keeps its old content.
        ValueError: If HDF5 cannot store the recording, such as numbers wider than 8 bytes.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), label="cup")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_hdf5(recording, f"{folder}/grasp.h5")
        ...     read_hdf5(f"{folder}/grasp.h5")
        Recording(num_frames=2, num_taxels=4, num_channels=3, rate=100, label='cup')
    """
    h5py = require_h5py()
    # Written in memory first, since HDF5 crashes if the disk is full when it closes a file.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=CHECKSUMMED) as file:
        arrays = recording_to_arrays(recording)
        stored = {name: encode_texts(array) for name, array in arrays.items()}
        datasets = {name: create_dataset(file, name, array) for name, array in stored.items()}
        file.create_dataset(
            _FRAME_CHECKSUMS,
            data=_frame_checksums(stored),
            maxshape=(None,),
            chunks=(_CHECKSUMS_PER_CHUNK,),
        )
        texts = recording_to_texts(recording)
        file.attrs["format"] = _fixed_length_text(FORMAT)
        file.attrs["version"] = np.int64(_VERSION)
        file.attrs["num_frames"] = np.int64(recording.num_frames)
        for name, text in texts.items():
            file.attrs[name] = _fixed_length_text(text)
        file.attrs["checksum"] = _head_checksum(_VERSION, recording.num_frames, texts, datasets)
    with atomic_path(path) as temporary:
        temporary.write_bytes(image.getbuffer())


def read_hdf5(path: PathLike, *, max_bytes: int | None = None) -> Recording:
    r"""Reads a recording from an HDF5 file.

    Args:
        path (str or PathLike): A file written by :meth:`write_hdf5`.
        max_bytes (int, optional): Maximum size of the arrays in memory. Defaults to 1 GiB or a
            hundred times the size of the file, whichever is larger.

    Raises:
        ImportError: If h5py is missing.
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not an HDF5 file, is truncated or damaged, lacks a field, has an
            unsupported version, refers to other files, or holds more than :obj:`max_bytes`. The
            message names the file.
        BlockingIOError: If another process is writing the file.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), meta={"rate": 99})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_hdf5(recording, f"{folder}/grasp.h5")
        ...     read_hdf5(f"{folder}/grasp.h5").meta["rate"]
        99
    """
    path = hdf5_path(_checked_path(path))
    with open_hdf5(path) as file:
        return _read_frames(path, _read_head(path, file), max_bytes)


def read_hdf5_head(path: PathLike) -> Recording:
    r"""Reads the metadata of a recording in an HDF5 file, without its frames.

    Args:
        path (str or PathLike): A file written by :meth:`write_hdf5`.

    Returns:
        Recording: A recording without frames, with label, metadata and the shapes of a frame.

    Raises:
        ImportError: If h5py is missing.
        FileNotFoundError: If there is no such file.
        ValueError: As for :meth:`read_hdf5`.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), label="cup")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_hdf5(recording, f"{folder}/grasp.h5")
        ...     head = read_hdf5_head(f"{folder}/grasp.h5")
        >>> head.label, head.tactile.shape
        ('cup', (0, 4, 3))
    """
    path = hdf5_path(_checked_path(path))
    with open_hdf5(path) as file:
        return _read_head(path, file).head


def _checked_path(path: PathLike) -> Path:
    require_h5py()
    return Path(path)


def _fixed_length_text(text: str) -> np.ndarray:
    content = text.encode()
    return np.array(content, dtype=require_h5py().string_dtype("utf-8", len(content)))


class _Content(NamedTuple):
    # The content of a file before its frames are read.
    head: Recording
    datasets: dict[str, Any]
    checksums: Any | None  # of frames; None in version 1
    num_frames: int
    texts: dict[str, str]


def _read_head(path: Path, file: Any) -> _Content:
    check_format(path, file)
    attrs = file.attrs
    version = integer_attribute(path, attrs, "version")
    if version not in _READABLE_VERSIONS:
        raise ValueError(
            f"'{path}' must be of format version {' or '.join(map(str, _READABLE_VERSIONS))} (got "
            f"{version}): read it with the version of torch-geometric-tactile that wrote it"
        )
    datasets = find_datasets(path, file)
    num_frames = integer_attribute(path, attrs, "num_frames")
    names = ["label", "meta", *(["annotations"] if "annotations" in attrs else [])]
    texts = {name: text_attribute(path, attrs, name) for name in names}
    checksums = None
    # Existing checksums are compared in version 1 too: the version itself may be damaged.
    if version > 1 or "checksum" in attrs or _FRAME_CHECKSUMS in file:
        checksum = _head_checksum(version, num_frames, texts, datasets)
        if integer_attribute(path, attrs, "checksum") != checksum:
            raise ValueError(
                f"'{path}' must match its checksum (got another label, other metadata or other "
                "arrays): copy or record it again"
            )
        for name, dataset in datasets.items():
            if not dataset.fletcher32:
                raise ValueError(f"'{path}' must have checksums in '{name}' (got none)")
        checksums = find_dataset(path, file, _FRAME_CHECKSUMS)
        if checksums.ndim != 1 or checksums.dtype.kind != "u" or checksums.dtype.itemsize != 4:
            raise ValueError(
                f"'{path}' must hold an unsigned integer of 4 bytes for each frame in "
                f"'{_FRAME_CHECKSUMS}' (got {checksums.dtype} of shape {checksums.shape})"
            )
    # Reads zero frames, which checks shapes and types at no cost.
    empty = {name: decode_texts(read_rows(dataset, 0, 0)) for name, dataset in datasets.items()}
    head = recording_from_fields(path, empty, texts)
    return _Content(head, datasets, checksums, num_frames, texts)


def _read_frames(path: Path, content: _Content, max_bytes: int | None) -> Recording:
    num_frames, datasets, checksums = content.num_frames, content.datasets, content.checksums
    all_datasets = datasets if checksums is None else {**datasets, _FRAME_CHECKSUMS: checksums}
    limit = check_dataset_sizes(path, all_datasets, num_frames, max_bytes)
    stored = {name: read_rows(dataset, num_frames, limit) for name, dataset in datasets.items()}
    if checksums is not None:
        _check_frame_checksums(path, stored, checksums[:num_frames])
    arrays = {name: decode_texts(array) for name, array in stored.items()}
    return recording_from_fields(path, arrays, content.texts)


def _head_checksum(
    version: int, num_frames: int, texts: Mapping[str, str], datasets: Mapping[str, Any]
) -> np.uint32:
    # The CRC-32 of the attributes of a file, and of the names, types and shapes of its arrays.
    fields = [[name, d.dtype.str, *d.shape[1:]] for name, d in sorted(datasets.items())]
    content = [FORMAT, version, num_frames, *texts.values(), fields]
    return np.uint32(zlib.crc32(json.dumps(content).encode()))


def _frame_checksums(stored: Mapping[str, np.ndarray]) -> np.ndarray:
    # The CRC-32 of each frame, over the arrays sorted by name. The Fletcher-32 of HDF5 detects
    # every flipped bit, but does not distinguish two bytes of ones from two bytes of zeros.
    frames_of_arrays = [_frame_bytes(array) for _, array in sorted(stored.items())]
    checksums = [0] * len(frames_of_arrays[0])
    for frames in frames_of_arrays:
        checksums = [
            zlib.crc32(frame, checksum) for frame, checksum in zip(frames, checksums, strict=True)
        ]
    return np.array(checksums, dtype=np.uint32)


def _check_frame_checksums(
    path: Path, stored: Mapping[str, np.ndarray], checksums: np.ndarray
) -> None:
    differing = np.flatnonzero(_frame_checksums(stored) != checksums)
    if len(differing):
        raise ValueError(
            f"'{path}' must match the checksums of its frames (got damaged frames from frame "
            f"{differing[0]} on, {len(differing)} in total): copy or record it again"
        )


def _frame_bytes(array: np.ndarray) -> np.ndarray:
    bytes_per_frame = array.itemsize * int(np.prod(array.shape[1:]))
    return np.ascontiguousarray(array).view(np.uint8).reshape(len(array), bytes_per_frame)
