import struct
import sys
import zlib

import numpy as np
import pytest

cobs = pytest.importorskip("cobs.cobs", reason="needs the extra 'live'")

from streams import (  # noqa: E402
    assert_same_in_pieces,
    damaged,
    fed,
    numbers,
    plain,
    with_bad_bytes,
)

from torch_geometric_tactile.io import CobsDecoder, encode_packet  # noqa: E402


def reading(number, taxels=4, channels=3):
    return np.random.default_rng(number).integers(0, 2**16, (taxels, channels)).astype(np.uint16)


def packets(count, first=0):
    return [
        encode_packet(first + i, reading(i), device_time=i / 900, joint=np.float32([i, -i, 0.5]))
        for i in range(count)
    ]


def framed(content):
    return b"\0" + cobs.encode(content + zlib.crc32(content).to_bytes(4, "little")) + b"\0"


def test_bytes_by_hand():
    content = struct.pack("<BBBBHIIBffhhhh", 1, 3, 0, 2, 2, 9, 1_500_000, 2, 0.5, -1, 1, -2, 3, 300)
    made = encode_packet(9, np.int16([[1, -2], [3, 300]]), 1.5, np.float32([0.5, -1]))
    assert made == framed(content)
    decoder = CobsDecoder()
    (frame,) = decoder.feed(made, now=3_000_000_000)
    assert (frame.sequence, frame.device_time, frame.received, frame.time) == (9, 1.5, 3 * 10**9, 3)
    assert frame.tactile.tolist() == [[1, -2], [3, 300]]
    assert frame.joint.tolist() == [0.5, -1]
    assert frame.tactile.dtype == frame.joint.dtype == np.float32
    assert decoder.counts.good == 1
    assert decoder.counts.corrupt == decoder.counts.skipped == decoder.counts.lost == 0


def test_check_value_of_the_checksum():
    content = cobs.decode(encode_packet(0, np.uint16([[1]])).strip(b"\0"))
    assert zlib.crc32(b"123456789") == 0xCBF43926
    assert int.from_bytes(content[-4:], "little") == zlib.crc32(content[:-4])


@pytest.mark.parametrize("kind", [np.int16, np.uint16, np.float32])
def test_types(kind):
    values = np.array([[0, 1, 255], [256, 32767, 7]], dtype=kind)
    if kind is np.int16:
        values[0, 0] = -32768
    (frame,) = CobsDecoder().feed(encode_packet(0, values), 0)
    assert np.array_equal(frame.tactile, values)
    assert (frame.joint, frame.device_time, dict(frame.extra)) == (None, None, {})


def test_missing_stays_missing_and_infinity_is_missing():
    sent = np.float32([[1, np.nan], [np.inf, -np.inf]])
    (frame,) = CobsDecoder().feed(encode_packet(0, sent, joint=np.float32([np.inf, 1])), 0)
    assert np.isnan(frame.tactile).tolist() == [[False, True], [True, True]]
    assert np.isnan(frame.joint).tolist() == [True, False]


def test_big_endian_and_double_are_converted():
    for values in (np.array([[1, 300]], ">i2"), np.array([[1.0, 300.0]])):
        (frame,) = CobsDecoder().feed(encode_packet(0, values), 0)
        assert frame.tactile.tolist() == [[1, 300]]


def test_damaged_packets_cost_only_themselves():
    draw = np.random.default_rng(0)
    whole = packets(4000)
    made, intact = damaged(whole, 0.01, draw)
    decoder = CobsDecoder()
    frames = fed(decoder, b"".join(made), draw)
    assert 20 < 4000 - len(intact) < 80
    assert numbers(frames) == intact.tolist()
    expected = CobsDecoder()
    before = [expected.feed(whole[i], 0)[0] for i in intact]
    assert plain(frames) == plain(before)
    counts = decoder.counts
    # Lost, and not after the last intact one.
    assert counts.lost == intact[-1] + 1 - len(intact)
    assert counts.good == len(intact)
    kept = sum(len(whole[i]) for i in intact)
    zeros = b"".join(made).count(0) - 2 * len(intact)
    assert counts.skipped == len(b"".join(made)) - kept - zeros


def test_any_single_damaged_byte_costs_one_packet():
    draw = np.random.default_rng(1)
    before, middle, after = packets(3)
    for place in range(len(middle)):
        for value in (0, int(draw.integers(1, 256))):
            bad = middle[:place] + bytes([middle[place] ^ value or 0]) + middle[place + 1 :]
            if bad == middle:
                continue
            assert numbers(fed(CobsDecoder(), before + bad + after)) in ([0, 2], [0, 1, 2])
    # Only a zero at an end can be damaged without a loss: there are two between packets.
    assert numbers(fed(CobsDecoder(), before + middle[:-1] + b"\7" + after)) == [0, 2]
    assert numbers(fed(CobsDecoder(), before + b"\7" + middle[1:] + after)) == [0, 2]
    assert numbers(fed(CobsDecoder(), before + middle[1:] + after)) == [0, 1, 2]


