r"""Files of :func:`torch.save` that stay on the disk."""

import ctypes
import logging
import mmap
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._typing import PathLike

_logger = logging.getLogger(__name__)


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
        if "unable to mmap" not in str(error) or not hasattr(mmap, "MAP_SHARED"):
            raise
    content = _load_shared(path, map_location)
    _logger.info("'%s' is larger than memory, and mapped to be read only", path)
    return content


def _load_shared(path: PathLike, map_location: Any) -> Any:
    before: Any = torch.serialization.get_default_mmap_options()
    torch.serialization.set_default_mmap_options(mmap.MAP_SHARED)
    try:
        content = torch.load(path, map_location=map_location, mmap=True, weights_only=True)
    finally:
        torch.serialization.set_default_mmap_options(before)
    for tensor in _tensors([content]):
        if tensor.layout == torch.strided and tensor.device.type == "cpu" and tensor.numel():
            storage = tensor.untyped_storage()
            _protect(storage.data_ptr(), storage.nbytes())
    return content


def _tensors(waiting: list[Any]) -> Iterable[Tensor]:
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            waiting.extend(value.values())
        elif isinstance(value, list | tuple):
            waiting.extend(value)
        elif isinstance(value, Tensor):
            yield value


def _protect(address: int, size: int) -> None:
    # Otherwise a tensor that is written to would change the file.
    start = address - address % mmap.PAGESIZE
    libc = ctypes.CDLL(None, use_errno=True)
    pointer, length = ctypes.c_void_p(start), ctypes.c_size_t(address + size - start)
    if libc.mprotect(pointer, length, mmap.PROT_READ):
        raise OSError(ctypes.get_errno(), "a mapped file cannot be made read-only")
