import numpy as np
from streams import damaged, fed, numbers

from torch_geometric_tactile.io import M1616Decoder

HEADER = b"\xaa\xab\xac"
SIZE = 519


def packet(number, tail=b"\0\1\2\3"):
    counts = np.random.default_rng(number).integers(0, 4096, 256)
    return HEADER + counts.astype(">u2").tobytes() + tail


def held(frame):
    return HEADER + frame.tactile.astype(">u2").tobytes() + b"\0\1\2\3"


def test_a_frame_by_hand():
    counts = np.zeros((16, 16), ">u2")
    counts[0, 1], counts[15, 15] = 0x0102, 4095
    decoder = M1616Decoder()
    (frame,) = decoder.feed(HEADER + counts.tobytes() + b"\xff" * 4, now=10**9)
    assert frame.tactile.shape == (256, 1)
    assert frame.tactile.dtype == np.float32
    assert frame.tactile[[1, 255, 16], 0].tolist() == [258, 4095, 0]
    assert (frame.sequence, frame.device_time, frame.time) == (0, None, 1)
    assert (decoder.checksum, decoder.baudrate) == ("none", 115200)


def test_a_frame_is_there_with_its_last_byte():
    decoder = M1616Decoder()
    assert decoder.feed(packet(0)[:-1], 0) == []
    assert len(decoder.feed(packet(0)[-1:], 0)) == 1


def test_lost_bytes_are_found_out():
    for missing in (1, 2, 3, 100):
        for place in (0, 3, 100, SIZE - missing):
            short = packet(1)[:place] + packet(1)[place + missing :]
            data = packet(0) + short + packet(2) + packet(3)
            decoder = M1616Decoder()
            frames = fed(decoder, data, size=1 if missing < 3 else 50)
            assert [held(frame) for frame in frames] == [packet(0), packet(2), packet(3)]
            assert numbers(frames) == [0, 2, 3]
            counts = decoder.counts
            assert (counts.good, counts.lost, counts.skipped) == (3, 1, SIZE - missing)
            assert counts.corrupt == (place > 2)


def test_damaged_headers_and_lost_bytes():
    draw = np.random.default_rng(0)
    packets = [packet(i) for i in range(400)]
    bad = {*draw.choice(np.arange(1, 399), 20, replace=False).tolist()}
    made = [
        data if i not in bad else data[: i % SIZE] if i % 2 else b"\xaa\xab\x00" + data[3:]
        for i, data in enumerate(packets)
    ]
    decoder = M1616Decoder()
    frames = fed(decoder, b"".join(made), draw)
    assert [held(frame) for frame in frames] == [p for i, p in enumerate(packets) if i not in bad]
    assert decoder.counts.good == 380


def test_one_percent_of_the_packets_damaged():
    draw = np.random.default_rng(3)
    packets = [packet(i) for i in range(1500)]
    made, intact = damaged(packets, 0.01, draw)
    frames = fed(M1616Decoder(), b"".join(made), draw)
    found = [held(frame) for frame in frames]
    assert [data for data in found if data in {*packets}] == [packets[i] for i in intact]


def test_start_in_mid_packet_and_reset():
    data = packet(0) + packet(1)
    for start in (1, 2, 3, 500):
        decoder = M1616Decoder()
        assert [held(frame) for frame in fed(decoder, data[start:])] == [packet(1)]
        assert (decoder.counts.skipped, decoder.counts.lost) == (SIZE - start, 0)
    decoder = M1616Decoder()
    decoder.feed(data[:600], 0)
    decoder.reset()
    assert numbers(decoder.feed(data, 0)) == [1, 2]
    assert decoder.counts.skipped == 600 - SIZE


def test_a_header_among_large_readings_costs_its_packet():
    counts = np.full(256, 5, ">u2")
    counts[10:12] = 0xAAAB, 0xAC00
    bad = HEADER + counts.tobytes() + bytes(4)
    assert numbers(fed(M1616Decoder(), packet(0) + bad + packet(1))) == [0, 2]
