r"""Recordings as HDF5 files, which may grow frame by frame. Needs the extra ``io`` when a function
is called.

Names as in :mod:`~torch_geometric_tactile.io.recording_schema`: arrays are data sets whose first
dimension is resizable, and ``privileged`` is a group; ``format``, ``version``, ``label``, ``meta``
and ``num_frames`` are attributes of the file. Only the first ``num_frames`` rows count: an append
writes its rows first and that number last, so that what a kill left half done is not read.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.io.recording_schema import (
    FORMAT,
    PRIVILEGED,
    VERSION,
    check_version,
    checked_file,
    missing_field,
    recording_from_fields,
    recording_to_arrays,
    recording_to_texts,
)
from torch_geometric_tactile.typing import PathLike

_INSTALL = 'pip install "torch-geometric-tactile[io]"'
_VALUES_PER_CHUNK = 2**15
_MOST_FRAMES_PER_CHUNK = 512
_GZIP_LEVEL = 1  # counts shrink about as much as at 9, several times faster


def write_hdf5(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a compressed HDF5 file that is either whole or absent.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Raises:
        ImportError: If h5py is missing.
    """
    _write(recording, path, compress=True)


def read_hdf5(path: PathLike) -> Recording:
    r"""Reads a recording from an HDF5 file. Frames of an append that was killed are left out.

    Args:
        path (str or PathLike): A file as :meth:`write_hdf5` or :meth:`append_hdf5` writes it.

    Raises:
        ImportError: If h5py is missing.
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no HDF5 file, cut or damaged, lacks something, or is of another
            version. The message names the file.
        BlockingIOError: If another process writes the file.
    """
    path = checked_file(path)
    with _opened(path, "r") as file:
        _, datasets = _checked(path, file)
        num_frames = int(file.attrs["num_frames"])
        arrays = {name: _rows(dataset, num_frames) for name, dataset in datasets.items()}
        texts = {name: file.attrs[name] for name in ("label", "meta") if name in file.attrs}
    return recording_from_fields(path, arrays, texts)


def read_hdf5_head(path: PathLike) -> Recording:
    r"""Reads what an HDF5 file says about its recording, and none of its frames.

    Args:
        path (str or PathLike): A file as :meth:`write_hdf5` or :meth:`append_hdf5` writes it.

    Returns:
        Recording: One without frames, with label, metadata and the shapes of a frame.

    Raises:
        ImportError: If h5py is missing.
        FileNotFoundError: If there is no such file.
        ValueError: As :meth:`read_hdf5`.
    """
    path = checked_file(path)
    with _opened(path, "r") as file:
        head, _ = _checked(path, file)
    return head


def append_hdf5(recording: Recording, path: PathLike) -> None:
    r"""Adds frames to the end of an HDF5 file, which is made if missing.

    If the process is killed, the frames of earlier calls stay readable. A file that grows is not
    compressed: HDF5 moves a compressed block when it grows, and a kill in that moment would cost
    frames that were safe. A compressed file is therefore rewritten once, at the first append;
    :obj:`write_hdf5(read_hdf5(path), path)` compresses it when it is complete. HDF5 keeps no
    journal, so that a power failure may still damage a file that is open.

    Args:
        recording (Recording): The frames. Label and metadata of the file stay as they are.
        path (str or PathLike): The file.

    Raises:
        ImportError: If h5py is missing.
        ValueError: If the file cannot be read, or the frames do not go on from it: an earlier
            time, other shapes, another label or unit.
    """
    h5py = _h5py()
    path = Path(path)
    if not path.exists():
        _write(recording, path, compress=False)
        return
    with _opened(path, "r") as file:
        meta, datasets = _checked(path, file)
        _check_continues(path, file, datasets, recording, meta)
        compressed = any(dataset.compression for dataset in datasets.values())
    if recording.num_frames == 0:
        return
    if compressed:
        _write(read_hdf5(path), path, compress=False)
    with _opened(path, "r+") as file:
        start = int(file.attrs["num_frames"])
        end = start + recording.num_frames
        for name, array in recording_to_arrays(recording).items():
            dataset = file[name]
            dataset.resize(end, axis=0)
            dataset[start:end] = array.astype(h5py.string_dtype()) if _is_text(array) else array
        file.flush()
        # In place, where 'attrs[...] =' would delete the number before it writes the new one.
        file.attrs.modify("num_frames", np.int64(end))
        file.flush()


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise ImportError(f"HDF5 files need h5py: {_INSTALL}") from error
    return h5py


def _is_text(array: np.ndarray) -> bool:
    return array.dtype.kind == "U"


