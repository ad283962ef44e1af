r"""Kinds of files that commands write, recognized by their content."""

import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from torch_geometric_tactile._files import UNREADABLE
from torch_geometric_tactile._texts import read_json

_START_BYTES = 65_536
_PREDICTOR_KEYS = {"torch_geometric_tactile.predictor", "torch_geometric_tactile.sha256"}
_ONNX_KEY = b"torch_geometric_tactile"  # in the metadata at the end of the file
_MCAP_WRITER = b"torch_geometric_tactile"  # in the header of the file
_WIDE_CSV = re.compile(rb"time,(taxel|joint)_\d")
_XELA_MESSAGE = re.compile(rb'\{"message":')


class FileKind(NamedTuple):
    r"""A kind of file, and the test that recognizes it.

    Args:
        name (str): Name of the kind with its article, such as :obj:`"a predictor"`.
        is_kind (callable): Returns whether an existing file is of this kind.
    """

    name: str
    is_kind: Callable[[Path], bool]

    def matches(self, path: Path) -> bool:
        r"""Returns whether a file is of this kind. An empty file is of every kind."""
        try:
            return path.stat().st_size == 0 or self.is_kind(path)
        except UNREADABLE:  # damaged or unknown content, so not a file of this kind
            return False


def text_kind(name: str, start: str) -> FileKind:
    r"""Returns the kind of text files that start with a match of the regular expression
    :obj:`start`.
    """
    pattern = re.compile(start.encode())
    return FileKind(name, lambda path: pattern.match(_first_bytes(path)) is not None)


def _first_bytes(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_START_BYTES)


def _is_predictor(path: Path) -> bool:
    # A safetensors file: the length of the header in eight bytes, then the header as JSON.
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if length > path.stat().st_size - 8:  # files of other kinds have huge numbers here
            return False
        metadata = json.loads(file.read(length)).get("__metadata__", {})
    return not _PREDICTOR_KEYS.isdisjoint(metadata)


def _is_onnx(path: Path) -> bool:
    content = path.read_bytes()
    return content.startswith(b"\x08") and _ONNX_KEY in content  # 8: the tag of the first field


def _is_calibration(path: Path) -> bool:
    return {"coefficients", "reading_unit", "force_unit"} <= {*read_json(path)}


def _is_recording(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix in (".h5", ".hdf5"):
        return _is_hdf5_recording(path)
    if suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            return {"time.npy", "tactile.npy"} <= {*archive.namelist()}
    first_bytes = _first_bytes(path)
    if suffix == ".mcap":
        return first_bytes.startswith(b"\x89MCAP0\r\n") and _MCAP_WRITER in first_bytes[:200]
    return (_WIDE_CSV if suffix == ".csv" else _XELA_MESSAGE).match(first_bytes) is not None


def _is_hdf5_recording(path: Path) -> bool:
    if not _first_bytes(path).startswith(b"\x89HDF\r\n"):
        return False
    import h5py  # always installed here: writing the file needs it

    with h5py.File(path, locking=False) as file:
        return {"time", "tactile"} <= {*file}


PREDICTOR = FileKind("a predictor", _is_predictor)
ONNX_MODEL = FileKind("a model of 'tactile export'", _is_onnx)
CALIBRATION = FileKind("a calibration", _is_calibration)
RECORDING = FileKind("a recording", _is_recording)
PICTURE = FileKind(
    "a PNG picture", lambda path: _first_bytes(path).startswith(b"\x89PNG\r\n\x1a\n")
)
PREDICTIONS = text_kind("a table of predictions", r"(recording,frame,time|index)(,|\r?\n)")
