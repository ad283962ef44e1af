r"""A serial port as a source."""

import errno
import logging
import os
import time
from contextlib import suppress
from typing import Any

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io import PROTOCOLS, Decoder, LinesDecoder
from torch_geometric_tactile.io.decoders._bytes_description import describe_bytes
from torch_geometric_tactile.live._serial_port import SerialPort, list_ports
from torch_geometric_tactile.live.source import Source

try:
    from termios import error as termios_error
except ImportError:  # Windows
    termios_error = OSError  # type: ignore[misc, assignment]

_log = logging.getLogger(__name__)
_MAX_READ_BYTES = 1 << 16
_WRITE_SECONDS = 1.0
_MAX_DESCRIBED_BYTES = 1 << 16
# Seconds after the first byte: between two checks of the bytes of an unnamed protocol, and until
# the last check. A board may take seconds to start before it sends.
_LOOK_SECONDS = 0.5
_MAX_LOOK_SECONDS = 5.0


class SerialSource(Source):
    r"""Reads frames from a serial port through a decoder. Frames are returned as soon as they are
    complete.

    If a USB device is lost, it is found again by its serial number, even if its port has a new
    name. Other devices are found by the path of their port.

    Args:
        port (str): Path or name of the port.
        decoder (Decoder): The decoder that converts bytes to frames.
        baudrate (int, optional): Bits per second. By default the rate of the decoder.
        expects_lines (bool): Whether no protocol was named, so that the decoder of lines of numbers
            is used. The bytes of the first seconds must then be such lines.

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

    def __init__(
        self,
        port: str,
        decoder: Decoder,
        baudrate: int | None = None,
        *,
        expects_lines: bool = False,
    ) -> None:
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
        self._serial: Any = None
        self._usb: SerialPort | None = None
        self._is_identified = False
        self._received = 0  # number of bytes
        self._first_bytes = b""
        self._expects_lines = expects_lines
        self._held_reads: list[tuple[bytes, int]] = []  # bytes and arrival, until they are lines
        self._first_arrival = self._next_look = 0

    def open(self) -> None:
        r"""Opens the port. Does nothing if it is open.

        Raises:
            FileNotFoundError: If there is no such port; the message lists the available ports.
            OSError: If the port cannot be opened, for example without permission.
        """
        if self._serial is not None:
            return
        path = self._current_path()
        if path is None or (path.startswith("/") and not os.path.exists(path)):
            raise FileNotFoundError(self._missing_port_text(path))
        self.decoder.reset()
        self._held_reads = []
        self._serial = self._open_port(path)
        if not self._is_identified:  # only the first time: another device may use the path later
            port = _find_port(path)
            self._usb = port if port is not None and port.serial_number else None
            self._is_identified = True
        start = self.decoder.start()
        if start:
            try:
                self._serial.write(start)
            except BaseException:
                self.close()
                raise

    def _open_port(self, path: str) -> Any:
        import serial

        try:
            return serial.Serial(path, self.baudrate, timeout=0.1, write_timeout=_WRITE_SECONDS)
        except FileNotFoundError as error:
            raise FileNotFoundError(self._missing_port_text(path)) from error
        except termios_error as error:  # the device was unplugged during the call
            raise OSError(f"'{path}' cannot be opened as a serial port: {error}") from error
        except serial.SerialException as error:
            if os.name == "nt" and "FileNotFoundError" in str(error):
                raise FileNotFoundError(self._missing_port_text(path)) from error
            text = f"'{path}' cannot be opened as a serial port: {error.strerror or error}"
            if error.errno == errno.EACCES:
                text += (
                    "; on Linux, add yourself to its group (often 'dialout'), for example with "
                    "'sudo usermod -aG dialout $USER', and log in again"
                )
            raise (OSError(text) if error.errno is None else OSError(error.errno, text)) from error

    def _current_path(self) -> str | None:
        if self._usb is None:
            return self.port
        port = _find_device(self._usb)
        return None if port is None else port.device

    def _missing_port_text(self, path: str | None) -> str:
        description = (
            f"'{path}'" if path is not None else f"the device {self._usb} of '{self.port}'"
        )
        ports = list_ports()
        port_list = "; ".join(map(str, ports)) if ports else "none"
        return f"there is no serial port {description}; the ports of this machine are: {port_list}"

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the received frames, or an empty list if none is complete within the timeout.

        Args:
            timeout (float): Limit of the wait in seconds. The call may take up to twice as long if
                bytes arrive that give no frame.

        Raises:
            OSError: If the port is lost.
            ValueError: If no protocol was named, and the bytes of the first seconds are not lines
                of numbers.
        """
        if self._serial is None:
            raise OSError(f"{self.name} is not open")
        deadline = time.perf_counter() + timeout
        while True:
            data = self._read_bytes(timeout)
            frames = self._decode(data, time.perf_counter_ns())
            if frames or time.perf_counter() >= deadline:
                break
        if not data:
            self._check_presence()
        return frames

    def _decode(self, data: bytes, now: int) -> list[LiveFrame]:
        self._received += len(data)
        if len(self._first_bytes) < _MAX_DESCRIBED_BYTES:
            self._first_bytes += data[: _MAX_DESCRIBED_BYTES - len(self._first_bytes)]
        if not self._expects_lines:
            return self.decoder.feed(data, now) if data else []
        if data:
            self._held_reads.append((data, now))
        if not self._held_reads or not self._are_lines(now):
            return []
        self._expects_lines = False
        reads, self._held_reads = self._held_reads, []
        return [frame for data, arrival in reads for frame in self.decoder.feed(data, arrival)]

    def _are_lines(self, now: int) -> bool:
        r"""Returns whether the first bytes are lines of numbers. Raises an error if they are not
        lines of numbers after some seconds.
        """
        if not self._first_arrival:
            self._first_arrival = now
            self._next_look = now + round(_LOOK_SECONDS * 1e9)
        if now < self._next_look:
            return False
        self._next_look = now + round(_LOOK_SECONDS * 1e9)
        description = describe_bytes(self._first_bytes)
        if description.protocol == "lines":
            is_timeless = isinstance(self.decoder, LinesDecoder) and self.decoder.time == "none"
            if description.first_grows and is_timeless:
                _log.warning(
                    "'%s': the first number increases from line to line: if it is a time and not a "
                    "taxel, add its unit to the source, such as time=ms",
                    self.name,
                )
            return True
        is_over = now - self._first_arrival >= _MAX_LOOK_SECONDS * 1e9
        if is_over or len(self._first_bytes) == _MAX_DESCRIBED_BYTES:
            raise ValueError(f"'{self.name}' sent no lines of numbers: {self.why_no_frame()}")
        return False

    def _read_bytes(self, timeout: float) -> bytes:
        # Reads one byte, then all others that have arrived: pyserial waits until it has as many
        # bytes as requested.
        port = self._serial
        try:
            if port.timeout != timeout:  # setting it is a call of the driver
                port.timeout = timeout
            data: bytes = port.read(1)
            waiting = port.in_waiting if data else 0
            return data + port.read(min(waiting, _MAX_READ_BYTES)) if waiting else data
        except (OSError, termios_error) as error:
            raise OSError(f"{self.name} is lost: {error}") from error

    def why_no_frame(self) -> str:
        r"""Returns the reason why there is no frame, and the settings to check."""
        if not self._received:
            return "no byte arrived: check the cable and the port, and that the device sends"
        description = describe_bytes(self._first_bytes)
        protocol = description.protocol
        is_named = isinstance(self.decoder, PROTOCOLS.get(protocol, ())) and not self._expects_lines
        advice = f": use protocol={protocol}" if protocol and not is_named else ""
        if self._expects_lines:
            return (
                f"{self._received} bytes arrived, but no protocol is named: name it, as "
                f'"{self.name}?protocol=NAME" with one of {", ".join(PROTOCOLS)}, or check the '
                f"baudrate of {self.baudrate}. The first bytes are {description.text}{advice}"
            )
        reason = f" ({self.counts.reason})" if self.counts.reason else ""
        return (
            f"{self._received} bytes arrived, but none is a frame{reason}: check the protocol, its "
            f"settings and the baudrate of {self.baudrate}. The first bytes are {description.text}"
            f"{advice}"
        )

    def _check_presence(self) -> None:
        # With some drivers, the file of an unplugged device stays open without an error.
        path = self._serial.port
        if os.name != "posix":
            return
        try:
            is_same_device = os.stat(path).st_rdev == os.fstat(self._serial.fileno()).st_rdev
        except FileNotFoundError:
            is_same_device = False
        if not is_same_device:
            raise OSError(f"{self.name} has disappeared")

    def is_there(self) -> bool:
        r"""Returns whether the port exists."""
        if self._usb is not None:
            return _find_device(self._usb) is not None
        return os.path.exists(self.port) or _find_port(self.port) is not None

    def close(self) -> None:
        r"""Closes the port. Does nothing if it is closed."""
        port, self._serial = self._serial, None
        if port is not None:
            with suppress(OSError, termios_error):
                port.close()


def _find_port(path: str) -> SerialPort | None:
    r"""Returns the port of a path, which may be a link as in :obj:`/dev/serial/by-id`."""
    resolved = os.path.normcase(os.path.realpath(path))
    for port in list_ports():
        if resolved == os.path.normcase(os.path.realpath(port.device)):
            return port
    return None


def _find_device(port: SerialPort) -> SerialPort | None:
    r"""Returns the current port of a USB device, by its vendor, product and serial number."""
    identifiers = (port.vid, port.pid, port.serial_number)
    for candidate in list_ports():
        if (candidate.vid, candidate.pid, candidate.serial_number) == identifiers:
            return candidate
    return None
