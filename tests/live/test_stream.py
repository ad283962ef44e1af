import asyncio
import gc
import math
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fake_source import FakeSource, ended, frame, frames, wait_until

from torch_geometric_tactile.data import FrameInfo
from torch_geometric_tactile.live import (
    SourceEnded,
    Stream,
    StreamEnded,
    StreamOverflow,
    Subscription,
    TaxelMap,
)

LONG = 20.0


def stream_threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("stream ")]


@pytest.fixture(autouse=True)
def _no_thread_left():
    yield
    wait_until(lambda: not stream_threads())


@contextmanager
def subscribed(source, policy="all", size=None, **settings):
    """An open stream, and a subscription since before it was opened."""
    stream = Stream(source, **settings)
    subscription = stream.subscribe(policy, size)
    with stream:
        yield stream, subscription


def run(coroutine):
    return asyncio.run(asyncio.wait_for(coroutine, LONG))


def numbers(subscription):
    return [frame.sequence for frame in subscription]


def test_stream_gives_every_subscriber_all_frames_in_order():
    stream = Stream(ended(*frames(50)))
    first, second = stream.subscribe(), stream.subscribe(size=50)
    with stream:
        assert numbers(first) == list(range(50))
    assert numbers(second) == list(range(50))
    assert stream.state == "ended"
    assert stream.source.closed == 1


def test_stream_is_iterated_with_a_subscription_of_its_own():
    source = FakeSource()
    with Stream(source) as stream:
        iterator = iter(stream)
        source.send(frames(5), SourceEnded())
        assert numbers(iterator) == [0, 1, 2, 3, 4]


def test_stream_that_cannot_open_raises_in_the_caller_and_wakes_subscribers():
    source = FakeSource()
    source.open_errors.append(FileNotFoundError("no such port"))
    stream = Stream(source)
    subscription = stream.subscribe()
    with pytest.raises(FileNotFoundError, match="no such port"):
        stream.open()
    with pytest.raises(StreamEnded):
        subscription.get(LONG)
    assert stream.state == "closed"


def test_stream_opens_once():
    stream = Stream(FakeSource())
    assert repr(stream) == "Stream(FakeSource('fake:'), state='closed')"
    stream.open()
    stream.open()
    assert stream.source.opened == 1
    stream.close()
    stream.close()
    with pytest.raises(ValueError, match="a stream can be opened only once"):
        stream.open()


def test_stream_closed_before_it_was_opened_ends_its_subscribers():
    stream = Stream(FakeSource())
    subscription = stream.subscribe()
    stream.close()
    with pytest.raises(StreamEnded):
        subscription.get(LONG)


@pytest.mark.parametrize("late", [False, True], ids=["before", "after"])
def test_ended_stream_answers_at_once(late):
    stream = Stream(ended(frame(7)))
    early = stream.subscribe()
    with stream:
        wait_until(lambda: stream.state == "ended")
        subscription = stream.subscribe() if late else early
        if not late:
            assert subscription.get(0).sequence == 7
        for _ in range(2):
            with pytest.raises(StreamEnded, match="the stream has ended"):
                subscription.get()


def test_ended_stream_answers_through_asyncio_to_thread():
    stream = Stream(ended(frame(1)))
    subscription = stream.subscribe()

    async def main():
        one = await asyncio.to_thread(subscription.get)
        with pytest.raises(StreamEnded):
            await asyncio.to_thread(subscription.get)
        return one.sequence

    with stream:
        assert run(main()) == 1


def test_get_without_a_frame_raises_timeout_error():
    with Stream(FakeSource()) as stream:
        subscription = stream.subscribe()
        with pytest.raises(TimeoutError, match=r"no frame arrived within 0\.02 s"):
            subscription.get(0.02)