def test_exact_counts():
    one, two, three = packets(3)
    bad = with_bad_bytes(two[1:-1], np.random.default_rng(5)).replace(b"\0", b"\1")
    decoder = CobsDecoder()
    assert numbers(fed(decoder, one[10:] + one + b"\0" + bad + b"\0\0" + three)) == [0, 2]
    counts = decoder.counts
    assert (counts.good, counts.corrupt, counts.lost) == (2, 1, 1)
    assert counts.skipped == len(one[10:-1]) + len(bad)


def test_start_in_mid_packet():
    stream = b"".join(packets(3))
    first = len(packets(1)[0])
    for place in range(1, first):
        decoder = CobsDecoder()
        assert numbers(fed(decoder, stream[place:])) in ([1, 2], [0, 1, 2])
        assert decoder.counts.corrupt == decoder.counts.lost == 0


def test_numbers_go_on_over_the_wrap():
    decoder = CobsDecoder()
    first = 2**32 - 2
    frames = fed(decoder, b"".join(p for i, p in enumerate(packets(6, first)) if i != 3))
    assert numbers(frames) == [first, first + 1, first + 2, first + 4, first + 5]
    assert decoder.counts.lost == 1


@pytest.mark.parametrize("last", [100, 70_000, 2**31 + 7, 2**32 - 3_000_000])
def test_a_device_that_starts_over_lost_nothing(last):
    decoder = CobsDecoder()
    frames = fed(decoder, packets(1, last)[0] + b"".join(packets(2, 3)))
    assert numbers(frames) == [last, last + 1, last + 2]
    assert decoder.counts.lost == 0


def test_a_long_gap_is_a_loss():
    decoder = CobsDecoder()
    assert numbers(fed(decoder, packets(1, 5)[0] + packets(1, 3_000_000)[0])) == [5, 3_000_000]
    assert decoder.counts.lost == 2_999_994


def test_reset_forgets_half_a_packet_and_keeps_the_number():
    one, two, three = packets(3)
    decoder = CobsDecoder()
    found = decoder.feed(one + two[:-3], 0)
    decoder.reset()
    assert decoder.counts.skipped == len(two) - 4
    found += decoder.feed(two[-3:] + three, 0)
    assert numbers(found) == [0, 2]
    assert (decoder.counts.corrupt, decoder.counts.lost) == (0, 1)


def test_endless_garbage_takes_no_memory():
    decoder = CobsDecoder(max_size=100)
    for _ in range(50):
        assert decoder.feed(b"\1" * 33, 0) == []
        assert len(decoder._buffer) <= 100
    assert numbers(decoder.feed(b"".join(packets(2)), 0)) == [0, 1]
    assert decoder.counts.skipped == 50 * 33
    assert_same_in_pieces(
        lambda: CobsDecoder(max_size=100), b"\0" + b"\1" * 101 + packets(1)[0] + b"\1" * 400
    )
    assert_same_in_pieces(lambda: CobsDecoder(max_size=100), b"\0" + b"\1" * 100 + packets(1)[0])


def content(**changed):
    fields = {"version": 1, "flags": 0, "kind": 1, "channels": 1, "taxels": 1, **changed}
    rest = fields.pop("rest", b"\1\2")
    return struct.pack("<BBBBHI", *fields.values(), 5) + rest


@pytest.mark.parametrize(
    "bad",
    [
        content(version=2),
        content(flags=4),
        content(kind=3),
        content(channels=0, rest=b""),
        content(taxels=0, rest=b""),
        content(taxels=2),
        content(rest=b"\1\2\3"),
        content(flags=1, rest=b"\1\2"),
        content(flags=2, rest=b""),
        content(flags=2, rest=b"\0\1\2"),
        content(flags=2, rest=b"\3\1\2"),
        content(kind=2, rest=b"\1\2"),
        content(taxels=65535, channels=255),
    ],
    ids=range(13),
)
def test_whole_packets_that_cannot_be(bad):
    assert len(fed(CobsDecoder(), framed(content()))) == 1
    decoder = CobsDecoder()
    assert fed(decoder, b"\0" + framed(bad)) == []
    assert decoder.counts.corrupt == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tactile": np.zeros(3)}, r"'tactile' must have shape .*\(3,\)"),
        ({"tactile": np.zeros((1, 256))}, r"'tactile' must have shape .*\(1, 256\)"),
        ({"tactile": np.zeros((2**16, 1))}, r"'tactile' must have shape .*\(65536, 1\)"),
        ({"tactile": np.zeros((1, 1), int)}, r"must be int16, uint16 or floats \(got int64\)"),
        ({"sequence": -1}, r"'sequence' must be at least 0 \(got -1\)"),
        ({"joint": np.zeros((2, 2))}, r"'joint' must have shape \(num_joints,\).*\(2, 2\)"),
    ],
)
def test_encode_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        encode_packet(**{"sequence": 0, "tactile": np.zeros((1, 1)), **arguments})


def test_decoder_refuses_a_size_below_any_packet():
    with pytest.raises(ValueError, match=r"'max_size' must be at least 14 bytes \(got 13\)"):
        CobsDecoder(max_size=13)


def test_missing_library_gives_the_pip_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "cobs", None)
    for call in (CobsDecoder, lambda: encode_packet(0, np.zeros((1, 1)))):
        with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[live\]'"):
            call()


def test_repr():
    assert repr(CobsDecoder()) == "CobsDecoder(checksum='crc32')"
    assert CobsDecoder.clock_period == pytest.approx(4294.967296)
