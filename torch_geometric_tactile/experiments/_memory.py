r"""How much memory a piece of work takes."""

import ctypes
import gc
import sys
from pathlib import Path

import torch

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_MB = 2**20


class PeakMemory:
    r"""Measures how far the memory of this process grows: from :meth:`start` to the highest point
    before :meth:`stop`, in megabytes (of :math:`2^{20}` bytes).

    On the CPU it is resident memory, and free memory is given back to the system before, so that
    its reuse counts. Linux knows the highest point since the start; elsewhere it is that of the
    whole life of the process, and work that stays below what came before counts as nothing: use a
    process of its own. On a GPU it is what torch has allocated there.

    Examples:
        >>> memory = PeakMemory()
        >>> memory.start()
        >>> block = bytearray(64 * 2**20)
        >>> memory.stop() > 50
        True
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self._before: float  # set by start

    @property
    def measure(self) -> str:
        r"""What is measured, in words."""
        if self.device.type == "cuda":
            return "memory allocated by torch on the GPU"
        return "resident memory of the process"

    @staticmethod
    def can_start_anew() -> bool:
        r"""Forgets the highest point so far, and tells whether that was possible."""
        try:
            _CLEAR.write_text("5", encoding="ascii")  # resets VmHWM
        except OSError:
            return False
        return True

    def start(self) -> None:
        r"""Begins."""
        gc.collect()
        if self.device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(self.device)
            self._before = torch.cuda.memory_allocated(self.device) / _MB
            return
        _give_back()
        self._before = _status("VmRSS") if self.can_start_anew() else _highest()

    def stop(self) -> float:
        r"""Returns the growth in megabytes."""
        if self.device.type == "cuda":
            return torch.cuda.max_memory_allocated(self.device) / _MB - self._before
        return max(0.0, _highest() - self._before)


def _give_back() -> None:
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc only
        if trim is not None:
            trim(0)


def _highest() -> float:
    if _STATUS.is_file():
        return _status("VmHWM")
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    highest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return highest / (_MB if sys.platform == "darwin" else 1024)


def _status(name: str) -> float:
    for line in _STATUS.read_text("utf-8", "replace").splitlines():
        key, _, value = line.partition(":")
        if key == name:
            return int(value.split()[0]) / 1024  # of kB
    return float("nan")
