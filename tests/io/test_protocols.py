import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from fuzz import stream_bases
from streams import assert_split_anywhere

from torch_geometric_tactile.io import (
    PROTOCOLS,
    AnySkinDecoder,
    Decoder,
    RobotiqDecoder,
    decoder_of,
)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_protocol_has_a_decoder(name):
    if name == "cobs":
        pytest.importorskip("cobs", reason="needs the extra 'live'")
    decoder = decoder_of(name)
    assert isinstance(decoder, Decoder)
    assert decoder.checksum in ("none", "sum", "crc32")
    assert decoder.feed(b"", 0) == []


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_stream_that_is_cut_in_two_anywhere_gives_the_same_frames(name, tmp_path):
    if name == "cobs":
        pytest.importorskip("cobs", reason="needs the extra 'live'")
    getattr(stream_bases, name)(tmp_path)
    make = partial(decoder_of, name, **stream_bases.SETTINGS[name])
    for path in tmp_path.iterdir():
        content = path.read_bytes()[:4200]  # two packets of the longest
        assert len(assert_split_anywhere(make, content)) > 1


# Bytes that a decoder of the streams of the fuzz run may keep: those of a packet, or of five.
LIMITS = {
    "cobs": 400,
    "anyskin": 5 * 34,
    "flexitac": 16,
    "m1616": 522,
    "lines": 2**16,
    "paxini": 28,
    "text": 36,
    "robotiq": 260,
    "letter_array": 2060,
}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_garbage_takes_no_memory_and_frames_follow_it(name, tmp_path):
    if name == "cobs":
        pytest.importorskip("cobs", reason="needs the extra 'live'")
    getattr(stream_bases, name)(tmp_path)
    stream = min(tmp_path.iterdir()).read_bytes()
    decoder = decoder_of(name, **stream_bases.SETTINGS[name])
    draw = np.random.default_rng(0)
    random = bytes(draw.integers(0, 256, 99).tolist())
    for junk in (bytes(99), stream[:3] * 40, random, b"\n" * 99):
        for _ in range(30):
            decoder.feed(junk, 0)
            assert len(decoder._buffer) <= LIMITS[name]
    assert len(decoder.feed(stream, 0)) > 2


def test_settings_as_values_and_as_texts():
    assert decoder_of("anyskin", num_magnetometers=2).stride == 34
    assert decoder_of("anyskin", num_magnetometers="2").stride == 34
    assert isinstance(decoder_of("anyskin"), AnySkinDecoder)
    assert decoder_of("text", shape=(12, 32)).shape == (12, 32)
    assert decoder_of("text", shape="12x32").shape == (12, 32)
    robotiq = decoder_of("robotiq", period="0.016", num_fingers="1")
    assert isinstance(robotiq, RobotiqDecoder)
    assert (robotiq.period, robotiq.num_fingers) == (0.016, 1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: decoder_of("reskin"),
            r"one of cobs, anyskin, flexitac, m1616, paxini, text, lines, robotiq, letter_array "
            r"\(got 'reskin'\)",
        ),
        (
            lambda: decoder_of("text", size=3),
            r"'text' must be one of shape, or 'baudrate' of the port",
        ),
        (
            lambda: decoder_of("m1616", a=1),
            r"'m1616' must be one of none, or .* \(got 'a'\)",
        ),
        (lambda: decoder_of("text", shape="12"), r"'shape' must be rows and columns"),
        (
            lambda: decoder_of("text", shape="axb"),
            r"'shape' must have a value like 16x16 \(got 'axb'\)",
        ),
        (
            lambda: decoder_of("anyskin", num_magnetometers="five"),
            r"'num_magnetometers' must have a value like 5 \(got 'five'\)",
        ),
        (lambda: decoder_of("robotiq", period="nan"), r"'period' must be between"),
    ],
    ids=range(7),
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_decoders_import_without_torch():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from torch_geometric_tactile.io import decoder_of, encode_letter_array\n"
        "assert decoder_of('anyskin').feed(b'x' * 200, 0) == []\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
