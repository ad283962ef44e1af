import logging
import math

import numpy as np
import pytest
from streams import assert_same_in_pieces, fed, numbers

from torch_geometric_tactile.io import LinesDecoder, TextRowsDecoder
from torch_geometric_tactile.io.decoders._bytes_description import describe_bytes
from torch_geometric_tactile.io.decoders._number_line import parse_line


def readings(frames):
    return [frame.tactile.ravel().tolist() for frame in frames]


def test_a_frame_by_hand():
    decoder = LinesDecoder(num_taxels=2, num_channels=3)
    (frame,) = decoder.feed(b"9\r\n1,2,3,4,5,1023\r\n", now=10**9)
    assert frame.tactile.tolist() == [[1, 2, 3], [4, 5, 1023]]
    assert frame.tactile.dtype == np.float32
    assert (frame.sequence, frame.time, frame.device_time) == (0, 1, None)
    assert (decoder.checksum, decoder.baudrate, decoder.unit) == ("none", 115_200, "count")
    assert repr(decoder) == "LinesDecoder(checksum='none')"


@pytest.mark.parametrize(
    ("line", "values"),
    [
        (b"1,2,3", [1, 2, 3]),
        (b"1,2,3,\r", [1, 2, 3]),
        (b" 1 ;\t2;3 ", [1, 2, 3]),
        (b"1 2\t 3", [1, 2, 3]),
        (b"-1.5e2,+.5,7.", [-150, 0.5, 7]),
        (b"a:12,b_2:13", [12, 13]),
        (b"a:12\tb: 13", [12, 13]),
        (b"inf,-ovf", [math.inf, -math.inf]),
    ],
)
def test_numbers_and_separators(line, values):
    assert parse_line(line) == values


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b",",
        b"Ready",
        b"1,2;3",
        b"1,2 3",
        b"1,5;2,5",
        b"1,,3",
        b"12:30:01",
        b"1_0,2",
        b"\xd9\xa1,2",
        b"0x12",
        b"1,-",
        b"1\r2",
    ],
)
def test_lines_that_are_not_numbers(line):
    assert parse_line(line) is None


def test_the_first_three_lines_that_agree_decide():
    decoder = LinesDecoder()
    data = b"3,4\nReady\n115200\n1\n1,2\n3,4\nok\n1,2,3\n4,5,6\n7,8,9\n1,2\n10,11,12\n"
    frames = assert_same_in_pieces(LinesDecoder, data)
    assert readings(frames) == [[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]]
    fed(decoder, data)
    assert decoder.num_taxels == 3
    assert (decoder.counts.good, decoder.counts.corrupt, decoder.counts.lost) == (4, 1, 1)
    assert numbers(frames) == [0, 1, 2, 4]
    assert decoder.counts.reason == "a line must be numbers (got b'Ready')"


def test_each_of_the_first_lines_keeps_its_arrival():
    decoder = LinesDecoder()
    frames = [
        f for now, line in enumerate([b"\n", *[b"5,6\n"] * 4]) for f in decoder.feed(line, now)
    ]
    assert [frame.received for frame in frames] == [1, 2, 3, 4]


def test_time_is_seconds_and_wraps_as_the_counter_of_a_board():
    for unit, seconds, period in (("s", 12, None), ("ms", 0.012, 2**32 / 1e3)):
        decoder = LinesDecoder(time=unit, num_taxels=2)
        (frame,) = decoder.feed(b"\n12,1,2\n", 0)
        assert (frame.device_time, decoder.clock_period) == (seconds, period)
        assert frame.tactile.tolist() == [[1], [2]]
    assert decoder.feed(b"nan,1,2\n1e300,1,2\n", 0) == []
    assert (decoder.counts.corrupt, decoder.counts.lost) == (2, 0)


def test_numbers_that_are_not_finite_are_missing():
    (frame,) = LinesDecoder(num_taxels=4).feed(b"\nnan,inf,-1e39,4\n", 0)
    np.testing.assert_array_equal(frame.tactile.ravel(), [np.nan, np.nan, np.nan, 4])


