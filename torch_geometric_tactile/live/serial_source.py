r"""Frames from a serial port."""

import errno
import os
import time
from contextlib import suppress
from typing import Any

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io import Decoder
from torch_geometric_tactile.live.serial_port import SerialPort, list_ports
from torch_geometric_tactile.live.source import Source

try:
    from termios import error as termios_error
except ImportError:  # Windows
    termios_error = OSError  # type: ignore[misc, assignment]

_MOST = 1 << 16  # bytes of one read
_WRITE = 1.0  # seconds that a device may take to accept what is written


class SerialSource(Source):
    r"""Reads frames from a serial port through a decoder. What has arrived is returned at once.

    A USB device that was lost is found again by its serial number, under whatever name it returns;
    another port by its path.

    Args:
        port (str): Path or name of the port.
        decoder (Decoder): What makes frames of its bytes.
        baudrate (int, optional): Bits per second; that of the decoder if left out.

    Raises:
        ValueError: If :obj:`port` is empty, or :obj:`baudrate` is not positive.

    Examples:
        >>> from torch_geometric_tactile.io import decoder_of
        >>> source = SerialSource("/dev/ttyACM0", decoder_of("text", shape="4x3"))  # not opened yet
        >>> source.name, source.baudrate == source.decoder.baudrate
        ('serial:/dev/ttyACM0', True)
        >>> with source:  # doctest: +SKIP
        ...     frames = source.read(timeout=1.0)
    """

    def __init__(self, port: str, decoder: Decoder, baudrate: int | None = None) -> None:
        if not isinstance(port, str) or not port:
            raise ValueError(f"'port' must be the path or name of a serial port (got {port!r})")
        baudrate = decoder.baudrate if baudrate is None else baudrate
        if isinstance(baudrate, bool) or not isinstance(baudrate, int) or baudrate < 1:
            raise ValueError(f"'baudrate' must be a positive number (got {baudrate!r})")
        sensor = {} if decoder.layout is None else {"sensor": decoder.layout}
        super().__init__(f"serial:{port}", {"unit": decoder.unit, **sensor})
        self.port = port
        self.decoder = decoder
        self.baudrate = baudrate
        self.counts = decoder.counts
        self.checksum = decoder.checksum
        self.clock_period = decoder.clock_period
        self._line: Any = None
        self._usb: SerialPort | None = None
        self._known = False
        self._received = 0  # bytes

    def open(self) -> None:
        r"""Opens the port; does nothing if it is open.

        Raises:
            FileNotFoundError: If it is not there; the message lists the ports there are.
            OSError: If it cannot be opened, such as without permission.
        """
        if self._line is not None:
            return
        path = self._path()
        if path is None or (path.startswith("/") and not os.path.exists(path)):
            raise FileNotFoundError(self._missing(path))
        self.decoder.reset()
        self._line = self._opened(path)
        if not self._known:  # what it was at first; another one may be there later
            port = _port_of(path)
            self._usb = port if port is not None and port.serial_number else None
            self._known = True
        start = self.decoder.start()
        if start:
            try:
                self._line.write(start)
            except BaseException:
                self.close()
                raise

    def _opened(self, path: str) -> Any:
        import serial

        try:
            return serial.Serial(path, self.baudrate, timeout=0.1, write_timeout=_WRITE)
        except FileNotFoundError as error:
            raise FileNotFoundError(self._missing(path)) from error
        except termios_error as error:  # it went away meanwhile
            raise OSError(f"'{path}' cannot be opened as a serial port: {error}") from error
        except serial.SerialException as error:
            if os.name == "nt" and "FileNotFoundError" in str(error):
                raise FileNotFoundError(self._missing(path)) from error
            text = f"'{path}' cannot be opened as a serial port: {error.strerror or error}"
            if error.errno == errno.EACCES:
                text += (
                    "; on Linux, join its group (often 'dialout'), as with "
                    "'sudo usermod -aG dialout $USER', and log in again"
                )
            raise (OSError(text) if error.errno is None else OSError(error.errno, text)) from error

    def _path(self) -> str | None:
        if self._usb is None:
            return self.port
        found = _found_again(self._usb)
        return None if found is None else found.device

    def _missing(self, path: str | None) -> str:
        what = f"'{path}'" if path is not None else f"the device {self._usb} of '{self.port}'"
        ports = list_ports()
        there = "; ".join(map(str, ports)) if ports else "none"
        return f"there is no serial port {what}; the ports of this machine are: {there}"

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the frames that came, or none if none was complete in time.

        Args:
            timeout (float): How long to wait in seconds; up to twice that if bytes come that make
                no frame.

        Raises:
            OSError: If the port is lost.
        """
        if self._line is None:
            raise OSError(f"{self.name} is not open")
        deadline = time.perf_counter() + timeout
        while True:
            data = self._bytes(timeout)
            self._received += len(data)
            frames = self.decoder.feed(data, time.perf_counter_ns()) if data else []
            if frames or time.perf_counter() >= deadline:
                break
        if not data:
            self._check_there()
        return frames

    def _bytes(self, timeout: float) -> bytes:
        # One byte wakes; pyserial waits until all that is asked for is there, so no more is asked.
        line = self._line
        try:
            if line.timeout != timeout:  # each change is a call of the driver
                line.timeout = timeout
            data: bytes = line.read(1)
            waiting = line.in_waiting if data else 0
            return data + line.read(min(waiting, _MOST)) if waiting else data
        except (OSError, termios_error) as error:
            raise OSError(f"{self.name} is lost: {error}") from error

    def why_no_frame(self) -> str:
        r"""Returns why there is no frame: what came instead, and what to check."""
        if not self._received:
            return "no byte came: check the cable and the port, and that the device sends"
        why = f" ({self.counts.reason})" if self.counts.reason else ""
        return (
            f"{self._received} bytes came and make none{why}: check the protocol, its settings and "
            f"the baudrate of {self.baudrate}"
        )

    def _check_there(self) -> None:
        # Some drivers leave the file of an unplugged device open and silent.
        path = self._line.port
        if os.name != "posix":
            return
        try:
            same = os.stat(path).st_rdev == os.fstat(self._line.fileno()).st_rdev
        except FileNotFoundError:
            same = False
        if not same:
            raise OSError(f"{self.name} is gone")

    def is_there(self) -> bool:
        r"""Returns whether the port is there."""
        if self._usb is not None:
            return _found_again(self._usb) is not None
        return os.path.exists(self.port) or _port_of(self.port) is not None

    def close(self) -> None:
        r"""Closes the port; does nothing if it is closed."""
        line, self._line = self._line, None
        if line is not None:
            with suppress(OSError, termios_error):
                line.close()


def _port_of(path: str) -> SerialPort | None:
    r"""Returns the port of a path, which may be a link such as one in :obj:`/dev/serial/by-id`."""
    real = os.path.normcase(os.path.realpath(path))
    for port in list_ports():
        if real == os.path.normcase(os.path.realpath(port.device)):
            return port
    return None


def _found_again(port: SerialPort) -> SerialPort | None:
    r"""Returns where a USB device is now, by its vendor, product and serial number."""
    same = (port.vid, port.pid, port.serial_number)
    for other in list_ports():
        if (other.vid, other.pid, other.serial_number) == same:
            return other
    return None
