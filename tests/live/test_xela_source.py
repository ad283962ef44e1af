import json
import socket

import numpy as np
import pytest
from fake_source import wait_until
from xela_server import message, sensor

pytest.importorskip("websockets", reason="needs the extra 'live'")

from xela_websocket import CLOSE, server

from torch_geometric_tactile.live import Stream, XelaSource

LONG = 20.0
WELCOME = json.dumps({"message": "Welcome"})


@pytest.fixture(autouse=True)
def _no_long_wait_for_the_first_message(monkeypatch, request):
    if "when_it_is_open" not in request.node.name:
        monkeypatch.setattr("torch_geometric_tactile.live.xela_source._FIRST_MESSAGE_SECONDS", 0.05)


def text(number, **changed):
    return json.dumps(message(number, **changed))


def read_one(source):
    for _ in range(100):
        frames = source.read(LONG)
        if frames:
            return frames[0]
    raise AssertionError("no frame came")


def test_xela_source_reads_messages():
    with server() as (url, send), XelaSource(url) as source:
        send(WELCOME, text(7), text(8))
        first, second = read_one(source), read_one(source)
    assert (first.sequence, second.sequence) == (7, 8)
    assert first.tactile.tolist() == [[32854, 32876, 35900], [32373, 32787, 36150]]
    assert (first.device_time, second.device_time) == (0.7, 0.8)
    assert first.tactile.dtype == np.float32
    assert source.meta == {
        "unit": "count",
        "taxels": [2],
        "models": ["uSPa22"],
        "server_version": "1.8.0",
    }
    assert source.counts.good == 2
    assert source.counts.corrupt == source.counts.lost == source.repeats == 0


def test_xela_source_knows_the_sensors_when_it_is_open():
    with server() as (url, send):
        send(WELCOME, text(7))
        with XelaSource(url) as source:
            assert source.meta["models"] == ["uSPa22"]
            assert read_one(source).sequence == 7


def test_xela_source_forces():
    with server() as (url, send), XelaSource(url, forces=True) as source:
        send(text(7))
        tactile = read_one(source).tactile
    np.testing.assert_array_equal(tactile, np.float32([[0.5, -0.25, 1.0], [np.nan, 0.0, 2.0]]))
    assert source.meta["unit"] == "newton"


def test_xela_source_keeps_temperature_and_updates_of_each_taxel():
    both = sensor(temp=[300.5, 301.0], ups=[58.5, 60])
    without = sensor(temp=[300.5], ups="fast")
    with server() as (url, send), XelaSource(url) as source:
        send(text(1, **{"1": both}), text(2, **{"1": without}), text(3))
        frame, other, bare = (read_one(source) for _ in range(3))
    assert frame.extra["temp"].tolist() == [300.5, 301.0]
    assert frame.extra["ups"].tolist() == [58.5, 60.0]
    assert np.isnan(other.extra["temp"]).all()
    assert dict(bare.extra) == {}


def test_xela_source_counts_lost_repeated_and_corrupt_messages():
    longer = sensor(taxels=1, data="8056,806C,8C3C", integer=[32854, 32876, 35900])
    bad = [
        "no json",
        "[1, 2]",
        "[" * 100_000,
        text(13)[:-30],
        text(13, **{"1": longer}),
        text(13, sensors=2),
        text(13, message="Welcome?"),
    ]
    with server() as (url, send), XelaSource(url) as source:
        send(text(10), text(10), text(11), *bad, WELCOME, text(15), text(3), text(4))
        numbers = [read_one(source).sequence for _ in range(5)]
    assert numbers == [10, 11, 15, 16, 17]  # the server counts anew, and the numbers go on
    assert source.repeats == 1
    assert source.counts.lost == 3
    assert source.counts.corrupt == len(bad)
    assert source.counts.good == 5


def test_xela_source_without_a_message_gives_nothing():
    with server() as (url, _), XelaSource(url) as source:
        assert source.read(0.01) == []
        assert "models" not in source.meta


def test_xela_server_that_goes_is_found_again():
    with server() as (url, send):
        stream = Stream(XelaSource(url))
        subscription = stream.subscribe()
        send(text(1))
        with stream:
            assert subscription.get(LONG).sequence == 1
            send(CLOSE)
            wait_until(lambda: stream.health().reconnects == 1 or stream.state == "lost")
            send(text(5))
            assert subscription.get(LONG).sequence == 5
            health = stream.health()
    assert health.reconnects == 1
    assert health.lost == 3  # those that nobody was there for count as well


def test_killed_xela_server_is_found_again():
    with server() as (url, send):
        stream = Stream(XelaSource(url))
        subscription = stream.subscribe()
        send(text(1))
        stream.open()
        assert subscription.get(LONG).sequence == 1
    wait_until(lambda: stream.state == "lost")
    with server(int(url.rpartition(":")[2])) as (_, send):
        send(text(2))
        assert subscription.get(LONG).sequence == 2
        stream.close()


def test_stream_of_xela_counts_repeats_and_maps_the_clock():
    with server() as (url, send):
        stream = Stream(XelaSource(url))
        subscription = stream.subscribe()
        send(*(text(number) for number in (1, 1, 2, 3)))
        with stream:
            frames = [subscription.get(LONG) for _ in range(3)]
            # Message 2 is no repeat, but has the readings of message 1.
            assert stream.health().repeated == 1 + 2
    assert frames[0].time < frames[1].time < frames[2].time


def test_no_xela_server_raises():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = XelaSource(f"ws://127.0.0.1:{port}")
    with pytest.raises(ConnectionError, match=f"no XELA server answers at 'ws://127.0.0.1:{port}"):
        source.open()
    source.close()
    with pytest.raises(OSError, match="is not open"):
        source.read(0)


@pytest.mark.parametrize("url", ["http://localhost", "", None])
def test_xela_source_bad_url_raises(url):
    with pytest.raises(ValueError, match="'url' must begin with ws:// or wss://"):
        XelaSource(url)


def test_xela_source_url_that_is_none_raises_when_opened():
    with pytest.raises(ValueError, match="'url' must be the address of a WebSocket"):
        XelaSource("ws://").open()
