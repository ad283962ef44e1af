import numpy as np
import pytest
from streams import assert_split_anywhere, fed, numbers

from torch_geometric_tactile.io import RobotiqDecoder


def block(kind, finger, values):
    return bytes([kind | finger << 2]) + np.array(values).astype(">u2").tobytes()


def packet(*blocks, command=0x58, check=0):
    data = b"".join(blocks)
    return bytes([0x9A, check, command, len(data)]) + data


def grid(finger, number):
    return np.random.default_rng([finger, number]).integers(0, 2**16, 28)


def static(finger, number):
    return packet(block(0x10, finger, grid(finger, number)))


def time(milliseconds, finger=0):
    return bytes([0x70 | finger << 2]) + milliseconds.to_bytes(8, "big")


def frame_packets(number):
    both = [block(0x20, f, [number]) + block(0x30, f, [1, 2, -3]) for f in (0, 1)]
    return static(0, number) + packet(*both, time(2 * number)) + static(1, number)


NEXT = b"\x9a"  # of the packet after, without which none is trusted at first


def test_a_frame_by_hand():
    one = packet(
        block(0x20, 0, [0xFFFE]),
        block(0x30, 0, [1, 2, 0x8000]),
        block(0x40, 1, [4, 5, 6]),
        block(0x50, 0, [7, 0xFFF8, 9]),
        block(0x60, 1, [300]),
        time(12_345),
        command=0x59,
    )
    zero, first = grid(0, 0), grid(1, 0)
    decoder = RobotiqDecoder()
    data = one + packet(block(0x10, 0, zero)) + packet(block(0x10, 1, first), check=77)
    (frame,) = decoder.feed(data, now=10**9)
    assert frame.tactile.shape == (56, 1)
    assert frame.tactile.ravel().tolist() == [*zero.tolist(), *first.tolist()]
    assert (frame.sequence, frame.time, frame.device_time) == (0, 1, 12.345)
    nan = np.nan
    expected = {
        "dynamic": [-2, nan],
        "accelerometer": [[1, 2, -32768], [nan] * 3],
        "gyroscope": [[nan] * 3, [4, 5, 6]],
        "magnetometer": [[7, -8, 9], [nan] * 3],
        "temp": [nan, 300],
    }
    assert frame.extra.keys() == expected.keys()
    for name, value in expected.items():
        assert np.array_equal(frame.extra[name], np.float32(value), equal_nan=True)
    assert (decoder.checksum, decoder.baudrate) == ("none", 115200)


def test_start_command():
    assert RobotiqDecoder().start().hex(" ") == "9a 00 58 01 01"
    assert RobotiqDecoder(period=0.016).start().hex(" ") == "9a 00 58 01 10"


def test_split_at_every_byte():
    data = b"".join(frame_packets(i) for i in range(3)) + NEXT
    frames = assert_split_anywhere(RobotiqDecoder, data)
    assert numbers(frames) == [0, 1, 2]
    assert [frame.device_time for frame in frames] == [0, 0.002, 0.004]
    assert frames[1].extra["dynamic"].tolist() == [1, 1]
    assert frames[2].tactile[28:, 0].tolist() == grid(1, 2).tolist()


def test_a_finger_that_is_missing_is_nan():
    data = static(0, 0) + static(1, 0) + static(0, 1) + static(0, 2) + static(1, 2)
    frames = fed(RobotiqDecoder(), data + static(1, 3) + static(0, 4) + static(1, 4) + NEXT)
    assert numbers(frames) == [0, 1, 2, 3, 4]
    assert np.isnan(frames[1].tactile[:, 0]).tolist() == [False] * 28 + [True] * 28
    assert frames[1].tactile[:28, 0].tolist() == grid(0, 1).tolist()
    assert frames[2].tactile[:, 0].tolist() == [*grid(0, 2), *grid(1, 2)]
    assert np.isnan(frames[3].tactile[:, 0]).tolist() == [True] * 28 + [False] * 28
    assert frames[3].tactile[28:, 0].tolist() == grid(1, 3).tolist()
    assert frames[4].tactile[:, 0].tolist() == [*grid(0, 4), *grid(1, 4)]
    frames = fed(RobotiqDecoder(num_fingers=1), static(0, 0) + static(0, 1) + NEXT)
    assert [frame.tactile.shape for frame in frames] == [(28, 1)] * 2


