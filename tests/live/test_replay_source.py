import math
import time

import numpy as np
import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.live import ReplaySource, SourceEnded, Stream

LONG = 20.0


def recording(count=20, rate=200.0, start=5.0):
    number = np.arange(count, dtype=np.float32)
    return Recording(
        time=start + np.arange(count) / rate,
        tactile=np.broadcast_to(number[:, None, None], (count, 3, 2)),
        joint=np.broadcast_to(number[:, None] / 10_000, (count, 4)),
        meta={"unit": "count", "sensor": "three"},
        extra={"temp": number * 2, "vibration": np.ones((count, 5, 2))},
    )


class Clock:
    """A clock that only sleeping moves."""

    def __init__(self, monkeypatch):
        self.now = 100 * 10**9
        self.slept = []
        module = "torch_geometric_tactile.live.replay_source.time"
        monkeypatch.setattr(f"{module}.perf_counter", lambda: self.now / 1e9)
        monkeypatch.setattr(f"{module}.perf_counter_ns", lambda: self.now)
        monkeypatch.setattr(f"{module}.sleep", self.sleep)

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += math.ceil(seconds * 1e9)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def all_frames(source, most=10_000):
    frames = []
    while len(frames) < most:
        try:
            frames += source.read(0.1)
        except SourceEnded:
            break
    return frames


@pytest.mark.parametrize("name", ["trial.npz", "trial.csv"])
def test_replay_gives_the_frames_of_a_file(tmp_path, name, clock):
    given = recording()
    if name.endswith("csv"):
        given = Recording(given.time, given.tactile, given.joint)
    path = tmp_path / name
    write_recording(given, path)
    with ReplaySource(path) as source:
        frames = all_frames(source)
    assert [frame.sequence for frame in frames] == list(range(20))
    np.testing.assert_array_equal([frame.tactile for frame in frames], given.tactile)
    np.testing.assert_allclose([frame.joint for frame in frames], given.joint, rtol=1e-6)
    np.testing.assert_allclose([frame.device_time for frame in frames], given.time)
    if given.extra:
        assert [float(frame.extra["temp"]) for frame in frames] == given.extra["temp"].tolist()
        assert frames[0].extra["vibration"].shape == (5, 2)
    assert source.counts.good == 20


def test_replay_frames_are_views_and_never_invented():
    given = recording()
    source = ReplaySource(given, speed=0)
    source.open()
    for frame in all_frames(source):
        assert np.shares_memory(frame.tactile, given.tactile)
        assert isinstance(frame.extra["temp"], np.ndarray)


def test_replay_meta_has_rate_and_layout():
    with ReplaySource(recording()) as source:
        assert source.meta == {"unit": "count", "sensor": "three", "rate": pytest.approx(200)}


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_replay_keeps_times_without_drift(speed, clock):
    given = recording(count=60 * 50, rate=50.0)
    with ReplaySource(given, speed=speed) as source:
        frames = all_frames(source)
    received = np.array([frame.received for frame in frames]) / 1e9
    late = (received - received[0]) * speed - (given.time - given.time[0])
    assert abs(late).max() < 1e-4
    assert len(clock.slept) < 2 * 60 * 50 / min(speed, 1)  # no busy wait


def test_replay_of_a_late_reader_gives_what_is_due(clock):
    with ReplaySource(recording()) as source:
        assert [frame.sequence for frame in source.read(0.1)] == [0]
        clock.now += 26_000_000
        assert [frame.sequence for frame in source.read(0)] == [1, 2, 3, 4, 5]
        assert source.read(0) == []


def test_replay_waits_no_longer_than_asked(clock):
    given = Recording(time=[0.0, 3600.0], tactile=np.zeros((2, 1, 1)))
    with ReplaySource(given) as source:
        source.read(0.1)
        assert source.read(0.1) == []
    assert clock.slept == [0.1]


def test_replay_loop_goes_on_in_time_and_numbers(clock):
    with ReplaySource(recording(count=4, rate=100.0), loop=True) as source:
        frames = all_frames(source, most=10)
    assert [frame.sequence for frame in frames[:10]] == list(range(10))
    times = [frame.device_time for frame in frames[:10]]
    assert times == pytest.approx([5 + i / 100 for i in range(10)])
    assert frames[5].tactile[0, 0] == 1
    assert np.diff([frame.received for frame in frames[:10]]) / 1e9 == pytest.approx(0.01, abs=1e-4)


@pytest.mark.parametrize("speed", [0, math.inf])
def test_replay_as_fast_as_possible_loses_nothing(speed):
    stream = Stream(ReplaySource(recording(count=2000), speed=speed))
    slow = stream.subscribe(size=4)
    with stream:
        frames = list(slow)
    assert [frame.sequence for frame in frames] == list(range(2000))
    times = np.array([frame.time for frame in frames])
    assert (np.diff(times) > 0).all()


def test_replay_in_a_stream_maps_the_times_of_the_recording():
    stream = Stream(ReplaySource(recording(count=40, rate=1000.0), speed=2.0))
    subscription = stream.subscribe()
    with stream:
        times = np.array([frame.time for frame in subscription])
    settled = times - times[0]
    np.testing.assert_allclose(settled[-1], 39 / 2000, atol=0.05)
    assert stream.state == "ended"


def test_replay_single_frame_and_second_opening(clock):
    source = ReplaySource(Recording(time=[3.0], tactile=np.zeros((1, 2, 1))))
    for _ in range(2):
        source.open()
        source.open()
        assert len(all_frames(source)) == 1
        source.close()
        source.close()
    with pytest.raises(OSError, match="is not open"):
        source.read(0)


def test_replay_missing_file_raises_when_opened(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.npz"):
        ReplaySource(tmp_path / "nothing.npz").open()


def test_replay_without_frames_raises():
    empty = Recording(time=np.zeros(0), tactile=np.zeros((0, 2, 1)))
    with pytest.raises(ValueError, match="must hold frames"):
        ReplaySource(empty).open()


@pytest.mark.parametrize("speed", [-1, math.nan, "fast", True])
def test_replay_bad_speed_raises(speed):
    with pytest.raises(ValueError, match="'speed' must be 0 or more"):
        ReplaySource("x.npz", speed=speed)


def test_replay_clock_starts_with_the_first_read():
    source = ReplaySource(recording(count=2, rate=1.0))
    with source:
        time.sleep(0.02)
        assert len(source.read(0)) == 1
