r"""Recordings as npz files, which need only NumPy. Strings are stored as arrays without dimensions.
Nothing is pickled.
"""

import json
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._npz_arrays import open_npz
from torch_geometric_tactile.io._recording_schema import (
    FORMAT,
    GROUPS,
    VERSION,
    check_version,
    recording_from_fields,
    recording_path,
    recording_to_arrays,
    recording_to_texts,
)

_TEXTS = ("format", "version", "arrays", "label", "meta", "annotations")


def write_npz(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a compressed npz file that is either complete or absent.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_npz(recording, f"{folder}/grasp.npz")
        ...     read_npz(f"{folder}/grasp.npz")
        Recording(num_frames=2, num_taxels=4, num_channels=3, rate=100)
    """
    arrays = recording_to_arrays(recording)
    content: dict[str, Any] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "arrays": np.array(json.dumps(sorted(arrays), ensure_ascii=False)),
        **{name: np.array(text) for name, text in recording_to_texts(recording).items()},
        **arrays,
    }
    # With an open file, NumPy does not add '.npz' to the temporary name.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **content)


def read_npz(path: PathLike, allow_large: bool = False) -> Recording:
    r"""Reads a recording from an npz file. Sizes are checked before memory is allocated, and all
    checksums are compared.

    Args:
        path (str or PathLike): A file written by :meth:`write_npz`.
        allow_large (bool): Whether to read a file whose arrays take more than 1 GiB and more than
            200 times its size, as in a hostile file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not an npz file, is truncated or damaged, holds pickled objects,
            would take far more memory than its size, or has a missing field, an unknown field or an
            unsupported version. The message names the file.

    Examples:
        >>> import tempfile
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 4, 3)), label="cup")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_npz(recording, f"{folder}/grasp.npz")
        ...     read_npz(f"{folder}/grasp.npz").label
        'cup'
    """
    path = recording_path(path)
    with open_npz(path, allow_large) as arrays:
        shapes = arrays.shapes
        texts = {
            name: arrays.read(name).item()
            for name in ("format", "version")
            if shapes.get(name) == ()
        }
        content, problem = {}, _find_problem(shapes)
        if not problem and texts == {"format": FORMAT, "version": VERSION}:
            content = {name: arrays.read(name) for name in shapes if name not in texts}
    if texts.get("format") != FORMAT:
        raise ValueError(
            f"'{path}' must be a recording, with 'format' = '{FORMAT}' "
            f"(got an npz file with {sorted(shapes)[:5]})"
        )
    check_version(path, texts.get("version"))
    need(not problem, f"'{path}' does not hold a consistent recording: {problem}; write it again")
    texts |= {name: content.pop(name).item() for name in _TEXTS if name in content}
    # Files of earlier versions have no list of arrays.
    listed_arrays = texts.pop("arrays", None)
    if listed_arrays not in (None, json.dumps(sorted(content), ensure_ascii=False)):
        raise ValueError(
            f"'{path}' does not hold a consistent recording: it must hold the arrays "
            f"{quoted(str(listed_arrays))} (got {sorted(content)}); write it again"
        )
    return recording_from_fields(path, content, texts)


def _find_problem(shapes: dict[str, tuple[int, ...]]) -> str:
    valid_names = {*_TEXTS, "time", "tactile", "joint", "action"}
    num_frames = shapes.get("time", ())[:1]
    for name, shape in shapes.items():
        if name not in valid_names and not name.startswith(GROUPS):
            groups = " and ".join(f"'{group}...'" for group in GROUPS)
            return f"it must hold only {sorted(valid_names)}, {groups} (got {name!r})"
        if name in _TEXTS and shape:
            return f"'{name}' must be one string (got shape {shape})"
        if name not in _TEXTS and num_frames and shape and shape[:1] != num_frames:
            return f"'{name}' must have {num_frames[0]} frames, as 'time' has (got {shape[0]})"
    return ""