def _write(recording: Recording, path: PathLike, compress: bool) -> None:
    h5py = _h5py()
    packing = (
        {"compression": "gzip", "compression_opts": _GZIP_LEVEL, "shuffle": True}
        if compress
        else {}
    )
    with atomic_path(path) as temporary, h5py.File(temporary, "w", locking=False) as file:
        for name, array in recording_to_arrays(recording).items():
            values = max(1, int(np.prod(array.shape[1:])))
            frames = min(max(_VALUES_PER_CHUNK // values, 1), _MOST_FRAMES_PER_CHUNK)
            file.create_dataset(
                name,
                data=array.astype(h5py.string_dtype()) if _is_text(array) else array,
                maxshape=(None, *array.shape[1:]),
                chunks=(frames, *(max(1, size) for size in array.shape[1:])),
                # A row that is lost reads as missing, not as zero.
                fillvalue=np.nan if array.dtype.kind == "f" else None,
                **packing,
            )
        file.attrs["format"] = FORMAT
        file.attrs["version"] = VERSION
        for name, text in recording_to_texts(recording).items():
            file.attrs[name] = text
        file.attrs["num_frames"] = np.int64(recording.num_frames)


@contextmanager
def _opened(path: Path, mode: str) -> Iterator[Any]:
    h5py = _h5py()
    if not h5py.is_hdf5(path):
        raise ValueError(
            f"'{path}' is no HDF5 file (or its beginning is lost): copy it again, or give a file "
            "that torch_geometric_tactile.io.write_hdf5 wrote"
        )
    try:
        with h5py.File(path, mode) as file:
            yield file
    except BlockingIOError as error:
        raise BlockingIOError(
            f"'{path}' is locked by another process that writes it: close it there first"
        ) from error
    except PermissionError:
        raise
    except (OSError, RuntimeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise ValueError(
            f"'{path}' cannot be read as HDF5, is it cut or damaged? {error}; copy or record it "
            "again"
        ) from error


def _checked(path: Path, file: Any) -> tuple[Recording, dict[str, Any]]:
    h5py = _h5py()
    if file.attrs.get("format") != FORMAT:
        raise ValueError(
            f"'{path}' must be a recording, with the attribute 'format' = '{FORMAT}' "
            f"(got an HDF5 file with {sorted(file)[:5]})"
        )
    check_version(path, file.attrs.get("version"))
    for name in ("time", "tactile"):
        if name not in file:
            raise missing_field(path, name)
    for name in ("num_frames", "label", "meta"):
        if name not in file.attrs:
            raise missing_field(path, name)
    datasets = {name: file[name] for name in ("time", "tactile", "joint") if name in file}
    if "privileged" in file:
        datasets |= {PRIVILEGED + name: file[PRIVILEGED + name] for name in file["privileged"]}
    num_frames = file.attrs["num_frames"]
    for name, dataset in datasets.items():
        if not isinstance(dataset, h5py.Dataset) or dataset.ndim == 0:
            raise ValueError(f"'{path}' must hold an array in '{name}' (got {dataset})")
        if not 0 <= num_frames <= len(dataset):
            raise ValueError(
                f"'{path}' must have {num_frames} frames in '{name}', as 'num_frames' says "
                f"(got {len(dataset)}): copy or record it again"
            )
    # Label and metadata only: reading no frame costs nothing.
    empty = {name: _rows(dataset, 0) for name, dataset in datasets.items()}
    texts = {name: file.attrs[name] for name in ("label", "meta")}
    return recording_from_fields(path, empty, texts), datasets


def _rows(dataset: Any, num_frames: int) -> np.ndarray:
    h5py = _h5py()
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return np.asarray(dataset.asstr()[:num_frames], dtype=str)
    array: np.ndarray = dataset[:num_frames]
    return array


def _check_continues(
    path: Path, file: Any, datasets: dict[str, Any], recording: Recording, head: Recording
) -> None:
    h5py = _h5py()
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
        stored = h5py.check_string_dtype(datasets[name].dtype) is not None
        if stored != _is_text(array) or not (
            stored or np.can_cast(array.dtype, datasets[name].dtype, "same_kind")
        ):
            raise ValueError(
                f"'{name}' must be of type {'text' if stored else datasets[name].dtype}, as "
                f"'{path}' has (got {array.dtype})"
            )
    if recording.label is not None and recording.label != head.label:
        raise ValueError(
            f"'label' must be {head.label!r}, as '{path}' has (got {recording.label!r})"
        )
    unit, expected = recording.meta.get("unit"), head.meta.get("unit")
    if unit is not None and unit != expected:
        raise ValueError(f"'unit' must be {expected!r}, as '{path}' has (got {unit!r})")
    num_frames = int(file.attrs["num_frames"])
    if num_frames and recording.num_frames:
        last = float(datasets["time"][num_frames - 1])
        if recording.time[0] <= last:
            raise ValueError(
                f"'time' must go on after {last} s, the last frame of '{path}' "
                f"(got {float(recording.time[0])} s)"
            )
