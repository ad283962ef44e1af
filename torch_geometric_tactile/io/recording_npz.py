r"""Recordings as npz files, which need numpy only. Names as in
:mod:`~torch_geometric_tactile.io.recording_schema`; texts are arrays without dimensions. Nothing is
pickled.
"""

import zipfile
import zlib
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.io.recording_schema import (
    FORMAT,
    VERSION,
    check_version,
    checked_file,
    recording_from_fields,
    recording_to_arrays,
    recording_to_texts,
)
from torch_geometric_tactile.typing import PathLike

_TEXTS = ("format", "version", "label", "meta")


def write_npz(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a compressed npz file that is either whole or absent.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.
    """
    content: dict[str, Any] = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        **{name: np.array(text) for name, text in recording_to_texts(recording).items()},
        **recording_to_arrays(recording),
    }
    # An open file keeps numpy from adding '.npz' to the temporary name.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **content)


def read_npz(path: PathLike) -> Recording:
    r"""Reads a recording from an npz file.

    Args:
        path (str or PathLike): A file as :meth:`write_npz` writes it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no npz file, cut or damaged, holds pickled objects, lacks
            something, or is of another version. The message names the file.
    """
    path = checked_file(path)
    if not zipfile.is_zipfile(path):
        raise ValueError(f"'{path}' is no whole npz file (is it cut?): copy or write it again")
    try:
        with np.load(path, allow_pickle=False) as file:
            content = {name: file[name] for name in file.files}
    except (
        ValueError,
        EOFError,
        OSError,
        KeyError,
        RuntimeError,  # encrypted; NotImplementedError: another version or compression of zip
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(
            f"'{path}' cannot be read as npz: {error}; copy or write it again"
        ) from error
    strange = [name for name, value in content.items() if not isinstance(value, np.ndarray)]
    texts = {
        name: content.pop(name).item()
        for name in _TEXTS
        if name in content and name not in strange and content[name].ndim == 0
    }
    if strange or texts.get("format") != FORMAT:
        raise ValueError(
            f"'{path}' must be a recording, with 'format' = '{FORMAT}' "
            f"(got an npz file with {sorted({*content, *texts})[:5]})"
        )
    check_version(path, texts.get("version"))
    return recording_from_fields(path, content, texts)