def test_cut_lines_are_skipped_and_counted():
    whole = b"100,200,300\n"
    decoder = LinesDecoder(num_taxels=3)
    frames = decoder.feed(b"00," + whole * 2 + b"100,20" + whole + b"100,200,\n" + whole, 0)
    assert readings(frames) == [[100, 200, 300]] * 2
    assert (decoder.counts.corrupt, decoder.counts.lost) == (2, 2)
    decoder.feed(whole[:1], 0)
    decoder.reset()  # the next line may be cut at its beginning
    assert readings(decoder.feed(whole[1:] + whole, 0)) == [[100, 200, 300]]


def test_a_line_has_a_limit():
    line = b"1," * 2**15 + b"1\n"
    data = b"\n1,2\n" + line + b"1,2\n" + line * 3 + b"1,2\n"
    decoder = LinesDecoder(num_taxels=2)
    frames = assert_same_in_pieces(lambda: LinesDecoder(num_taxels=2), data)
    assert numbers(frames) == [0, 2, 6]
    for _ in range(9):
        decoder.feed(b"7" * 60_000, 0)
        assert len(decoder._buffer) <= 2**16
    assert decoder.counts.skipped >= 8 * 60_000


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"time": "min"}, r"'time' must be one of none, s, ms, us \(got 'min'\)"),
        ({"num_taxels": -1}, r"'num_taxels' must be an integer from 0 to 32768 \(got -1\)"),
        ({"num_channels": 0}, r"'num_channels' must be an integer from 1 to 255 \(got 0\)"),
    ],
)
def test_refuses(settings, message):
    with pytest.raises(ValueError, match=message):
        LinesDecoder(**settings)


def test_readings_must_fill_the_channels():
    decoder = LinesDecoder(num_channels=3)
    assert decoder.feed(b"\n" + b"1,2,3,4\n" * 5, 0) == []
    assert decoder.counts.reason == "a line must have a multiple of num_channels=3 readings (got 4)"


def test_text_rows_warn_of_lines_with_a_whole_frame(caplog):
    with caplog.at_level(logging.WARNING):
        assert fed(TextRowsDecoder(shape=(2, 3)), b"512,513,900,1023,0,4\r\n" * 9, size=22) == []
    (record,) = caplog.records
    assert record.getMessage() == (
        "a line has all 6 numbers of a frame: use protocol=lines instead of text"
    )


ROWS = b"1 2 3 \r\n4 5 255 \r\n\r\n"


@pytest.mark.parametrize(
    ("data", "kind", "protocol"),
    [
        (b"2,3\r\n" + b"1,2,3\r\n" * 4, "lines of 3 numbers", "lines"),
        (b"Ready\r\n" * 9 + b"1,2,3\r\n" * 4, "lines of 3 numbers", "lines"),
        (ROWS * 4, "blocks of 2 lines of 3 numbers, separated by empty lines", "text&shape=2x3"),
        (ROWS.replace(b"255", b"256") * 4, "blocks of 2 lines of 3 numbers, separated", ""),
        (b"Ready\r\n" * 9, "text, but not lines with the same number of values", ""),
        (b"1,2\r\n1\r\n" * 9, "text, but not lines with the same number of values", ""),
        (b"\xaa\x55\x01\x02" * 9, "binary, AA 55 every 4 bytes", ""),
        (bytes(99), "binary, without a pair of bytes at regular distances", ""),
        (b"", "binary, without", ""),
    ],
    ids=range(9),
)
def test_description_of_bytes(data, kind, protocol):
    description = describe_bytes(data)
    assert description.text.startswith(f"{data[:40]!r} ({kind}")
    assert (description.protocol, description.first_grows) == (protocol, False)


@pytest.mark.parametrize(("num_lines", "grows"), [(11, True), (9, False)])
def test_first_numbers_that_grow_are_described(num_lines, grows):
    data = b"".join(b"%d,7\n" % i for i in range(num_lines))
    assert describe_bytes(data).first_grows == grows
    assert not describe_bytes(data + b"0,7\n").first_grows