def test_a_time_of_older_firmware_is_passed_over():
    data = packet(block(0x70, 0, [500]), block(0x10, 0, grid(0, 0)))
    (frame,) = fed(RobotiqDecoder(num_fingers=1), data + NEXT)
    assert frame.device_time is None
    assert frame.tactile[:, 0].tolist() == grid(0, 0).tolist()


@pytest.mark.parametrize(
    "bad",
    [
        packet(block(0x10, 0, range(28)), command=0x57),
        packet(block(0x10, 0, range(27))),
        packet(block(0x10, 0, range(28)), b"\x20"),
        packet(block(0x10, 2, range(28))),
        packet(block(0x80, 0, range(28))),
        packet(b""),
        static(0, 1)[:-1],
        static(0, 1)[1:],
        static(0, 1)[:3] + b"\xff" + static(0, 1)[4:],
    ],
    ids=range(9),
)
def test_corrupt_packets(bad):
    begins = bad[:1] == NEXT
    bad = bad[:1] + bad[1:].replace(NEXT, b"\x9b")
    decoder = RobotiqDecoder(num_fingers=1)
    good = [static(0, i) for i in range(9)]
    frames = fed(decoder, b"".join([*good[:2], bad, *good[2:]]) + NEXT)
    sent = [grid(0, i).tolist() for i in range(9)]
    assert [frame.tactile[:, 0].tolist() for frame in frames] == sent
    assert decoder.counts.skipped == len(bad)
    assert decoder.counts.corrupt == begins


def test_damaged_lengths_and_commands():
    draw = np.random.default_rng(0)
    packets = [frame_packets(i) for i in range(500)]
    bad = {*draw.choice(np.arange(1, 498), 15, replace=False).tolist()}
    made = [
        p[: 2 + i % 2] + bytes([int(draw.integers(256))]) + p[3 + i % 2 :] if i in bad else p
        for i, p in enumerate(packets)
    ]
    decoder = RobotiqDecoder()
    frames = fed(decoder, b"".join(made) + NEXT, draw)
    whole = [f for f in frames if not np.isnan(f.tactile).any()]
    sent = [[*grid(0, i), *grid(1, i)] for i in range(500) if i not in bad]
    assert [f.tactile[:, 0].tolist() for f in whole] == sent
    assert decoder.counts.good == len(frames)
    assert 10 <= decoder.counts.corrupt <= 25


def test_start_in_mid_packet_and_reset():
    data = b"".join(frame_packets(i) for i in range(3)) + NEXT
    for start in range(1, 60):
        decoder = RobotiqDecoder()
        frames = fed(decoder, data[start:])
        whole = [f for f in frames if not np.isnan(f.tactile).any()]
        assert [f.tactile[0].item() for f in whole] == [grid(0, 1)[0], grid(0, 2)[0]]
        assert decoder.counts.corrupt == 0
    decoder = RobotiqDecoder()
    decoder.feed(static(0, 0) + static(1, 0)[:9], 0)
    decoder.reset()
    (frame,) = decoder.feed(static(0, 1) + static(1, 1) + NEXT, 0)
    assert frame.tactile[0] == grid(0, 1)[0]
    assert decoder.counts.skipped == 9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_fingers": 3}, r"'num_fingers' must be 1 or 2 \(got 3\)"),
        ({"period": 0}, r"'period' must be between 0.001 and 0.255 seconds \(got 0\)"),
        ({"period": 0.3}, r"'period' must be between 0.001 and 0.255 seconds \(got 0.3\)"),
    ],
)
def test_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        RobotiqDecoder(**arguments)
