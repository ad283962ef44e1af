import numpy as np
import pytest
from streams import damaged, fed

from torch_geometric_tactile.io import PaXiniDecoder, decoder_of


def checked(body):
    return body + bytes([-sum(body) % 256])


def packet(number, points=(2, 1), error=0):
    size = sum(6 + 3 * count for count in points)
    data = np.random.default_rng(number).integers(0, 256, size, np.uint8).tobytes()
    return checked(b"\xaa\x56\x00" + (size + 1).to_bytes(2, "little") + bytes([error]) + data)


def decoder():
    return PaXiniDecoder(points=(2, 1))


def test_a_frame_by_hand():
    thumb = [10, 1, 255, 1, 255, 1, 1, 2, 3, 128, 127, 200]  # of the force, the lower bytes count
    index = [0, 0, 0, 0, 5, 0, 0, 0, 7]
    body = b"\xaa\x56\x00" + (22).to_bytes(2, "little") + b"\x04" + bytes(thumb + index)
    one = decoder()
    (frame,) = one.feed(checked(body), now=10**9)
    expected = [[0.1, 0.2, 0.3], [-12.8, 12.7, 20.0], [0, 0, 0.7]]
    assert np.allclose(frame.tactile, expected)
    assert np.allclose(frame.extra["force"], [[1, -0.1, 25.5], [0, 0, 0.5]])
    assert frame.extra["error"].tolist() == [4]
    assert (frame.sequence, frame.time, one.unit, one.baudrate) == (0, 1, "newton", 921_600)


def test_start_asks_for_frames_and_its_answer_is_none():
    one = decoder()
    assert one.start() == bytes.fromhex("55 AA 00 10 17 00 01 00 01 D8")
    assert one.feed(bytes.fromhex("AA 56 00 01 00 00 FF"), now=0) == []
    assert (one.counts.corrupt, one.counts.skipped) == (0, 0)


def test_intact_packets_are_found_among_damaged_ones():
    packets = [packet(i) for i in range(300)]
    made, intact = damaged(packets, 0.1, np.random.default_rng(0))
    one = decoder()
    frames = fed(one, b"".join(made))
    assert 0 <= len(frames) - len(intact) <= 3  # one of 256 passes the sum
    assert one.counts.corrupt > 10


def test_other_modules_than_those_of_the_board_make_no_frame():
    one = PaXiniDecoder(points=(31,))
    assert one.feed(packet(0), now=0) == []
    assert one.counts.corrupt >= 1
    assert decoder_of("paxini", points="52x31").points == (52, 31)


@pytest.mark.parametrize("points", [(), (0,), (513,), (1,) * 29])
def test_points_of_each_module(points):
    with pytest.raises(ValueError, match=r"'points' must be the number of points of each of up to"):
        PaXiniDecoder(points=points)
