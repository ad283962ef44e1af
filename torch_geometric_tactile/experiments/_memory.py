r"""Measures the peak memory of a block of code."""

import ctypes
import gc
import sys
from pathlib import Path

import torch

_STATUS_FILE = Path("/proc/self/status")
_CLEAR_REFS_FILE = Path("/proc/self/clear_refs")
_BYTES_PER_MB = 2**20


class PeakMemory:
    r"""Measures the memory growth of this process from :meth:`start` to the highest point before
    :meth:`stop`, in megabytes of :math:`2^{20}` bytes.

    On the CPU, resident memory is measured. :meth:`start` returns free heap memory to the system,
    so that reusing it counts. Linux can reset the recorded peak. Other systems report the peak of
    the whole process, so code that stays below an earlier peak measures zero; run it in a new
    process. On a GPU, the memory allocated by torch is measured.

    Args:
        device (str or torch.device): The device on which the code runs.

    Examples:
        >>> memory = PeakMemory()
        >>> memory.start()
        >>> block = bytearray(64 * 2**20)
        >>> memory.stop() > 50
        True
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self._start_megabytes: float  # set by start

    @property
    def measure(self) -> str:
        r"""The name of the measured memory, for captions."""
        if self.device.type == "cuda":
            return "memory allocated by torch on the GPU"
        return "resident memory of the process"

    @staticmethod
    def reset_peak() -> bool:
        r"""Resets the peak that Linux records. Returns :obj:`False` if that is impossible."""
        try:
            _CLEAR_REFS_FILE.write_text("5", encoding="ascii")  # resets VmHWM
        except OSError:
            return False
        return True

    def start(self) -> None:
        r"""Records the memory in use, from which growth is measured."""
        gc.collect()
        if self.device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(self.device)
            self._start_megabytes = torch.cuda.memory_allocated(self.device) / _BYTES_PER_MB
            return
        _release_free_heap()
        self._start_megabytes = (
            _status_megabytes("VmRSS") if self.reset_peak() else _peak_megabytes()
        )

    def stop(self) -> float:
        r"""Returns the growth to the highest point since :meth:`start`, in megabytes."""
        if self.device.type == "cuda":
            return (
                torch.cuda.max_memory_allocated(self.device) / _BYTES_PER_MB - self._start_megabytes
            )
        return max(0.0, _peak_megabytes() - self._start_megabytes)


def _release_free_heap() -> None:
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # only in glibc
        if trim is not None:
            trim(0)


def _peak_megabytes() -> float:
    if _STATUS_FILE.is_file():
        return _status_megabytes("VmHWM")
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (_BYTES_PER_MB if sys.platform == "darwin" else 1024)  # bytes or kB


def _status_megabytes(name: str) -> float:
    for line in _STATUS_FILE.read_text("utf-8", "replace").splitlines():
        key, _, value = line.partition(":")
        if key == name:
            return int(value.split()[0]) / 1024  # the value is in kB
    return float("nan")
