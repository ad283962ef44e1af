"""Bytes as they come from a port: in pieces, and damaged."""

import numpy as np


def fed(decoder, data, draw=None, size=None):
    """The frames of a stream, fed whole, in pieces of a size, or in random pieces."""
    frames, place = [], 0
    while place < len(data):
        step = size or (len(data) if draw is None else int(draw.integers(1, 200)))
        frames += decoder.feed(data[place : place + step], now=place)
        place += step
    return frames


def plain(frames):
    """What frames hold, as values that compare; without when they were received."""
    return [
        (
            frame.sequence,
            frame.device_time,
            frame.tactile.shape,
            frame.tactile.tobytes(),
            None if frame.joint is None else frame.joint.tobytes(),
            {name: value.tobytes() for name, value in frame.extra.items()},
        )
        for frame in frames
    ]


def numbers(frames):
    return [frame.sequence for frame in frames]


def assert_same_in_pieces(make, data):
    """Whatever the pieces are, the frames and counts are the same; returns the frames."""
    whole = make()
    frames = fed(whole, data)
    for size in (1, 2, 3, 7, 64):
        other = make()
        assert plain(fed(other, data, size=size)) == plain(frames)
        assert other.counts == whole.counts
    return frames


def assert_split_anywhere(make, data):
    """Cut in two at any byte, it is the same; returns the frames."""
    whole = make()
    frames = fed(whole, data)
    for place in range(1, len(data)):
        other = make()
        found = other.feed(data[:place], 0) + other.feed(data[place:], 1)
        assert plain(found) == plain(frames)
        assert other.counts == whole.counts
    return frames


def with_bad_bytes(packet, draw, number=1):
    """A packet with other bytes at some places."""
    packet = bytearray(packet)
    for place in draw.choice(len(packet), min(number, len(packet)), replace=False):
        packet[place] ^= int(draw.integers(1, 256))
    return bytes(packet)


def damaged(packets, share, draw):
    """Packets of which a share is damaged: bytes changed, lost, or put in; and which are intact."""
    bad = draw.random(len(packets)) < share
    kinds = (
        lambda packet: with_bad_bytes(packet, draw, int(draw.integers(1, 9))),
        lambda packet: packet[: int(draw.integers(len(packet)))],
        lambda packet: packet[int(draw.integers(1, len(packet))) :],
        lambda packet: packet[:5] + bytes(draw.integers(0, 256, 3).tolist()) + packet[5:],
    )
    made = [
        kinds[int(draw.integers(len(kinds)))](packet) if is_bad else packet
        for packet, is_bad in zip(packets, bad, strict=True)
    ]
    return made, np.flatnonzero(~bad)