def test_error_of_the_source_reaches_every_subscriber_after_its_frames():
    stream = Stream(FakeSource(frame(0), ZeroDivisionError("broken sensor")))
    subscriptions = [stream.subscribe(), stream.subscribe("newest")]
    with stream:
        wait_until(lambda: stream.state == "ended")
        subscriptions.append(stream.subscribe())
        for subscription in subscriptions[:2]:
            assert subscription.get(LONG).sequence == 0
        for subscription in subscriptions:
            with pytest.raises(ZeroDivisionError, match="broken sensor"):
                subscription.get(LONG)
            with pytest.raises(ZeroDivisionError, match="broken sensor"):
                next(subscription)
    assert isinstance(stream.error, ZeroDivisionError)


def test_stop_iteration_of_the_source_is_no_silent_end():
    with (
        subscribed(FakeSource(StopIteration())) as (_, subscription),
        pytest.raises(RuntimeError, match="raised StopIteration"),
    ):
        list(subscription)


def test_source_that_is_not_worth_reopening_raises():
    source = FakeSource(OSError("damaged file"))
    source.reopens = False
    with subscribed(source) as (_, subscription), pytest.raises(OSError, match="damaged file"):
        subscription.get(LONG)


def test_policy_all_ends_with_an_error_when_it_overflows():
    source = FakeSource()
    with Stream(source) as stream:
        slow, fast = stream.subscribe(size=3), stream.subscribe()
        source.send(*frames(5))
        assert [fast.get(LONG).sequence for _ in range(5)] == [0, 1, 2, 3, 4]
        assert slow.overflowed
        assert [slow.get(0).sequence for _ in range(3)] == [0, 1, 2]
        for _ in range(2):
            with pytest.raises(
                StreamOverflow, match="its queue of 3 frames was full, and 2 frames"
            ):
                slow.get(0)
        source.send(frame(5), SourceEnded())
        assert fast.get(LONG).sequence == 5
        with pytest.raises(StreamOverflow, match="3 frames were lost"):
            next(slow)
        assert stream.health().dropped == slow.dropped == 3


@pytest.mark.parametrize(
    ("policy", "size", "kept"), [("drop_oldest", 4, [6, 7, 8, 9]), ("newest", 4, [9])]
)
def test_slow_subscriber_gets_the_latest_frames(policy, size, kept):
    with subscribed(ended(*frames(10)), policy, size) as (stream, subscription):
        wait_until(lambda: stream.state == "ended")
        assert numbers(subscription) == kept
    assert subscription.dropped == stream.health().dropped == 10 - len(kept)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"policy": "some"}, "'policy' must be one of"),
        ({"size": 0}, "'size' must be a positive number of frames"),
        ({"policy": "drop_oldest", "size": 1.5}, "'size' must be a positive number of frames"),
        ({"silent_after": 0}, "'silent_after' must be positive"),
    ],
)
def test_bad_input_raises(given, match):
    with pytest.raises(ValueError, match=match), subscribed(FakeSource(), **given):
        pass


def waiting():
    source = ended(frames(100))
    source.waits = True
    return source


def test_source_that_waits_never_overflows():
    with subscribed(waiting(), size=2) as (_, slow):
        time.sleep(0.05)
        assert numbers(slow) == list(range(100))
    assert not slow.overflowed


def test_source_that_waits_goes_on_when_its_subscriber_is_given_up():
    stream = Stream(waiting())
    slow, other = stream.subscribe(size=2), stream.subscribe()
    with stream:
        assert slow.get(LONG).sequence == 0
        del slow
        gc.collect()
        assert numbers(other) == list(range(100))


def test_source_that_waits_is_closed_at_once():
    with subscribed(waiting(), size=2) as (stream, subscription):
        wait_until(lambda: stream.health().frames > 0)
    assert stream.state == "closed"
    assert not subscription.overflowed or subscription.dropped


def test_source_that_waits_goes_on_as_soon_as_there_is_room():
    subscription = Subscription("all", size=1)
    subscription.put(frame(0))
    assert not subscription.has_room(0)
    timer = threading.Timer(0.05, subscription.get)
    before = time.monotonic()
    timer.start()
    assert subscription.has_room(2 * LONG)
    assert time.monotonic() - before < LONG
    timer.join()


