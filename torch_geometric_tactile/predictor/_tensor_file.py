r"""Named tensors and texts in one file, in the format of safetensors: eight bytes with the length
of a JSON header, the header, and the numbers. Nothing in such a file can run.

One of the texts is the SHA-256 of the whole file, taken with zeros in its own place.
"""

import hashlib
import hmac
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.predictor.missing_own_error import MissingOwnError

_DTYPES = {
    "F64": torch.float64,
    "F32": torch.float32,
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "I64": torch.int64,
    "I32": torch.int32,
    "I16": torch.int16,
    "I8": torch.int8,
    "U8": torch.uint8,
    "BOOL": torch.bool,
}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}
_METADATA = "__metadata__"
_CHECKSUM = "torch_geometric_tactile.sha256"
_ZEROS = "0" * 64
_MAX_HEADER = 100_000_000  # bytes, the limit of safetensors


class TensorFile(NamedTuple):
    r"""The contents of a file."""

    tensors: dict[str, Tensor]
    texts: dict[str, str]
    has_checksum: bool


def write_tensors(
    tensors: Mapping[str, Tensor], metadata: Mapping[str, str], path: PathLike
) -> None:
    r"""Writes tensors and texts to a file, whole or not at all."""
    header: dict[str, Any] = {_METADATA: {_CHECKSUM: _ZEROS, **metadata}}
    parts, end = [], 0
    # Widest numbers first, so that each tensor begins at a multiple of its own width.
    for name in sorted(tensors, key=lambda name: -tensors[name].element_size()):
        tensor = tensors[name].detach().cpu().contiguous()
        if tensor.dtype not in _NAMES or tensor.layout != torch.strided:
            raise ValueError(
                f"'{name}' must be a dense tensor of {', '.join(map(str, _NAMES))} "
                f"(got {tensor.dtype}, {tensor.layout})"
            )
        begin, end = end, end + tensor.numel() * tensor.element_size()
        header[name] = {
            "dtype": _NAMES[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [begin, end],
        }
        parts.append(tensor)
    text = json.dumps(header, allow_nan=False).encode()
    text += b" " * (-len(text) % 8)
    head = len(text).to_bytes(8, "little") + text
    numbers = [tensor.flatten().view(torch.uint8).numpy().data for tensor in parts]
    checksum = hashlib.sha256(head)
    for part in numbers:
        checksum.update(part)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(head.replace(_fragment(_ZEROS), _fragment(checksum.hexdigest()), 1))
        for part in numbers:
            file.write(part)


def _fragment(checksum: str) -> bytes:
    return json.dumps({_CHECKSUM: checksum})[1:-1].encode()


def _check(checksum: str, head: bytes, data: bytes | bytearray) -> None:
    found = hashlib.sha256(head.replace(_fragment(checksum), _fragment(_ZEROS), 1))
    found.update(data)
    if not hmac.compare_digest(found.hexdigest().encode(), checksum.encode()):
        raise ValueError("it differs from its checksum: it is damaged, copy or write it again")


def read_tensors(path: PathLike) -> TensorFile:
    r"""Returns the tensors and texts of a file, after its checksum was compared if it has one. It
    never asks for more memory than the file has bytes, whatever sizes its header claims.
    """
    path = Path(path)
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(8)
        length = int.from_bytes(start, "little")
        need(size >= 8 and length <= min(size - 8, _MAX_HEADER), f"it has no header ({size} bytes)")
        try:
            text = file.read(length)
            header = json.loads(text.decode())
        except (ValueError, RecursionError) as error:
            raise ValueError(f"its header is no JSON ({error})") from error
        if not isinstance(header, dict):
            raise ValueError(f"its header must be a JSON object (got {type(header).__name__})")
        data = bytearray(size - 8 - length)
        file.readinto(data)
    metadata = header.pop(_METADATA, {})
    if not isinstance(metadata, dict) or not all(isinstance(v, str) for v in metadata.values()):
        raise ValueError("its metadata must be texts")
    checksum = metadata.pop(_CHECKSUM, None)
    if checksum is not None:
        _check(checksum, start + text, data)
    tensors = {name: _tensor(name, entry, data) for name, entry in header.items()}
    used = sum(tensor.numel() * tensor.element_size() for tensor in tensors.values())
    need(used == len(data), f"its tensors must fill it ({used} of {len(data)} bytes)")
    return TensorFile(tensors, metadata, checksum is not None)


def _tensor(name: str, entry: Any, data: bytearray) -> Tensor:
    if not isinstance(entry, dict):
        raise ValueError(f"'{name}' must have a JSON object in its header")
    dtype = _DTYPES.get(str(entry.get("dtype")))
    shape, offsets = entry.get("shape"), entry.get("data_offsets")
    if dtype is None or not _are_sizes(shape) or not _are_sizes(offsets) or len(offsets) != 2:
        raise ValueError(f"'{name}' must have a dtype, a shape and offsets (got {entry})")
    begin, end = offsets
    width = torch.empty((), dtype=dtype).element_size()
    if end > len(data) or end - begin != math.prod(shape) * width:
        raise ValueError(
            f"'{name}' of shape {tuple(shape)} must have its {math.prod(shape) * width} bytes in "
            f"the file (got {begin} to {end} of {len(data)}); it is damaged or truncated"
        )
    if begin == end:
        return torch.empty(shape, dtype=dtype)
    raw = torch.frombuffer(data, dtype=torch.uint8, count=end - begin, offset=begin)
    if dtype == torch.bool:
        return (raw != 0).view(shape)
    # Not a view of the buffer, where it may begin at any byte.
    return raw.clone().view(dtype).view(shape)


def _are_sizes(value: Any) -> TypeGuard[list[int]]:
    return isinstance(value, list) and all(type(item) is int and item >= 0 for item in value)


class explained:  # noqa: N801
    r"""Makes one error that names the file of whatever a damaged or hostile one breaks."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, MissingOwnError):
            raise MissingOwnError(f"{self.text}: {error}", error.argument) from error
        if isinstance(error, Exception) and not isinstance(error, OSError):
            text = str(error) if isinstance(error, ValueError) else f"{kind.__name__}: {error}"
            raise ValueError(f"{self.text}: {text}") from error
