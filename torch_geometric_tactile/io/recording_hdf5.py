r"""Recordings as HDF5 files, which may grow frame by frame. Needs the extra ``io`` when a function
is called.

Names as in :mod:`~torch_geometric_tactile.io._recording_schema`: arrays are data sets whose first
dimension is resizable, and ``privileged`` and ``extra`` are groups; ``format``, ``version``,
``num_frames``, ``label``, ``meta`` and ``checksum`` (the CRC-32 of these five and of the names,
types and shapes of the arrays) are attributes of the file; ``checksums`` is the CRC-32 of each
frame, uint32 :math:`(T,)`.

Version 2, which is written, has a checksum of every part: fletcher32 for each block of the arrays,
the CRC-32 of each frame, those of HDF5 1.10 for its own structures, and that of the attributes,
whose texts have a fixed length. A damaged file is refused or reads as before. Version 1, which is
still read, has none of this: a flipped bit may read as another number. Checksums that are there are
compared in any version.

Nothing that a file refers to outside of itself is read, and only the filters of HDF5 itself are
used.
"""

import io
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._files import atomic_path, remove_leftovers, share
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._hdf5_arrays import (
    as_stored,
    as_texts,
    create_dataset,
    read_rows,
    with_room,
)
from torch_geometric_tactile.io._hdf5_checks import (
    check_format,
    check_sizes,
    checked_dataset,
    checked_datasets,
    hdf5_file,
    integer_attribute,
    text_attribute,
)
from torch_geometric_tactile.io._hdf5_checksums import (
    FRAMES,
    check_frames,
    frame_checksums,
    head_checksum,
)
from torch_geometric_tactile.io._hdf5_file import CHECKSUMMED, opened, require_h5py
from torch_geometric_tactile.io._recording_schema import (
    FORMAT,
    recording_from_fields,
    recording_to_arrays,
    recording_to_texts,
)

_VERSION = 2
_READABLE = (1, 2)
_CHECKSUMS_PER_CHUNK = 1024


