import os
import re
import threading
import time
import zlib

import numpy as np
import pytest
from fake_source import wait_until

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.io import Decoder, encode_packet
from torch_geometric_tactile.live import (
    SerialSource,
    Stream,
    open_source,
)
from torch_geometric_tactile.live._serial_port import SerialPort, list_ports

if os.name != "posix":
    pytest.skip("needs pseudo terminals", allow_module_level=True)

from ptys import FakePort

LONG = 20.0
SIZE = 4 + 16 + 4


class CheckedDecoder(Decoder):
    """Packets of `AA 55`, a number of 16 bits, 4 readings of float32 and a CRC32."""

    checksum = "crc32"

    def __init__(self, start=b""):
        super().__init__()
        self._start = start
        self._rest = b""
        self.resets = 0

    def feed(self, data, now):
        self._rest += data
        frames = []
        while len(self._rest) >= SIZE:
            packet = self._rest[:SIZE]
            good = packet[:2] == b"\xaa\x55" and zlib.crc32(packet[:-4]) == int.from_bytes(
                packet[-4:], "little"
            )
            if not good:
                self.counts.corrupt += packet[:2] == b"\xaa\x55"
                self.counts.skipped += 1
                self._rest = self._rest[1:]
                continue
            self._rest = self._rest[SIZE:]
            number = int.from_bytes(packet[2:4], "little")
            readings = np.frombuffer(packet[4:-4], dtype="<f4").reshape(4, 1)
            self.counts.good += 1
            frames.append(LiveFrame(number, now * 1e-9, now, None, readings))
        return frames

    def reset(self):
        self.resets += 1
        self._rest = b""

    def start(self):
        return self._start


def packet(number):
    body = b"\xaa\x55" + number.to_bytes(2, "little")
    body += np.arange(number, number + 4, dtype="<f4").tobytes()
    return body + zlib.crc32(body).to_bytes(4, "little")


def read_for_long(source):
    for _ in range(100):
        source.read(0.05)


@pytest.fixture
def port(tmp_path):
    port = FakePort(tmp_path / "ttyFAKE")
    yield port
    port.close()


def test_serial_source_reads_packets_in_pieces(port):
    with SerialSource(str(port.path), CheckedDecoder()) as source:
        data = packet(1) + packet(2)
        port.write(data[:7])
        assert source.read(0.02) == []
        port.write(data[7:])
        got = []
        while len(got) < 2:
            got += source.read(LONG)
    assert [frame.sequence for frame in got] == [1, 2]
    assert got[1].tactile.ravel().tolist() == [2, 3, 4, 5]
    assert source.counts.good == 2
    assert source.checksum == "crc32"


def test_bytes_that_make_no_frame_are_told_whatever_the_decoder_says(port):
    with SerialSource(str(port.path), CheckedDecoder()) as source:
        assert source.why_no_frame().startswith("no byte arrived")
        port.write(bytes(100))
        wait_until(lambda: source.read(0.05) == [] and source.counts.skipped > 100 - SIZE)
        told = "100 bytes arrived, but none is a frame{}: check the protocol, its settings and the"
        assert source.why_no_frame().startswith(told.format(""))
        source.counts.refuse("no header")
        assert source.why_no_frame().startswith(told.format(" (no header)"))


def test_serial_source_returns_what_came_without_waiting(port):
    with SerialSource(str(port.path), CheckedDecoder()) as source:
        port.write(packet(1))
        before = time.monotonic()
        assert len(source.read(3600.0)) == 1
        assert time.monotonic() - before < LONG


def test_serial_source_writes_what_starts_the_device(port):
    with SerialSource(str(port.path), CheckedDecoder(start=b"go\n")):
        assert port.read() == b"go\n"


def test_serial_source_repr_and_meta(port):
    source = SerialSource(str(port.path), CheckedDecoder())
    assert repr(source) == f"SerialSource('serial:{port.path}')"
    assert source.meta["unit"] == "count"
    assert source.baudrate == 115_200


def test_serial_source_closes_twice_and_opens_again(port):
    source = SerialSource(str(port.path), CheckedDecoder())
    source.close()
    source.open()
    source.open()
    source.close()
    source.close()
    with pytest.raises(OSError, match="is not open"):
        source.read(0)
    with source:
        port.write(packet(3))
        assert [frame.sequence for frame in source.read(LONG)] == [3]
    assert source.decoder.resets == 2


def test_missing_port_lists_those_that_are_there(tmp_path, monkeypatch):
    ports = [SerialPort("/dev/ttyACM0", "Board", 0x2341, 0x43, "75834"), SerialPort("/dev/ttyS0")]
    monkeypatch.setattr("torch_geometric_tactile.live.serial_source.list_ports", lambda: ports)
    source = SerialSource(str(tmp_path / "nothing"), CheckedDecoder())
    match = r"no serial port '.*nothing'; the ports .*: /dev/ttyACM0  2341:0043  75834  Board; /dev"
    with pytest.raises(FileNotFoundError, match=match):
        source.open()


