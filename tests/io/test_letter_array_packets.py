import zlib

import numpy as np
import pytest
from streams import assert_same_in_pieces, damaged, fed, numbers

from torch_geometric_tactile.io import LetterArrayDecoder, encode_letter_array

SIZE = 2060


def counts(number):
    return np.random.default_rng(number).integers(0, 2**16, (32, 32))


def packets(count, first=0):
    return [encode_letter_array(first + i, counts(i)) for i in range(count)]


def test_bytes_by_hand():
    sent = np.zeros((32, 32), int)
    sent[0, 1], sent[31, 31] = 0x0102, 65535
    made = encode_letter_array(0x01020304, sent)
    assert len(made) == SIZE
    assert made[:12].hex(" ") == "a5 5a 4c 41 04 03 02 01 00 00 02 01"
    assert made[-6:-4] == b"\xff\xff"
    assert int.from_bytes(made[-4:], "little") == zlib.crc32(made[:-4])
    decoder = LetterArrayDecoder()
    (frame,) = decoder.feed(made, 10**9)
    assert (frame.sequence, frame.time, frame.device_time) == (0x01020304, 1, None)
    assert frame.tactile.shape == (1024, 1)
    assert frame.tactile.ravel().tolist() == sent.ravel().tolist()
    assert (decoder.checksum, decoder.baudrate) == ("crc32", 921600)


def test_pieces():
    assert numbers(assert_same_in_pieces(LetterArrayDecoder, b"".join(packets(3)))) == [0, 1, 2]
    data = b"\xa5\x5a" + packets(1)[0]
    for place in range(1, len(data), 7):
        decoder = LetterArrayDecoder()
        assert len(decoder.feed(data[:place], 0) + decoder.feed(data[place:], 0)) == 1
        assert decoder.counts.skipped == 2


def test_damaged_packets_cost_only_themselves():
    draw = np.random.default_rng(0)
    whole = packets(600)
    made, intact = damaged(whole, 0.03, draw)
    decoder = LetterArrayDecoder()
    frames = fed(decoder, b"".join(made), draw)
    assert len(intact) < 595
    assert numbers(frames) == intact.tolist()
    for frame in frames:
        assert (frame.tactile.reshape(32, 32) == counts(frame.sequence)).all()
    assert decoder.counts.good == len(intact)
    assert decoder.counts.lost == intact[-1] + 1 - len(intact)
    assert decoder.counts.skipped == sum(map(len, made)) - SIZE * len(intact)


def test_exact_counts_and_reset():
    one, two, three, four = packets(4)
    bad = two[:100] + bytes([two[100] ^ 1]) + two[101:]
    decoder = LetterArrayDecoder()
    found = decoder.feed(one + bad + three + four[:50], 0)
    decoder.reset()
    assert numbers(found) == [0, 2]
    found = decoder.feed(four[50:] + four, 0)
    assert numbers(found) == [3]
    got = decoder.counts
    assert (got.good, got.corrupt, got.lost, got.skipped) == (3, 1, 1, 2 * SIZE)


def test_a_header_inside_of_the_readings():
    sent = np.zeros((32, 32), int)
    sent[3, :2] = 0x5AA5, 0x414C
    data = encode_letter_array(5, sent)
    assert data.count(b"\xa5\x5aLA") == 2
    for start in (0, 9):
        frames = fed(LetterArrayDecoder(), data[start:] + b"".join(packets(2, 6)))
        assert numbers(frames) == [5, 6, 7][start > 0 :]


def test_numbers_go_on_over_the_wrap_and_a_start_over():
    decoder = LetterArrayDecoder()
    data = b"".join(packets(3, 2**32 - 2)[::2] + packets(1, 0) + packets(1, 0))
    assert numbers(fed(decoder, data)) == [2**32 - 2, 2**32, 2**32 + 1, 2**32 + 2]
    assert decoder.counts.lost == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"counts": np.zeros((16, 16))}, r"'counts' must have shape \(32, 32\).*\(16, 16\)"),
        ({"counts": np.full((32, 32), 65536)}, "integers from 0 to 65535"),
        ({"counts": np.full((32, 32), 0.5)}, "integers from 0 to 65535"),
        ({"sequence": -1}, r"'sequence' must be at least 0 \(got -1\)"),
    ],
)
def test_encode_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        encode_letter_array(**{"sequence": 0, "counts": np.zeros((32, 32)), **arguments})


def test_encodes_frames_as_they_are_read():
    (frame,) = fed(LetterArrayDecoder(), packets(1)[0])
    assert encode_letter_array(0, frame.tactile) == packets(1)[0]
