r"""Files with named tensors and texts in the safetensors format: eight bytes with the length of a
JSON header, the header, and the numbers. Reading such a file runs no code from it.

One of the texts is the SHA-256 of the file, computed with zeros in place of the digest.
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
_MAX_HEADER_BYTES = 100_000_000  # bytes, the limit of safetensors


class TensorFile(NamedTuple):
    r"""The tensors and texts of a file, and whether it has a checksum."""

    tensors: dict[str, Tensor]
    texts: dict[str, str]
    has_checksum: bool


def write_tensors(
    tensors: Mapping[str, Tensor], metadata: Mapping[str, str], path: PathLike
) -> None:
    r"""Writes tensors and texts to a file. If writing fails, no partial file is left."""
    header: dict[str, Any] = {_METADATA: {_CHECKSUM: _ZEROS, **metadata}}
    dense_tensors, end = [], 0
    # The widest numbers come first, so that each tensor starts at a multiple of its number width.
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
        dense_tensors.append(tensor)
    header_text = json.dumps(header, allow_nan=False).encode()
    header_text += b" " * (-len(header_text) % 8)
    file_start = len(header_text).to_bytes(8, "little") + header_text
    byte_views = [tensor.flatten().view(torch.uint8).numpy().data for tensor in dense_tensors]
    checksum = hashlib.sha256(file_start)
    for tensor_bytes in byte_views:
        checksum.update(tensor_bytes)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(
            file_start.replace(_checksum_field(_ZEROS), _checksum_field(checksum.hexdigest()), 1)
        )
        for tensor_bytes in byte_views:
            file.write(tensor_bytes)


def _checksum_field(checksum: str) -> bytes:
    return json.dumps({_CHECKSUM: checksum})[1:-1].encode()


def _verify_checksum(checksum: str, head: bytes, body: bytes | bytearray) -> None:
    digest = hashlib.sha256(head.replace(_checksum_field(checksum), _checksum_field(_ZEROS), 1))
    digest.update(body)
    if not hmac.compare_digest(digest.hexdigest().encode(), checksum.encode()):
        raise ValueError("it differs from its checksum: it is damaged, copy or write it again")


def read_tensors(path: PathLike) -> TensorFile:
    r"""Reads the tensors and texts of a file, and verifies its checksum if there is one. Allocates
    no more memory than the size of the file, even if the header claims larger tensors.

    Raises:
        ValueError: If the file is damaged or has another format.
    """
    path = Path(path)
    size = path.stat().st_size
    with path.open("rb") as file:
        length_bytes = file.read(8)
        length = int.from_bytes(length_bytes, "little")
        need(
            size >= 8 and length <= min(size - 8, _MAX_HEADER_BYTES),
            f"it has no header ({size} bytes)",
        )
        try:
            header_text = file.read(length)
            header = json.loads(header_text.decode())
        except (ValueError, RecursionError) as error:
            raise ValueError(f"its header is not JSON ({error})") from error
        if not isinstance(header, dict):
            raise ValueError(f"its header must be a JSON object (got {type(header).__name__})")
        data = bytearray(size - 8 - length)
        file.readinto(data)
    metadata = header.pop(_METADATA, {})
    if not isinstance(metadata, dict) or not all(isinstance(v, str) for v in metadata.values()):
        raise ValueError("its metadata must be texts")
    checksum = metadata.pop(_CHECKSUM, None)
    if checksum is not None:
        _verify_checksum(checksum, length_bytes + header_text, data)
    tensors = {name: _read_tensor(name, entry, data) for name, entry in header.items()}
    num_used_bytes = sum(tensor.numel() * tensor.element_size() for tensor in tensors.values())
    need(
        num_used_bytes == len(data),
        f"its tensors must fill it ({num_used_bytes} of {len(data)} bytes)",
    )
    return TensorFile(tensors, metadata, checksum is not None)


def _read_tensor(name: str, entry: Any, data: bytearray) -> Tensor:
    if not isinstance(entry, dict):
        raise ValueError(f"'{name}' must have a JSON object in its header")
    dtype = _DTYPES.get(str(entry.get("dtype")))
    shape, offsets = entry.get("shape"), entry.get("data_offsets")
    if dtype is None or not _is_size_list(shape) or not _is_size_list(offsets) or len(offsets) != 2:
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
    # A copy is made, because a tensor in an unknown file may start at any byte of the buffer.
    return raw.clone().view(dtype).view(shape)


def _is_size_list(value: Any) -> TypeGuard[list[int]]:
    return isinstance(value, list) and all(type(item) is int and item >= 0 for item in value)


class named_file_errors:  # noqa: N801
    r"""A context manager that replaces any error of a damaged or malicious file by a
    :class:`ValueError` whose message starts with a text, such as the name of the file.

    Args:
        text (str): Start of the message.
    """

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