def test_port_that_is_none_raises_os_error(tmp_path):
    file = tmp_path / "file"
    file.write_bytes(b"no port")
    with pytest.raises(OSError, match=r"file' cannot be opened as a serial port: .*ioctl"):
        SerialSource(str(file), CheckedDecoder()).open()


@pytest.mark.parametrize(
    ("port", "baudrate", "match"),
    [
        ("", None, "'port' must be the path or name"),
        (3, None, "'port' must be the path or name"),
        ("/dev/x", 0, "'baudrate' must be a positive number"),
        ("/dev/x", 9600.0, "'baudrate' must be a positive number"),
    ],
)
def test_serial_source_bad_input_raises(port, baudrate, match):
    with pytest.raises(ValueError, match=match):
        SerialSource(port, CheckedDecoder(), baudrate)


def test_unplugged_port_is_noticed(port):
    with SerialSource(str(port.path), CheckedDecoder()) as source:
        port.unplug()
        with pytest.raises(OSError, match=r"serial:.*/ttyFAKE is "):
            read_for_long(source)


def test_port_replaced_by_another_of_its_name_is_noticed(port, tmp_path):
    with SerialSource(str(port.path), CheckedDecoder()) as source:
        other = FakePort(tmp_path / "other")
        port.path.unlink()
        port.path.symlink_to(os.ttyname(other._device))
        with pytest.raises(OSError, match="has disappeared"):
            source.read(0)
        other.close()


def test_usb_device_is_found_again_under_another_name(port, tmp_path, monkeypatch):
    usb = SerialPort(str(port.path), "Board", 1, 2, "A7")
    module = "torch_geometric_tactile.live.serial_source.list_ports"
    monkeypatch.setattr(module, lambda: [SerialPort("/dev/ttyS0"), usb])
    source = SerialSource(str(port.path), CheckedDecoder())
    source.open()
    source.close()
    port.unplug()
    monkeypatch.setattr(module, lambda: [SerialPort("/dev/ttyS0")])
    assert not source.is_there()
    with pytest.raises(FileNotFoundError, match=r"no serial port the device .*0001:0002  A7"):
        source.open()
    other = FakePort(tmp_path / "ttyFAKE1")
    monkeypatch.setattr(module, lambda: [SerialPort(str(other.path), "Board", 1, 2, "A7")])
    assert source.is_there()
    with source:
        other.write(packet(9))
        assert [frame.sequence for frame in source.read(LONG)] == [9]
    other.close()


def test_damaged_packets_leave_all_intact_ones_in_order(port):
    generator = np.random.default_rng(0)
    damaged = set(generator.choice(1000, 20, replace=False).tolist())
    stream = Stream(SerialSource(str(port.path), CheckedDecoder()))
    subscription = stream.subscribe()

    def send():
        for number in range(1001):
            data = bytearray(packet(number))
            if number in damaged:
                data[generator.integers(len(data))] ^= 1 << generator.integers(8)
            port.write(bytes(data))

    with stream:
        sender = threading.Thread(target=send)
        sender.start()
        got = []
        while not got or got[-1].sequence < 1000:
            got.append(subscription.get(LONG))
        sender.join()
    assert [frame.sequence for frame in got] == sorted(set(range(1001)) - damaged)
    for frame in got:
        assert frame.tactile.ravel().tolist() == list(range(frame.sequence, frame.sequence + 4))
    assert stream.health().skipped > 0


@pytest.mark.full
def test_port_gone_and_back_twenty_times(port):
    stream = Stream(SerialSource(str(port.path), CheckedDecoder()))
    subscription = stream.subscribe()
    with stream:
        for turn in range(20):
            port.write(packet(turn)[:5])  # a half packet that must not spoil the next ones
            port.unplug()
            wait_until(lambda: stream.state == "lost")
            port.plug()
            wait_until(lambda: stream.state == "open")
            port.write(packet(turn))
            assert subscription.get(LONG).sequence == turn
        assert stream.health().reconnects == 20
    assert stream.source.counts.corrupt == 0


def test_port_by_its_url_with_damage(port):
    pytest.importorskip("cobs", reason="needs the extra 'live'")
    generator = np.random.default_rng(1)
    damaged = {5, 6, 40}
    tactile = generator.normal(size=(100, 8, 3)).astype(np.float32)
    stream = Stream(open_source(f"serial:{port.path}?protocol=cobs"))
    subscription = stream.subscribe()
    with stream:
        for number in range(100):
            data = bytearray(encode_packet(number, tactile[number], device_time=number / 100))
            if number in damaged:
                data[20] ^= 1
            port.write(bytes(data))
        got = [subscription.get(LONG) for _ in range(97)]
    assert [frame.sequence for frame in got] == sorted(set(range(100)) - damaged)
    for frame in got:
        np.testing.assert_array_equal(frame.tactile, tactile[frame.sequence])
    health = stream.health()
    assert (health.corrupt, health.lost, health.checksum) == (3, 3, "crc32")
    times = np.array([frame.time for frame in got])
    assert (np.diff(times) > 0).all()


