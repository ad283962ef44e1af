r"""The serial ports of this machine."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SerialPort:
    r"""A serial port of this machine: its path and, for a USB device, its identifiers.

    Args:
        device (str): Path or name of the port, such as :obj:`"/dev/ttyACM0"` or :obj:`"COM3"`.
        description (str): Name that the device reports.
        vid (int, optional): Vendor number of a USB device.
        pid (int, optional): Product number of a USB device.
        serial_number (str, optional): Serial number of a USB device.

    Examples:
        >>> port = SerialPort("/dev/ttyACM0", "Tactile glove", vid=0x2341, pid=0x0043)
        >>> port.device, port.usb_id
        ('/dev/ttyACM0', '2341:0043')
    """

    device: str
    description: str = ""
    vid: int | None = None
    pid: int | None = None
    serial_number: str | None = None

    @property
    def usb_id(self) -> str:
        r"""Vendor and product numbers as hexadecimal :obj:`"VID:PID"`; empty without USB."""
        if self.vid is None or self.pid is None:
            return ""
        return f"{self.vid:04X}:{self.pid:04X}"

    def __str__(self) -> str:
        parts = [self.device, self.usb_id, self.serial_number or "", self.description]
        return "  ".join(part for part in parts if part)


def list_ports() -> list[SerialPort]:
    r"""Returns the serial ports of this machine, sorted by name. Ports without a device, such as
    unused ports of a mainboard, are left out if the operating system reports them.

    Examples:
        >>> ports = list_ports()
        >>> all(isinstance(port, SerialPort) for port in ports)
        True
    """
    from serial.tools.list_ports import comports

    ports = [
        SerialPort(
            device=port.device,
            description=port.description if port.description not in (None, "n/a") else "",
            vid=port.vid,
            pid=port.pid,
            serial_number=port.serial_number or None,
        )
        for port in comports()
    ]
    return sorted(ports, key=lambda port: port.device)
