r"""Reading of presses from one folder per letter."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._texts import read_json, short_list
from torch_geometric_tactile.io._matrix_files import read_matrices

SIMULATION = "simulation.json"
LAYOUT = "layout.json"
_DATASET_FOLDERS = ("raw", "processed")  # never letters
_ROUNDING = 1e-6  # as a fraction of full scale
_MAX_LISTED_FOLDERS = 10


class Presses(NamedTuple):
    r"""The presses of a file.

    Shapes:
        - **grey:** Readings as fractions of full scale :math:`(n, N)`.
    """

    grey: np.ndarray
    letter: int
    names: list[str]
    file: str


def letter_folder(root: Path) -> Path:
    r"""Returns the folder of the letters: :obj:`root/raw` if it exists, else :obj:`root`. An empty
    :obj:`root/raw` is ignored if :obj:`root` itself has folders.
    """
    inner = root / "raw"
    return inner if inner.is_dir() and (folders(inner) or not folders(root)) else root


def folders(folder: Path) -> list[str]:
    r"""Returns the sorted names of the folders in a folder, without hidden ones."""
    if not folder.is_dir():
        return []
    names = [path.name for path in folder.iterdir() if path.is_dir()]
    return sorted(n for n in names if not n.startswith(".") and n not in _DATASET_FOLDERS)


def letter_files(folder: Path, letters: Sequence[str]) -> list[str]:
    r"""Returns the sorted names of the files of all letters, without hidden ones."""
    names = []
    for letter in letters:
        if (folder / letter).is_dir():
            letter_names = sorted(path.name for path in (folder / letter).iterdir())
            names += [f"{letter}/{name}" for name in letter_names if not name.startswith(".")]
    return names


def check_folders(folder: Path, letters: Sequence[str]) -> None:
    r"""Checks that there is a folder for each letter, and no other folder."""
    names = folders(folder)
    missing = [letter for letter in letters if letter not in names]
    unknown = [name for name in names if name not in letters]
    if missing or unknown:
        problems = [
            f"{problem}: {short_list(listed, _MAX_LISTED_FOLDERS, repr, ', ... and {} more')}"
            for problem, listed in (("missing", missing), ("unknown", unknown))
            if listed
        ]
        raise ValueError(
            f"'{folder}' must have a folder for each of the {len(letters)} letters, and no other "
            f"(got {len(names)} folders; {'; '.join(problems)}): add or remove them, or name other "
            "classes by letters=[...]"
        )


def is_synthetic(folder: Path) -> bool:
    r"""Returns whether the presses are simulated, by :obj:`"synthetic"` in the file
    :obj:`simulation.json`.
    """
    path = folder / SIMULATION
    if not path.exists():
        return False
    try:
        content = read_json(path)
        if not isinstance(content, dict):
            raise ValueError(f"it must hold an object (got {type(content).__name__})")
        synthetic = content.get("synthetic", False)
        if not isinstance(synthetic, bool):
            raise ValueError(f"'synthetic' must be true or false (got {synthetic!r})")
    except ValueError as error:
        raise ValueError(f"'{path}' cannot be read: {error}") from error
    return synthetic


def read_presses(
    folder: Path,
    letters: Sequence[str],
    size: Sequence[int],
    full_scale: float,
    leave_out: Callable[[str], None],
    variable: str | None = None,
) -> Iterator[Presses]:
    r"""Yields the presses of each file, in order. Invalid files and matrices are left out, and
    :obj:`leave_out` is called with the reason for each.
    """
    for file in letter_files(folder, letters):
        path = folder / file
        try:
            matrices = read_matrices(path, size, variable)
        except (ValueError, OSError) as error:
            leave_out(str(error).replace(str(path), file))
            continue
        grey, faults = grey_values(matrices, full_scale)
        single = len(grey) == 1
        names = [file if single else f"{file}, matrix {i}" for i in range(len(grey))]
        for i, fault in faults.items():
            leave_out(f"'{file}'{fault}" if single else f"'{file}', matrix {i}{fault}")
        valid = [i for i in range(len(grey)) if i not in faults]
        if valid:
            letter = letters.index(file.split("/", 1)[0])
            rows = grey.reshape(len(grey), -1)[valid]
            yield Presses(rows, letter, [names[i] for i in valid], file)


def grey_values(matrices: np.ndarray, full_scale: float) -> tuple[np.ndarray, dict[int, str]]:
    r"""Returns readings as fractions of full scale, and the faults of matrices by their index.

    Numbers of type uint8 and uint16 are fractions of the highest number of their type; others are
    pressures.

    Shapes:
        - **matrices:** The numbers :math:`(n, \ldots)`.
        - **output:** fractions from 0 to 1 :math:`(n, \ldots)`
    """
    if matrices.dtype in (np.uint8, np.uint16):
        return (matrices / np.float32(np.iinfo(matrices.dtype).max)).astype(np.float32), {}
    fraction = matrices / full_scale
    is_invalid = ~((fraction >= 0) & (fraction <= 1 + _ROUNDING))  # NaN is invalid as well
    faults = {}
    for i in np.flatnonzero(is_invalid.reshape(len(fraction), -1).any(axis=1)).tolist():
        place = tuple(np.argwhere(is_invalid[i])[0].tolist())
        value = matrices[i][place]
        place_text = "row {}, column {}" if len(place) == 2 else "taxel {}"
        if np.isnan(value):
            fault = "has no reading (NaN)"
        elif value < 0:
            fault = f"has a negative pressure ({value:g})"
        else:
            fault = f"is above the full scale of {full_scale:g} (got {value:g})"
        faults[i] = f": {place_text.format(*place)} {fault}"
    return np.clip(fraction, 0, 1).astype(np.float32), faults