def test_list_ports_are_sorted_and_shown_with_usb_ids(monkeypatch):
    class Port:
        vid, pid, serial_number, description = None, None, None, "n/a"

        def __init__(self, device, **known):
            self.device = device
            self.__dict__.update(known)

    known = {"vid": 0x2341, "pid": 0x8036, "serial_number": "75", "description": "Leonardo"}
    ports = [Port("/dev/ttyS9"), Port("/dev/ttyACM1", **known)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: iter(ports))
    assert list_ports() == [
        SerialPort("/dev/ttyACM1", "Leonardo", 0x2341, 0x8036, "75"),
        SerialPort("/dev/ttyS9"),
    ]
    assert [str(port) for port in list_ports()] == [
        "/dev/ttyACM1  2341:8036  75  Leonardo",
        "/dev/ttyS9",
    ]


LINES = b"0,4\r\n" + b"512,513,900\r\n" * 9


def read_until(source, condition):
    frames = []
    wait_until(lambda: frames.extend(source.read(0.05)) or condition(frames))
    return frames


def test_port_without_a_protocol_reads_lines_of_numbers(port):
    with open_source(f"serial:{port.path}") as source:
        port.write(b"Ready\r\n")
        port.write(LINES)
        frames = read_until(source, lambda frames: len(frames) == 9)
        assert frames[0].tactile.ravel().tolist() == [512, 513, 900]
        assert frames[0].received == frames[8].received  # arrival of the bytes, not of the decision
        port.unplug()
        with pytest.raises(OSError, match="serial:"):
            read_for_long(source)
        source.close()
        port.plug()
        source.open()
        port.write(LINES)
        assert len(read_until(source, lambda frames: len(frames) == 9)) == 9


@pytest.mark.parametrize("time", ["none", "ms"])
def test_time_without_a_unit_is_suspected(port, caplog, time):
    rows = b"".join(b"%d,512,513\r\n" % (20 * i) for i in range(12))
    with open_source(f"serial:{port.path}", time=time) as source:
        port.write(rows)
        frames = read_until(source, lambda frames: len(frames) == 11)
    assert (frames[0].device_time, frames[0].tactile.shape) == (
        (None, (3, 1)) if time == "none" else (0.02, (2, 1))
    )
    warned = "if it is a time and not a taxel, add its unit to the source, such as time=ms"
    assert (warned in caplog.text) == (time == "none")


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\xaa\x55\x01\x02" * 99, r"\(binary, AA 55 every 4 bytes\)$"),
        (b"1 2\r\n3 4\r\n\r\n" * 9, r"\(blocks of 2 lines .*\): use protocol=text&shape=2x2$"),
        (b"7" * 100_000, r"b'77777.*' \(text, but not lines"),
    ],
    ids=["binary", "rows", "long"],
)
def test_port_without_a_protocol_refuses_other_bytes(port, monkeypatch, data, kind):
    monkeypatch.setattr("torch_geometric_tactile.live.serial_source._MAX_LOOK_SECONDS", 0.1)
    with open_source(f"serial:{port.path}") as source:
        writer = threading.Thread(target=port.write, args=(data,), daemon=True)
        writer.start()
        with pytest.raises(ValueError, match=r"sent no lines of numbers: [0-9]+ bytes") as caught:
            read_for_long(source)
    assert 'no protocol is named: name it, as "serial:' in str(caught.value)
    assert 'protocol=NAME" with one of cobs, anyskin,' in str(caught.value)
    assert re.search(kind, str(caught.value))
    writer.join()


def test_bytes_of_another_protocol_are_described(port):
    with open_source(f"serial:{port.path}?protocol=m1616") as source:
        port.write(LINES)
        wait_until(lambda: source.read(0.05) == [] and source.counts.skipped >= len(LINES))
        assert source.why_no_frame().endswith(
            "the baudrate of 115200. The first bytes are "
            r"b'0,4\r\n512,513,900\r\n512,513,900\r\n512,513,9' "
            "(lines of 3 numbers): use protocol=lines"
        )
    with open_source(f"serial:{port.path}?protocol=lines&num_taxels=5") as source:
        port.write(LINES)
        wait_until(lambda: source.read(0.05) == [] and source.counts.skipped >= len(LINES))
        assert "(a line must have 5 numbers (got 3))" in source.why_no_frame()
        assert source.why_no_frame().endswith("(lines of 3 numbers)")