def test_close_from_another_thread_wakes_every_subscriber():
    stream = Stream(FakeSource())
    stream.open()
    subscription = stream.subscribe()
    timer = threading.Timer(0.05, stream.close)
    timer.start()
    with pytest.raises(StreamEnded):
        subscription.get()
    timer.join()
    assert stream.state == "closed"


def test_closed_subscription_wakes_its_reader_and_takes_no_more():
    source = FakeSource()
    with Stream(source) as stream:
        subscription, other = stream.subscribe(), stream.subscribe()
        timer = threading.Timer(0.05, subscription.close)
        timer.start()
        with pytest.raises(StreamEnded):
            subscription.get()
        timer.join()
        source.send(frame(1))
        assert other.get(LONG).sequence == 1
        with pytest.raises(StreamEnded):
            subscription.get(0)
        assert subscription.dropped == 0


def test_async_for_gives_all_frames_and_ends():
    stream = Stream(FakeSource())

    async def main():
        subscription = aiter(stream)
        stream.source.send(*frames(20))
        got = []
        async for one in subscription:
            got.append(one.sequence)
            if one.sequence == 19:
                count = threading.active_count()
                stream.source.send(SourceEnded())
        return got, count

    with stream:
        before = threading.active_count()
        got, during = run(main())
    assert got == list(range(20))
    assert during == before


def test_async_wait_is_cancelled_without_losing_a_frame():
    stream = Stream(FakeSource())

    async def main():
        subscription = stream.subscribe()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(anext(subscription), 0.05)
        stream.source.send(frame(1), frame(2))
        first = await asyncio.wait_for(anext(subscription), LONG)
        return first.sequence, subscription.get(LONG).sequence

    with stream:
        assert asyncio.run(main()) == (1, 2)


def test_async_error_of_the_source_is_raised():
    stream = Stream(FakeSource(ZeroDivisionError("broken")))
    subscription = stream.subscribe()

    async def main():
        async for _ in subscription:
            pass

    with stream, pytest.raises(ZeroDivisionError, match="broken"):
        run(main())


def test_async_for_lets_others_run():
    stream = Stream(ended(*frames(200)))
    subscription = stream.subscribe()

    async def main():
        turns = 0

        async def count():
            nonlocal turns
            while True:
                turns += 1
                await asyncio.sleep(0)

        counter = asyncio.create_task(count())
        async for _ in subscription:
            pass
        counter.cancel()
        return turns

    with stream:
        wait_until(lambda: stream.state == "ended")
        assert run(main()) > 100


def test_lost_source_is_opened_again():
    source = FakeSource(frame(0), OSError("unplugged"))
    source.open_errors.clear()
    with subscribed(source) as (stream, subscription):
        assert subscription.get(LONG).sequence == 0
        source.send(frame(1))
        assert subscription.get(LONG).sequence == 1
        health = stream.health()
    assert health.reconnects == 1
    assert source.opened == 2
    assert health.state == "open"


def test_lost_source_that_is_gone_is_tried_again_and_again():
    source = FakeSource(EOFError("closed by the other side"), frame(5))
    stream = Stream(source)
    subscription = stream.subscribe()
    stream.open()
    source.open_errors.extend([ConnectionRefusedError("nobody"), FileNotFoundError("no port")])
    wait_until(lambda: stream.state == "lost")
    assert subscription.get(LONG).sequence == 5
    assert stream.health().reconnects == 1
    assert not source.open_errors
    stream.close()


