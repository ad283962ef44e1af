import numpy as np
import pytest
from streams import assert_same_in_pieces, damaged, fed, numbers

from torch_geometric_tactile.io import FlexiTacDecoder

HEADER = b"\xaa\x55"
SIZE = 2 + 384


def packet(number):
    counts = np.random.default_rng(number).integers(0, 256, 384).astype(np.uint8)
    return HEADER + counts.tobytes()


def held(frame):
    return HEADER + frame.tactile.astype(np.uint8).tobytes()


def test_a_frame_by_hand():
    decoder = FlexiTacDecoder(shape=(2, 3))
    frames = decoder.feed(HEADER + bytes([1, 2, 3, 4, 5, 255]) + HEADER, now=10**9)
    (frame,) = frames
    assert frame.tactile.dtype == np.float32
    assert frame.tactile.tolist() == [[1], [2], [3], [4], [5], [255]]
    assert (frame.sequence, frame.device_time, frame.time) == (0, None, 1)
    assert (decoder.checksum, decoder.baudrate) == ("none", 2_000_000)
    assert FlexiTacDecoder().shape == (12, 32)


def test_a_frame_is_there_with_its_last_byte():
    decoder = FlexiTacDecoder()
    decoder.feed(packet(0) + packet(1), 0)  # the first waits for the header of the second
    assert decoder.feed(packet(2)[:-1], 0) == []
    assert len(decoder.feed(packet(2)[-1:], 0)) == 1


def test_headers_among_the_readings_are_readings():
    made = []
    for number in range(40):
        row = bytearray(packet(number))
        place = 2 + (37 * number) % 380
        row[place : place + 2] = HEADER
        row[-1] = 0xAA if number % 3 == 0 else row[-1]
        made.append(bytes(row))
    frames = assert_same_in_pieces(FlexiTacDecoder, b"".join(made) + HEADER)
    assert [held(frame) for frame in frames] == made


def test_opened_in_the_middle_of_a_frame_with_a_header_in_it():
    row = bytearray(packet(0))
    row[100:102] = HEADER
    decoder = FlexiTacDecoder()
    frames = fed(decoder, bytes(row)[50:] + b"".join(packet(i) for i in range(1, 5)), size=7)
    assert [held(frame) for frame in frames] == [packet(i) for i in range(1, 5)]


@pytest.mark.parametrize("missing", [1, 2, 3, 100])
def test_lost_bytes_are_found_out(missing):
    for place in (0, 1, 2, 100, SIZE - missing):
        short = packet(1)[:place] + packet(1)[place + missing :]
        data = packet(9) + packet(0) + short + packet(2) + packet(3) + packet(4)
        decoder = FlexiTacDecoder()
        frames = fed(decoder, data, size=1 if missing < 3 else 50)
        assert [held(frame) for frame in frames] == [packet(i) for i in (9, 0, 2, 3, 4)]
        assert numbers(frames) == [0, 1, 3, 4, 5]
        assert decoder.counts.lost == 1


def test_damage_costs_its_packet_and_seldom_a_neighbour():
    draw = np.random.default_rng(0)
    packets = [packet(i) for i in range(300)]
    made, intact = damaged(packets, 0.1, draw)
    frames = fed(FlexiTacDecoder(), b"".join(made) + HEADER, draw)
    found = {held(frame) for frame in frames}
    missed = [i for i in intact.tolist() if packets[i] not in found]
    # After damage a frame waits for the header of the next, which may be damaged as well.
    assert all(i - 1 not in intact and i + 1 not in intact for i in missed if i < 299)
    assert len(missed) < 6
