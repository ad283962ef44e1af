r"""The file in which processed samples are kept."""

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
_MEND = "delete it or pass 'force_reload=True' to process the raw files again"


class OtherFormatError(ValueError):
    r"""A processed file of another version of this package, or of another library."""


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
    r"""Writes samples to a file, whole or not at all."""
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
    # It would drag its whole storage into the file. Others need no copy, which may not fit.
    if not isinstance(value, Tensor):
        return False
    if type(value) is not Tensor or value.layout != torch.strided:
        return True
    return value.untyped_storage().nbytes() != value.numel() * value.element_size()


def read_processed(path: PathLike) -> ProcessedFile:
    r"""Reads a processed file, memory-mapped, after its checksums were compared: those of a large
    one only if it has changed since. Removes what killed processes left beside it.
    """
    remove_leftovers(path)
    need(Path(path).stat().st_size != 0, f"processed file '{path}' is empty; {_MEND}")
    try:
        content = read_torch_file(path, mmap=True, once=True)
    except ValueError as error:
        raise ValueError(f"processed file '{path}' cannot be read; {_MEND} ({error})") from error
    if not isinstance(content, dict) or repr(content.get("format")) != repr(FORMAT):
        raise OtherFormatError(f"processed file '{path}' is not in format {FORMAT}; {_MEND}")
    try:
        return _from_content(content)
    except Exception as error:  # whatever other types in place of these lead to
        raise ValueError(
            f"processed file '{path}' holds no samples ({type(error).__name__}: {error}); {_MEND}"
        ) from error


def _from_content(content: Mapping[str, Any]) -> ProcessedFile:
    num_samples = content.get("num_samples")  # of samples without readings
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