def write_hdf5(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a compressed HDF5 file that is either complete or absent.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Raises:
        ImportError: If h5py is missing.
        OSError: If the disk is full. The file keeps its old content.
        ValueError: If the file cannot hold the recording: numbers wider than 8 bytes, for instance.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), label="cup")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_hdf5(recording, f"{folder}/grasp.h5")
        ...     read_hdf5(f"{folder}/grasp.h5")
        Recording(num_frames=2, num_taxels=4, num_channels=3, rate=100, label='cup')
    """
    _write(recording, Path(path), growing=False)


def read_hdf5(path: PathLike, *, max_bytes: int | None = None) -> Recording:
    r"""Reads a recording from an HDF5 file. Frames of an append that was interrupted are left out.

    Args:
        path (str or PathLike): A file as :meth:`write_hdf5` or :meth:`append_hdf5` writes it.
        max_bytes (int, optional): The most that the arrays may take in memory. If left out, 1 GiB
            or a hundred times the size of the file, whichever is more.

    Raises:
        ImportError: If h5py is missing.
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no HDF5 file, cut or damaged, lacks something, is of another
            version, refers to other files, or holds more than :obj:`max_bytes`. The message names
            the file.
        BlockingIOError: If another process writes the file.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), meta={"rate": 99})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_hdf5(recording, f"{folder}/grasp.h5")
        ...     read_hdf5(f"{folder}/grasp.h5").meta["rate"]
        99
    """
    path = hdf5_file(_h5py_needed(path))
    with opened(path, "r") as file:
        return _read(path, _checked(path, file), max_bytes)


def read_hdf5_head(path: PathLike) -> Recording:
    r"""Reads the metadata of a recording in an HDF5 file, without its frames.

    Args:
        path (str or PathLike): A file as :meth:`write_hdf5` or :meth:`append_hdf5` writes it.

    Returns:
        Recording: One without frames, with label, metadata and the shapes of a frame.

    Raises:
        ImportError: If h5py is missing.
        FileNotFoundError: If there is no such file.
        ValueError: As :meth:`read_hdf5`.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), label="cup")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_hdf5(recording, f"{folder}/grasp.h5")
        ...     head = read_hdf5_head(f"{folder}/grasp.h5")
        >>> head.label, head.tactile.shape
        ('cup', (0, 4, 3))
    """
    path = hdf5_file(_h5py_needed(path))
    with opened(path, "r") as file:
        return _checked(path, file).head


def append_hdf5(recording: Recording, path: PathLike) -> None:
    r"""Appends frames to an HDF5 file, which is created if missing.

    All frames of a call are added or none. What earlier calls added stays as it is on the disk and
    can be read whenever the process is killed or the disk is full. Only a power failure may damage
    a file that was written in the last seconds. A file that grows is not compressed, and has a
    block for each frame; a file of :meth:`write_hdf5`, or of an older version, is therefore
    rewritten once, at the first append, and :obj:`write_hdf5(read_hdf5(path), path)` compresses it
    when it is complete.

    Args:
        recording (Recording): The frames. Label and metadata of the file stay as they are.
        path (str or PathLike): The file.

    Raises:
        ImportError: If h5py is missing.
        BlockingIOError: If another process writes the file.
        OSError: If the disk is full. The file keeps the frames that it has.
        ValueError: If the file cannot be read, or the frames do not go on from it: an earlier
            time, other shapes, another label or unit.

    Examples:
        >>> import tempfile
        >>> frames = [Recording(time=[t], tactile=np.ones((1, 4, 3))) for t in (0.0, 0.01, 0.02)]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for frame in frames:
        ...         append_hdf5(frame, f"{folder}/grasp.h5")
        ...     read_hdf5(f"{folder}/grasp.h5").num_frames
        3
    """
    path = _h5py_needed(path)
    remove_leftovers(path)
    while not path.exists():
        with suppress(FileExistsError):  # by another process just now
            _write(recording, path, growing=True, new=True)
            return
    with opened(hdf5_file(path), "r+") as file:
        content = _checked(path, file)
        datasets, start = content.datasets, content.num_frames
        stored = {n: as_stored(a) for n, a in recording_to_arrays(recording).items()}
        _check_continues(path, content, recording)
        if recording.num_frames == 0:
            return
        grows = all(
            dataset.fletcher32
            and not dataset.compression
            and dataset.chunks[0] == 1
            and (dataset.dtype.kind != "S" or dataset.dtype.itemsize >= stored[name].itemsize)
            for name, dataset in datasets.items()
        )
        if not grows:
            before = _read(path, content, max_bytes=2**63)
            _write(_joined(before, recording), path, growing=True)
            return
        end = start + recording.num_frames
        stored = {name: array.astype(datasets[name].dtype) for name, array in stored.items()}
        sums = frame_checksums(stored)
        for name, array in [*stored.items(), (FRAMES, sums)]:
            file[name].resize(end, axis=0)
            file[name][start:end] = array
        file.attrs.modify("num_frames", np.int64(end))
        checksum = head_checksum(_VERSION, end, content.texts, datasets)
        file.attrs.modify("checksum", checksum)


def _h5py_needed(path: PathLike) -> Path:
    require_h5py()
    return Path(path)


def _write(recording: Recording, path: Path, growing: bool, new: bool = False) -> None:
    h5py = require_h5py()
    # In memory, since HDF5 ends the process if the disk is full when it closes a file.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=CHECKSUMMED) as file:
        stored = {
            name: with_room(as_stored(array)) if growing else as_stored(array)
            for name, array in recording_to_arrays(recording).items()
        }
        datasets = {n: create_dataset(file, n, array, growing) for n, array in stored.items()}
        sums = frame_checksums(stored)
        file.create_dataset(FRAMES, data=sums, maxshape=(None,), chunks=(_CHECKSUMS_PER_CHUNK,))
        texts = recording_to_texts(recording)
        file.attrs["format"] = _fixed(FORMAT)
        file.attrs["version"] = np.int64(_VERSION)
        file.attrs["num_frames"] = np.int64(recording.num_frames)
        for name, text in texts.items():
            file.attrs[name] = _fixed(text)
        file.attrs["checksum"] = head_checksum(_VERSION, recording.num_frames, texts, datasets)
    with atomic_path(path) as temporary:
        temporary.write_bytes(image.getbuffer())
        if new:
            share(temporary)
            try:
                os.link(temporary, path)  # unlike a new name, not over a file that came meanwhile
            except FileExistsError:
                raise
            except OSError:
                pass  # a file system without links


def _fixed(text: str) -> np.ndarray:
    content = text.encode()
    return np.array(content, dtype=require_h5py().string_dtype("utf-8", len(content)))


class _Content(NamedTuple):
    # What a file holds, before its frames are read.
    head: Recording
    datasets: dict[str, Any]
    checksums: Any | None  # of frames; none in version 1
    num_frames: int
    texts: dict[str, str]


def _checked(path: Path, file: Any) -> _Content:
    check_format(path, file)
    attrs = file.attrs
    version = integer_attribute(path, attrs, "version")
    if version not in _READABLE:
        raise ValueError(
            f"'{path}' must be of format version {' or '.join(map(str, _READABLE))} (got "
            f"{version}): read it with the version of torch-geometric-tactile that wrote it"
        )
    datasets = checked_datasets(path, file)
    num_frames = integer_attribute(path, attrs, "num_frames")
    texts = {name: text_attribute(path, attrs, name) for name in ("label", "meta")}
    checksums = None
    # A file that says it is of version 1 may have been changed to say so.
    if version > 1 or "checksum" in attrs or FRAMES in file:
        checksum = head_checksum(version, num_frames, texts, datasets)
        if integer_attribute(path, attrs, "checksum") != checksum:
            raise ValueError(
                f"'{path}' must hold the label, metadata and arrays that its checksum is of (got "
                "others): copy or record it again"
            )
        for name, dataset in datasets.items():
            if not dataset.fletcher32:
                raise ValueError(f"'{path}' must have checksums in '{name}' (got none)")
        checksums = checked_dataset(path, file, FRAMES)
        if checksums.ndim != 1 or checksums.dtype.kind != "u" or checksums.dtype.itemsize != 4:
            raise ValueError(
                f"'{path}' must hold an unsigned integer of 4 bytes for each frame in '{FRAMES}' "
                f"(got {checksums.dtype} of shape {checksums.shape})"
            )
    # Label and metadata only: reading no frame costs nothing.
    empty = {name: as_texts(read_rows(dataset, 0, 0)) for name, dataset in datasets.items()}
    head = recording_from_fields(path, empty, texts)
    return _Content(head, datasets, checksums, num_frames, texts)


def _read(path: Path, content: _Content, max_bytes: int | None) -> Recording:
    num_frames, datasets, checksums = content.num_frames, content.datasets, content.checksums
    sized = datasets if checksums is None else {**datasets, FRAMES: checksums}
    limit = check_sizes(path, sized, num_frames, max_bytes)
    stored = {name: read_rows(dataset, num_frames, limit) for name, dataset in datasets.items()}
    if checksums is not None:
        check_frames(path, stored, checksums[:num_frames])
    arrays = {name: as_texts(array) for name, array in stored.items()}
    return recording_from_fields(path, arrays, content.texts)


def _joined(before: Recording, after: Recording) -> Recording:
    return Recording(
        time=np.concatenate([before.time, after.time]),
        tactile=np.concatenate([before.tactile, after.tactile]),
        joint=None
        if before.joint is None or after.joint is None
        else np.concatenate([before.joint, after.joint]),
        label=before.label,
        meta=before.meta,
        privileged=_joined_rows(before.privileged, after.privileged),
        extra=_joined_rows(before.extra, after.extra),
    )


def _joined_rows(
    before: Mapping[str, np.ndarray], after: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    return {
        name: np.concatenate([value, after[name]])
        if value.dtype.kind == "U"
        else np.concatenate([value, after[name]], dtype=value.dtype)
        for name, value in before.items()
    }


def _check_continues(path: Path, content: _Content, recording: Recording) -> None:
    head, datasets, num_frames = content.head, content.datasets, content.num_frames
    arrays = recording_to_arrays(recording)
    if arrays.keys() != datasets.keys():
        raise ValueError(
            f"'recording' must hold {sorted(datasets)}, as '{path}' does (got {sorted(arrays)})"
        )
    for name, array in arrays.items():
        shape = datasets[name].shape[1:]
        if array.shape[1:] != shape:
            raise ValueError(
                f"'{name}' must have frames of shape {shape}, as '{path}' has "
                f"(got {array.shape[1:]})"
            )
        text = datasets[name].dtype.kind in "SO"
        if text != (array.dtype.kind == "U") or not (
            text or np.can_cast(array.dtype, datasets[name].dtype, "same_kind")
        ):
            raise ValueError(
                f"'{name}' must be of type {'text' if text else datasets[name].dtype}, as "
                f"'{path}' has (got {array.dtype})"
            )
    if recording.label is not None and recording.label != head.label:
        raise ValueError(
            f"'label' must be {head.label!r}, as '{path}' has (got {recording.label!r})"
        )
    unit, expected = recording.meta.get("unit"), head.meta.get("unit")
    if unit is not None and unit != expected:
        raise ValueError(f"'unit' must be {expected!r}, as '{path}' has (got {unit!r})")
    if num_frames and recording.num_frames:
        last = float(datasets["time"][num_frames - 1])
        if recording.time[0] <= last:
            raise ValueError(
                f"'time' must go on after {last} s, the last frame of '{path}' "
                f"(got {float(recording.time[0])} s)"
            )
