import numpy as np
import pytest
from streams import assert_same_in_pieces, fed, numbers

from torch_geometric_tactile.io import FlexiTacDecoder, TextRowsDecoder


def counts(number, shape=(16, 16)):
    return np.random.default_rng(number).integers(0, 256, shape)


def packet(number, shape=(16, 16), end="\r\n"):
    rows = [" ".join(map(str, row)) + " " + end for row in counts(number, shape).tolist()]
    return ("".join(rows) + end).encode()


def held(frame, shape=(16, 16)):
    return frame.tactile.reshape(shape).tolist()


def small():
    return TextRowsDecoder(shape=(2, 3))


FRAME = b"1 2 3 \r\n4 5 255 \r\n\r\n"


def test_a_frame_by_hand():
    decoder = small()
    (frame,) = decoder.feed(b"\r\n" + FRAME, now=10**9)
    assert frame.tactile.tolist() == [[1], [2], [3], [4], [5], [255]]
    assert frame.tactile.dtype == np.float32
    assert (frame.sequence, frame.time, frame.device_time) == (0, 1, None)
    assert (decoder.checksum, decoder.baudrate) == ("none", 2_000_000)


@pytest.mark.parametrize("shape", [(16, 16), (12, 32), (1, 1)])
@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_shapes_and_line_ends(shape, end):
    data = end.encode() + b"".join(packet(i, shape, end) for i in range(3))
    frames = fed(TextRowsDecoder(shape), data, size=13)
    assert [held(frame, shape) for frame in frames] == [counts(i, shape).tolist() for i in range(3)]


def test_the_first_frame_may_have_lost_its_beginning():
    decoder = small()
    assert decoder.feed(b"23 2 3 \r\n4 5 255 \r\n\r\n", 0) == []
    assert (decoder.counts.corrupt, decoder.counts.skipped) == (0, 19)
    assert len(decoder.feed(FRAME, 0)) == 1
    decoder.reset()
    assert decoder.feed(FRAME[3:], 0) == []
    assert numbers(decoder.feed(FRAME, 0)) == [2]


@pytest.mark.parametrize(
    "bad",
    [
        b"1 2 3 \r\n\r\n",
        b"1 2 3 \r\n4 5 6 \r\n7 8 9 \r\n\r\n",
        b"1 2 3 \r\n4 5 6 7 \r\n\r\n",
        b"1 2 3 \r\n4 5 256 \r\n\r\n",
        b"1 2 3 \r\n4 5 1_0 \r\n\r\n",
        b"1 2 3 \r\n4 5 \xd9\xa1 \r\n\r\n",
        b"1 2 3 \r\n4 5 0001 \r\n\r\n",
        b"1 2 3 \r\n4 5 " + b"9" * 5000 + b" \r\n\r\n",
        b"1 2 3 \r\n4 5" + b" " * 50 + b"6 \r\n\r\n",
    ],
)
def test_corrupt_frames(bad):
    decoder = small()
    found = fed(decoder, b"\n" + FRAME + bad + FRAME)
    assert [held(frame, (2, 3)) for frame in found] == 2 * [[[1, 2, 3], [4, 5, 255]]]
    got = decoder.counts
    assert (got.good, got.corrupt, got.skipped) == (2, 1, len(bad) - 2)
    assert got.lost == round((bad.count(b"\n") - 1) / 2)
    assert numbers(found) == [0, 1 + got.lost]


def test_damage_costs_its_own_frame_or_two():
    draw = np.random.default_rng(0)
    packets = [packet(i) for i in range(400)]
    bad = {*draw.choice(np.arange(1, 399), 12, replace=False).tolist()}
    made = [p[:50] + b"x" + p[51:] if i in bad else p for i, p in enumerate(packets)]
    decoder = TextRowsDecoder()
    frames = fed(decoder, b"\n" + b"".join(made), draw)
    intact = [i for i in range(400) if i not in bad]
    assert numbers(frames) == intact
    assert [held(frame) for frame in frames] == [counts(i).tolist() for i in intact]
    assert (decoder.counts.corrupt, decoder.counts.lost) == (12, 12)
    decoder = TextRowsDecoder()  # two frames become one
    data = packets[0] + packets[1][:-2] + b"".join(packets[2:5])
    assert numbers(fed(decoder, b"\n" + data)) == [0, 3, 4]
    assert (decoder.counts.corrupt, decoder.counts.lost) == (1, 2)


def test_rows_with_many_blanks_are_the_same_in_pieces():
    for size in range(25, 45):
        row = b"1 2 3 \r\n4 5" + b" " * size + b"6 \r\n"
        assert_same_in_pieces(small, b"\n" + row + b"\r\n" + FRAME + row * 9 + b"\n" + FRAME)


@pytest.mark.parametrize("decoder", [TextRowsDecoder, FlexiTacDecoder])
@pytest.mark.parametrize("shape", [(0, 3), (16,), (2, 1025), (2, 3, 4)])
def test_shapes_are_rows_and_columns_up_to_1024_each(decoder, shape):
    assert decoder((2, 1024)).shape == (2, 1024)
    message = r"'shape' must be rows and columns, from 1 to 1024 each .*\(got \("
    with pytest.raises(ValueError, match=message):
        decoder(shape)
