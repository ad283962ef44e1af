r"""Reads and writes files of processed samples."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import remove_leftovers
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._torch_file import read_torch_file, write_torch_file
from torch_geometric_tactile.data.static_data import StaticData

FORMAT = 3
_ADVICE = "delete it or pass 'force_reload=True' to process the raw files again"


class OtherFormatError(ValueError):
    r"""Raised for a processed file of another version of this package or of another library."""


class ProcessedFile(NamedTuple):
    r"""The contents of a processed file."""

    data: StaticData
    names: dict[str, list[str]]
    settings: dict[str, str]
    raw_state: list[str]


def save_static(
    data: StaticData,
    names: Mapping[str, list[str]],
    path: PathLike,
    settings: Mapping[str, str] | None = None,
    raw_state: Sequence[str] = (),
) -> None:
    r"""Writes samples to a processed file. If writing fails, no partial file is left.

    Args:
        data (StaticData): The samples.
        names (Mapping of str to list of str): The names of classes, groups and other attributes.
        path (str or PathLike): The file.
        settings (Mapping of str to str, optional): The settings of the data set.
        raw_state (sequence of str): The state of the raw files.
    """
    attributes: dict[str, Any] = {}
    for key, value in data.to_dict().items():
        attributes[key] = value.clone() if _is_view(value) else value
    content = {
        "format": FORMAT,
        "attributes": attributes,
        "schema": data.schema,
        "names": dict(names),
        "settings": dict(settings or {}),
        "raw_state": list(raw_state),
    }
    if "x" not in data:
        content["num_samples"] = data.num_samples
    write_torch_file(content, path, check=True)


def _is_view(value: Any) -> bool:
    # torch.save writes the complete storage of a view, so views are copied first. Other tensors are
    # not copied, since the copy may not fit into memory.
    if not isinstance(value, Tensor):
        return False
    if type(value) is not Tensor or value.layout != torch.strided:
        return True
    return value.untyped_storage().nbytes() != value.numel() * value.element_size()


def read_processed(path: PathLike) -> ProcessedFile:
    r"""Reads a processed file, memory-mapped, and removes temporary files that killed processes
    left beside it. The checksums are verified first; in a large file, only if the file has changed
    since the last time.

    Raises:
        OtherFormatError: If the file has a different format.
        ValueError: If the file is empty or damaged.
    """
    remove_leftovers(path)
    need(Path(path).stat().st_size != 0, f"processed file '{path}' is empty; {_ADVICE}")
    try:
        content = read_torch_file(path, mmap=True, once=True)
    except ValueError as error:
        raise ValueError(f"processed file '{path}' cannot be read; {_ADVICE} ({error})") from error
    if not isinstance(content, dict) or repr(content.get("format")) != repr(FORMAT):
        raise OtherFormatError(f"processed file '{path}' is not in format {FORMAT}; {_ADVICE}")
    try:
        return _to_processed_file(content)
    except Exception as error:  # values of unexpected types may raise any error
        raise ValueError(
            f"processed file '{path}' holds no samples ({type(error).__name__}: {error}); {_ADVICE}"
        ) from error


def _to_processed_file(content: Mapping[str, Any]) -> ProcessedFile:
    num_samples = content.get("num_samples")  # only stored for samples without readings
    data = StaticData(**content["attributes"], **content["schema"], num_samples=num_samples)
    lacks_x = "x" not in data and num_samples is not None
    if not (lacks_x or (isinstance(data.x, Tensor) and data.x.is_floating_point())):
        raise ValueError("'x' must be a tensor of numbers (S, N, ...)")
    names, settings, raw_state = (content[key] for key in ("names", "settings", "raw_state"))
    if not _are_texts(raw_state) or not all(_are_texts(value) for value in names.values()):
        raise ValueError("names must be lists of texts")
    need(_are_texts([*names, *settings, *settings.values()]), "settings must be texts")
    return ProcessedFile(data, names, settings, raw_state)


def _are_texts(values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
