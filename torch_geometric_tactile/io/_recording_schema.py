r"""Names, versions and checks of recordings in HDF5 and npz files.

=====================  ====================================================================
``format``             :obj:`"tactile recording"`
``version``            1
``time``               seconds, float64 :math:`(T,)`
``tactile``            readings, float32 :math:`(T, N, C)`, NaN if missing
``joint``              radians, float32 :math:`(T, J)`; absent without joint angles
``action``             commands, float32 :math:`(T, A)`; absent without commands
``privileged/<name>``  signals known only in simulation, :math:`(T, ...)`
``extra/<name>``       further signals, :math:`(T, ...)`
``label``              JSON text: a string, an integer or null
``meta``               JSON text: an object
``annotations``        JSON text: a list of [start, end, label]; absent if empty
=====================  ====================================================================
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording

FORMAT = "tactile recording"
VERSION = 1
PRIVILEGED = "privileged/"
EXTRA = "extra/"
GROUPS = (PRIVILEGED, EXTRA)


def recording_path(path: PathLike) -> Path:
    r"""Returns the path of a recording, and raises an error if there is no such file."""
    return existing_file(path, "give the path of a recording")


def new_recording(path: Path, **content: Any) -> Recording:
    r"""Returns a recording with the content of a file, whose path is added to errors."""
    try:
        return Recording(**content)
    except ValueError as error:
        raise ValueError(f"'{path}': {error}") from error


def recording_to_arrays(recording: Recording) -> dict[str, np.ndarray]:
    r"""Returns the arrays of a recording by their names in a file."""
    arrays = {"time": recording.time, "tactile": recording.tactile}
    if recording.joint is not None:
        arrays["joint"] = recording.joint
    if recording.action is not None:
        arrays["action"] = recording.action
    arrays |= {PRIVILEGED + name: value for name, value in recording.privileged.items()}
    return arrays | {EXTRA + name: value for name, value in recording.extra.items()}


def recording_to_texts(recording: Recording) -> dict[str, str]:
    r"""Returns label, metadata and annotations of a recording as JSON texts by their names in a
    file.
    """
    values: dict[str, Any] = {"label": recording.label, "meta": dict(recording.meta)}
    if recording.annotations:
        values["annotations"] = recording.annotations
    return {name: json.dumps(value, ensure_ascii=False) for name, value in values.items()}


def check_version(path: Path, version: Any) -> None:
    r"""Raises an error unless this package can read the version of a file."""
    # Without the check for bool, True would pass as version 1.
    is_integer = isinstance(version, int | np.integer) and not isinstance(version, bool)
    if not is_integer or version != VERSION:
        raise ValueError(
            f"'{path}' must be of format version {VERSION} (got {version}): read it with the "
            "version of torch-geometric-tactile that wrote it"
        )


def recording_from_fields(
    path: Path, arrays: Mapping[str, np.ndarray], texts: Mapping[str, Any]
) -> Recording:
    r"""Returns a recording from the arrays and JSON texts in a file.

    Raises:
        ValueError: If a field is missing or invalid. The message names the file.
    """
    for name in ("time", "tactile"):
        if name not in arrays:
            raise missing_field(path, name)
    for name in ("time", "tactile", "joint", "action"):
        if name in arrays and arrays[name].dtype.kind == "b":
            raise ValueError(f"'{path}' must hold numbers in '{name}' (got booleans)")
    values = {}
    for name in ("label", "meta", "annotations"):
        if name not in texts and name != "annotations":
            raise missing_field(path, name)
        try:
            values[name] = json.loads(texts.get(name, "[]"))
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"'{path}' must hold JSON in '{name}' ({error})") from error
    try:
        return Recording(
            time=arrays["time"],
            tactile=arrays["tactile"],
            joint=arrays.get("joint"),
            label=values["label"],
            meta=values["meta"],
            privileged=_arrays_of_group(arrays, PRIVILEGED),
            extra=_arrays_of_group(arrays, EXTRA),
            annotations=values["annotations"],
            action=arrays.get("action"),
        )
    except ValueError as error:
        raise ValueError(
            f"'{path}' does not hold a consistent recording: {error}; write it again"
        ) from error


def _arrays_of_group(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {
        name.removeprefix(prefix): array
        for name, array in arrays.items()
        if name.startswith(prefix)
    }


def missing_field(path: Path, name: str) -> ValueError:
    r"""Returns the error for a file that lacks a field."""
    return ValueError(
        f"'{path}' must hold '{name}' to be a recording (got none): write it with "
        "torch_geometric_tactile.io.write_recording"
    )
