r"""Recordings in a folder."""

from pathlib import Path

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._folder_tables import TABLES

#: The suffixes of recordings in a folder, which are the suffixes that can be written.
RECORDING_SUFFIXES = (".h5", ".hdf5", ".npz", ".mcap", ".csv", ".jsonl", ".ndjson")
_PROBE_FILES = ("sensor.csv", "states.csv")  # of a run of eFlesh's probe


def list_recordings(folder: PathLike, recursive: bool = False) -> list[Path]:
    r"""Returns the sorted paths of the recordings in a folder: files with a suffix of
    :func:`write_recording`, and folders with a run of eFlesh's probe, which may be the folder
    itself. Hidden files, ``annotations.csv`` and ``labels.csv`` are left out.

    Args:
        folder (str or PathLike): The folder.
        recursive (bool): Whether to search its subfolders as well, except ``processed``.
    """
    folder, paths = Path(folder), []
    if is_probe_run(folder):
        return [folder]
    for path in folder.rglob("*") if recursive else folder.iterdir():
        parts = path.relative_to(folder).parts
        if any(part.startswith(".") for part in parts) or parts[0] == "processed":
            continue
        if path.is_dir():
            is_recording = is_probe_run(path)
        else:
            is_recording = path.suffix.lower() in RECORDING_SUFFIXES and path.name not in TABLES
            is_recording &= not is_probe_run(path.parent)
        if is_recording:
            paths.append(path)
    return sorted(paths)


def is_probe_run(folder: Path) -> bool:
    r"""Returns whether a folder holds a run of eFlesh's probe, which is one recording."""
    return all((folder / name).is_file() for name in _PROBE_FILES)
