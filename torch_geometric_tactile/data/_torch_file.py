r"""Files of :func:`torch.save` that may be damaged, or anyone's."""

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

_SMALL = 2**24  # bytes, up to which a file is checked whenever it is opened
_FRESH = 100_000_000  # nanoseconds within which a file may change without another time
_MAX_VALUES = 1_000_000
_logger = logging.getLogger(__name__)


def write_torch_file(content: Any, path: PathLike, *, check: bool = False) -> None:
    r"""Writes a file of :func:`torch.save`, whole or not at all."""
    with atomic_path(path) as temporary:
        with _Writer(io.FileIO(temporary, "w")) as file:
            try:
                torch.save(content, file)
            except RuntimeError:  # which torch makes of an error of the disk
                if file.refused is not None:
                    raise file.refused from None
                raise
        if check:
            check_zip(temporary)


class _Writer(io.BufferedWriter):
    refused: OSError | None = None

    def write(self, data: "ReadableBuffer", /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            self.refused = error
            raise


def read_torch_file(
    path: PathLike, map_location: Any = "cpu", *, mmap: bool = False, once: bool = False
) -> Any:
    r"""Reads plain data and tensors from a file of :func:`torch.save`, after its checksums were
    compared. Nothing in the file runs, and no tensor is larger than what the file has for it.
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
    except pickle.UnpicklingError as error:  # whose text advises to load it in an unsafe way
        raise ValueError(f"'{path}' must hold plain data and tensors only") from error
    except Exception as error:  # torch raises many kinds
        raise ValueError(f"'{path}' cannot be read: {type(error).__name__}: {error}") from error
    with zipfile.ZipFile(path) as archive:
        stored = sum(e.file_size for e in archive.infolist() if "/data/" in e.filename)
    _check_sizes(content, path, stored)
    return content


def check_once(path: PathLike) -> None:
    r"""Compares a file of :func:`torch.save` with its checksums; if it is large, only if it changed
    since the last time, for which its size, time and inode are kept beside it.
    """
    stat = os.stat(path)
    if stat.st_size <= _SMALL:
        check_zip(path)
        return
    state = {"size": stat.st_size, "mtime_ns": stat.st_mtime_ns, "inode": stat.st_ino}
    mark = mark_path(path)
    try:
        if json.loads(mark.read_text(encoding="utf-8")) == state:
            return
    except (OSError, ValueError, RecursionError):  # none, or none that can be trusted
        pass
    check_zip(path)
    if time.time_ns() - stat.st_mtime_ns < _FRESH:
        return
    try:
        with atomic_path(mark) as temporary:
            temporary.write_text(json.dumps(state), encoding="utf-8")
    except OSError:  # a folder that cannot be written to: it is checked again
        pass


def mark_path(path: PathLike) -> Path:
    r"""Returns where :func:`check_once` keeps that a file was checked."""
    return Path(f"{path}.checked")


def load_mapped(path: PathLike, map_location: Any = "cpu") -> Any:
    r"""Loads a file of :func:`torch.save` memory-mapped, as :obj:`torch.load(path, mmap=True)`.

    PyTorch maps it such that tensors may be written to, without a change of the file. The system
    counts all of such a mapping as memory that may be needed, and refuses it where the file is
    larger than memory, or than a limit of the process (:obj:`ulimit -d`). Then it is mapped to be
    read only: writing to a tensor in place would end the process.
    """
    try:
        return torch.load(path, map_location=map_location, mmap=True, weights_only=True)
    except RuntimeError as error:
        if "unable to mmap" not in str(error) or not hasattr(maps, "MAP_SHARED"):
            raise
    content = _load_shared(path, map_location)
    _logger.info("'%s' is larger than memory, and mapped to be read only", path)
    return content


def _load_shared(path: PathLike, map_location: Any) -> Any:
    before: Any = torch.serialization.get_default_mmap_options()
    torch.serialization.set_default_mmap_options(maps.MAP_SHARED)
    try:
        content = torch.load(path, map_location=map_location, mmap=True, weights_only=True)
    finally:
        torch.serialization.set_default_mmap_options(before)
    for value in _values(content):
        if _is_strided(value) and value.device.type == "cpu" and value.numel():
            storage = value.untyped_storage()
            _protect(storage.data_ptr(), storage.nbytes())
    return content


def _protect(address: int, size: int) -> None:
    # Otherwise a tensor that is written to would change the file.
    start = address - address % maps.PAGESIZE
    libc = ctypes.CDLL(None, use_errno=True)
    pointer, length = ctypes.c_void_p(start), ctypes.c_size_t(address + size - start)
    if libc.mprotect(pointer, length, maps.PROT_READ):
        raise OSError(ctypes.get_errno(), "a mapped file cannot be made read-only")


def tensor_form(value: Any) -> str:
    r"""Returns the form of a value that should be an ordinary tensor: its type, what else than
    dense numbers it is, and its shape, in words for an error.

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


def _check_sizes(content: Any, path: PathLike, stored: int) -> None:
    # A view of few numbers may claim to be large, and takes the memory where it is copied. A part
    # of the file that is shorter than its tensors would be read on beyond its end.
    storages: dict[int, int] = {}
    for number, value in enumerate(_values(content), 1):
        if number > _MAX_VALUES:
            raise ValueError(f"'{path}' must hold at most {_MAX_VALUES} values")
        if not _is_strided(value):
            continue
        size = value.numel() * value.element_size()
        held = 0 if value.is_meta else value.untyped_storage().nbytes()
        if held:
            storages[value.untyped_storage().data_ptr()] = held
        if size > held:
            raise ValueError(
                f"'{path}' must hold the {size} bytes of its tensor, {tensor_form(value)} (got "
                f"{held})"
            )
    held = sum(storages.values())
    need(held <= stored, f"'{path}' must hold the {held} bytes of its tensors", stored)


def _values(content: Any) -> Iterator[Any]:
    # All values, those of dictionaries and lists behind these.
    waiting = [content]
    while waiting:
        value = waiting.pop()
        yield value
        if isinstance(value, dict):
            waiting.extend(value.values())
        elif isinstance(value, list | tuple):
            waiting.extend(value)


def _is_strided(value: Any) -> bool:
    return isinstance(value, Tensor) and value.layout == torch.strided
