r"""Reading and writing of :func:`torch.save` files, which may be damaged or untrusted."""

import ctypes
import io
import json
import logging
import mmap as maps
import os
import pickle
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, check_zip
from torch_geometric_tactile._typing import PathLike

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_ALWAYS_CHECKED_BYTES = 2**24  # smaller files are verified whenever they are opened
# A file that was changed less than this many nanoseconds ago may change again without a new time
# stamp.
_TIMESTAMP_RESOLUTION = 100_000_000
_MAX_VALUES = 1_000_000
_logger = logging.getLogger(__name__)


def write_torch_file(content: Any, path: PathLike, *, check: bool = False) -> None:
    r"""Writes a :func:`torch.save` file. If writing fails, no partial file is left.

    Args:
        content (Any): The object to save.
        path (str or PathLike): The file.
        check (bool): Whether to verify the checksums of the file after writing.
    """
    with atomic_path(path) as temporary:
        with _Writer(io.FileIO(temporary, "w")) as file:
            try:
                torch.save(content, file)
            except RuntimeError:  # torch raises this in place of an OSError, such as a full disk
                if file.write_error is not None:
                    raise file.write_error from None
                raise
        if check:
            check_zip(temporary)


class _Writer(io.BufferedWriter):
    write_error: OSError | None = None

    def write(self, data: "ReadableBuffer", /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.write_error = error
            raise


def read_torch_file(
    path: PathLike, map_location: Any = "cpu", *, mmap: bool = False, once: bool = False
) -> Any:
    r"""Reads plain data and tensors from a :func:`torch.save` file after verifying its checksums.
    No code in the file is run. Quantized tensors, and tensors that claim more memory than the file
    stores, are rejected.

    Args:
        path (str or PathLike): The file.
        map_location (Any): The device of the tensors, as in :func:`torch.load`.
        mmap (bool): Whether to map the tensors into memory without reading them.
        once (bool): Whether to verify a large file only if it has changed, see :func:`check_once`.

    Raises:
        OSError: If the file cannot be opened.
        ValueError: If the file is damaged, or holds anything other than plain data and tensors.
    """
    if once:
        check_once(path)
    else:
        check_zip(path)
    try:
        if mmap:
            content = load_mapped(path, map_location)
        else:
            content = torch.load(path, map_location=map_location, weights_only=True)
    except OSError:
        raise
    except pickle.UnpicklingError as error:  # its text advises loading the file without protection
        raise ValueError(f"'{path}' must hold plain data and tensors only") from error
    except Exception as error:  # torch raises errors of many types for damaged files
        raise ValueError(f"'{path}' cannot be read: {type(error).__name__}: {error}") from error
    with zipfile.ZipFile(path) as archive:
        stored_bytes = sum(e.file_size for e in archive.infolist() if "/data/" in e.filename)
    _check_tensors(content, path, stored_bytes)
    return content


def check_once(path: PathLike) -> None:
    r"""Verifies the checksums of a :func:`torch.save` file. A large file is only verified if it has
    changed since the last time; its size, time and inode are recorded in a file beside it.

    Raises:
        ValueError: If the file is damaged.
    """
    stat = os.stat(path)
    if stat.st_size <= _ALWAYS_CHECKED_BYTES:
        check_zip(path)
        return
    state = {"size": stat.st_size, "mtime_ns": stat.st_mtime_ns, "inode": stat.st_ino}
    mark = mark_path(path)
    try:
        if json.loads(mark.read_text(encoding="utf-8")) == state:
            return
    except (OSError, ValueError, RecursionError):  # the record is missing or damaged
        pass
    check_zip(path)
    if time.time_ns() - stat.st_mtime_ns < _TIMESTAMP_RESOLUTION:
        return
    try:
        with atomic_path(mark) as temporary:
            temporary.write_text(json.dumps(state), encoding="utf-8")
    except OSError:  # the folder is read-only: the file is verified again the next time
        pass


def mark_path(path: PathLike) -> Path:
    r"""Returns the path of the file in which :func:`check_once` records a verified file."""
    return Path(f"{path}.checked")


def load_mapped(path: PathLike, map_location: Any = "cpu") -> Any:
    r"""Loads a :func:`torch.save` file memory-mapped, like :obj:`torch.load(path, mmap=True)`.

    PyTorch maps a file so that tensors can be written to without changing the file. The operating
    system reserves memory for such a mapping, and refuses it if the file is larger than memory or
    than a limit of the process (:obj:`ulimit -d`). In this case, the file is mapped read-only, and
    writing to a tensor in place would end the process.
    """
    try:
        return torch.load(path, map_location=map_location, mmap=True, weights_only=True)
    except RuntimeError as error:
        if "unable to mmap" not in str(error) or not hasattr(maps, "MAP_SHARED"):
            raise
    content = _load_shared(path, map_location)
    _logger.info("'%s' is larger than memory and is therefore mapped read-only", path)
    return content


def _load_shared(path: PathLike, map_location: Any) -> Any:
    # A shared mapping needs no reserved memory. A write to it would change the file, so the mapping
    # is protected.
    default_options: Any = torch.serialization.get_default_mmap_options()
    torch.serialization.set_default_mmap_options(maps.MAP_SHARED)
    try:
        content = torch.load(path, map_location=map_location, mmap=True, weights_only=True)
    finally:
        torch.serialization.set_default_mmap_options(default_options)
    for value in _nested_values(content):
        if _is_strided(value) and value.device.type == "cpu" and value.numel():
            storage = value.untyped_storage()
            _protect(storage.data_ptr(), storage.nbytes())
    return content


def _protect(address: int, size: int) -> None:
    start = address - address % maps.PAGESIZE  # mprotect only accepts complete pages
    libc = ctypes.CDLL(None, use_errno=True)
    pointer, length = ctypes.c_void_p(start), ctypes.c_size_t(address + size - start)
    if libc.mprotect(pointer, length, maps.PROT_READ):
        raise OSError(ctypes.get_errno(), "a mapped file cannot be made read-only")


def tensor_form(value: Any) -> str:
    r"""Returns a description, for error messages, of a value that should be a dense tensor: its
    shape and type, or the kind of tensor or object.

    Examples:
        >>> tensor_form(torch.zeros(2, 3))
        'shape (2, 3) of float32'
        >>> tensor_form(torch.zeros(2, 3).to_sparse())
        'a sparse_coo tensor'
    """
    if not isinstance(value, Tensor):
        return type(value).__name__
    if value.is_nested:
        return "a nested tensor"
    if value.layout != torch.strided:
        return f"a {str(value.layout).removeprefix('torch.')} tensor"
    kind = str(value.dtype).removeprefix("torch.")
    if value.is_quantized:
        return f"a quantized tensor of {kind}"
    return f"shape {tuple(value.shape)} of {kind}"


def _check_tensors(content: Any, path: PathLike, stored_bytes: int) -> None:
    # A view with stride 0 can claim any size, and a copy would take this much memory. A storage
    # that is longer than its part of the file would be read beyond the end of this part.
    storages: dict[int, int] = {}
    for number, value in enumerate(_nested_values(content), 1):
        if number > _MAX_VALUES:
            raise ValueError(f"'{path}' must hold at most {_MAX_VALUES} values")
        if not _is_strided(value):
            continue
        if value.is_quantized:  # NumPy and most PyTorch operations reject it
            raise ValueError(f"'{path}' must hold plain numbers (got {tensor_form(value)})")
        size = value.numel() * value.element_size()
        storage_bytes = 0 if value.is_meta else value.untyped_storage().nbytes()
        if storage_bytes:
            storages[value.untyped_storage().data_ptr()] = storage_bytes
        if size > storage_bytes:
            raise ValueError(
                f"'{path}' must hold the {size} bytes of its tensor, {tensor_form(value)} (got "
                f"{storage_bytes})"
            )
    storage_bytes = sum(storages.values())
    need(
        storage_bytes <= stored_bytes,
        f"'{path}' must hold the {storage_bytes} bytes of its tensors",
        stored_bytes,
    )


def _nested_values(content: Any) -> Iterator[Any]:
    # Yields a value and all values within it. Uses a stack, since deep nesting would exceed the
    # recursion limit.
    stack = [content]
    while stack:
        value = stack.pop()
        yield value
        if isinstance(value, dict):
            stack.extend(value.values())
        elif isinstance(value, list | tuple):
            stack.extend(value)


def _is_strided(value: Any) -> bool:
    return isinstance(value, Tensor) and value.layout == torch.strided