def test_lost_source_that_is_seen_to_be_back_is_opened_without_waiting(monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.live.stream._BACK_OFF_SECONDS", (3600.0, 3600.0))
    source = FakeSource(OSError("unplugged"), frame(5))
    with subscribed(source) as (_, subscription):
        wait_until(lambda: source.asked)
        source.there = True
        assert subscription.get(LONG).sequence == 5


def test_lost_stream_is_closed_at_once():
    source = FakeSource(OSError("unplugged"))
    with Stream(source) as stream:
        wait_until(lambda: stream.state == "lost")
    assert stream.state == "closed"


def test_error_while_opening_again_ends_the_stream():
    source = FakeSource(OSError("unplugged"))
    stream = Stream(source)
    subscription = stream.subscribe()
    stream.open()
    source.open_errors.append(KeyError("a defect"))
    with pytest.raises(KeyError, match="a defect"):
        subscription.get(LONG)
    stream.close()


def is_open_again(source, stream):
    # The state lasts 50 ms after a frame, and a test that is not run for so long misses it.
    source.send(frame(0))
    deadline = time.monotonic() + 0.05
    while stream.state != "open" and time.monotonic() < deadline:
        time.sleep(0.001)
    return stream.state == "open"


def test_source_without_frames_says_why_once(caplog):
    source = FakeSource()
    source.counts.refuse("no header in what came")
    with Stream(source, silent_after=0.05) as stream:
        wait_until(lambda: stream.state == "silent")
        time.sleep(0.3)
        assert [one.message for one in caplog.records] == ["no frame yet: no header in what came"]
        with pytest.raises(OSError, match="'fake:' sent no frame: no header in what came"):
            stream.require_frames()
        wait_until(lambda: is_open_again(source, stream))
        wait_until(lambda: stream.state == "silent")
        stream.require_frames()
    assert len(caplog.records) == 1


def test_seconds_count_from_the_opening_and_then_from_the_first_frame():
    source = FakeSource()
    stream = Stream(source)
    assert stream.seconds == -math.inf
    with stream:
        time.sleep(0.2)
        assert stream.seconds >= 0.2
        before = time.monotonic()
        source.send(frame(0))
        wait_until(lambda: stream.health().frames == 1)
        assert 0 <= stream.seconds <= time.monotonic() - before
        source.send(frame(1))
        wait_until(lambda: stream.health().frames == 2)
        time.sleep(0.1)
        assert stream.seconds >= 0.1


def test_time_is_strictly_increasing_and_maps_the_clock_of_the_device():
    at = 10_000_000_000
    script = [frame(0, at, 1.0), frame(1, at, 1.0), frame(2, at, None), frame(3, at + 10**9, 2.0)]
    with subscribed(ended(script)) as (_, subscription):
        times = [one.time for one in subscription]
    assert all(later > earlier for earlier, later in pairwise(times))
    assert times == pytest.approx([10.0, 10.0, 10.0, 11.0], abs=1e-4)


@pytest.mark.parametrize(("rate", "second"), [(2.0, 10.5), (math.inf, 10.6)])
def test_clock_of_another_rate_is_mapped(rate, second):
    source = ended([frame(0, 10_000_000_000, 1.0), frame(1, 10_600_000_000, 2.0)])
    source.clock_rate = rate
    with subscribed(source) as (_, subscription):
        assert [one.time for one in subscription] == pytest.approx([10.0, second])


def test_stream_maps_taxels_and_names_the_layout():
    taxel_map = TaxelMap([1, -1, 0], 2, layout="three")
    source = ended(frame(0, tactile=np.float32([[1], [2]])), sensor="two")
    with subscribed(source, taxel_map=taxel_map) as (stream, subscription):
        tactile = subscription.get(LONG).tactile
    np.testing.assert_array_equal(tactile, np.float32([[2], [math.nan], [1]]))
    assert stream.meta["sensor"] == "three"


def test_stream_keeps_how_frames_were_made():
    info = FrameInfo(rate=50.0, unit="count", columns={"tactile": ["a", "b"], "joint": ["j"]})
    made = [replace(one, info=info) for one in frames(2)]
    with subscribed(ended(*made)) as (_, subscription):
        assert [one.info for one in subscription] == [info, info]
    with subscribed(ended(*made), taxel_map=TaxelMap([1, 0], 2)) as (_, subscription):
        first, second = subscription
    assert first.info == FrameInfo(rate=50.0, unit="count", columns={"joint": ["j"]})
    assert second.info is first.info


def test_anchor_is_one_moment_on_both_clocks():
    unix, monotonic = Stream(FakeSource()).anchor
    assert abs((time.time_ns() - unix) - (time.perf_counter_ns() - monotonic)) < 1_000_000_000
