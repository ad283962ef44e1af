# ruff: noqa: E402
import time

import numpy as np
import pytest

for module in ("mcap", "google.protobuf", "zstandard"):
    pytest.importorskip(module, reason="needs the extra 'live'")

from fake_source import FakeSource, ended, frame, frames, wait_until

from torch_geometric_tactile.data import LiveFrame, Recording
from torch_geometric_tactile.data._annotations import annotation_of_frames
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.live import (
    Health,
    Recorder,
    ReplaySource,
    Stream,
)
from torch_geometric_tactile.live._outage import Outage
from torch_geometric_tactile.live.health import HealthMeter

MS = 1_000_000


def arrivals(milliseconds, numbers=None):
    """Frames that arrive each by itself, as of the clock of the host."""
    start = time.perf_counter_ns() - max(milliseconds) * MS
    numbers = range(len(milliseconds)) if numbers is None else numbers
    return [
        frame(number, start + at * MS) for number, at in zip(numbers, milliseconds, strict=True)
    ]


def streamed(source, path=None, act=lambda recorder: None):
    """The stream, when all of its source was read, and the recording of it."""
    stream = Stream(source)
    if path is None:
        with stream:
            wait_until(lambda: stream.state == "ended")
        return stream, None
    with Recorder(path, stream) as recorder, stream:
        act(recorder)
        wait_until(lambda: stream.state == "ended")
    return stream, read_recording(path)


TWICE = [*range(0, 1000, 10), *range(3000, 4000, 10), *range(5000, 5500, 10)]


@pytest.fixture(params=["a.mcap", "a.h5"])
def path(request, tmp_path):
    if request.param.endswith("h5"):
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    return tmp_path / request.param


def test_outages_are_counted_and_annotated_where_they_happened(path):
    stream, recording = streamed(ended(*arrivals(TWICE)), path)
    first, second = stream.outages
    assert (first.seconds, second.seconds) == pytest.approx((2.01, 1.01), abs=1e-3)
    assert [a.label for a in recording.annotations] == ["gap", "gap"]
    for annotation, outage, last in zip(
        recording.annotations, stream.outages, (99, 199), strict=True
    ):
        assert annotation.start == pytest.approx(recording.time[last])
        assert annotation.end == pytest.approx(recording.time[last + 1])
        assert annotation.end - annotation.start == pytest.approx(outage.seconds)
    health = stream.health()
    assert (health.outages, health.lost_in_outages) == (2, 0)
    assert health.losses() == (
        "2 outages, 3.0 s; 0 frames lost otherwise and 0 corrupt in transmission"
    )
    assert "outages 2" in health.line()


def test_frames_lost_in_an_outage_are_told_apart():
    numbers = [*range(100), *range(300, 350), 353]
    source = ended(*arrivals([10 * number for number in numbers], numbers))
    source.counts.lost = 203
    stream, _ = streamed(source)
    (outage,) = stream.outages
    assert outage.lost == 200
    assert stream.health().losses() == (
        "1 outage, 2.0 s; 3 frames lost otherwise and 0 corrupt in transmission"
    )


def test_few_lost_frames_are_no_outage():
    numbers = [number for number in range(300) if number not in (150, 151, 152)]
    stream, _ = streamed(ended(*arrivals([10 * number for number in numbers], numbers)))
    assert stream.outages == ()
    assert "outage" not in stream.health().losses()


def test_gap_overlaps_an_annotation_and_does_not_end_it(path):
    source = FakeSource(*arrivals([*range(0, 1000, 10)]))
    stream = Stream(source)
    with Recorder(path, stream) as recorder, stream:
        wait_until(lambda: recorder.frames == 100)
        recorder.annotate("slip")
        time.sleep(0.7)
        source.send(frame(100))
        wait_until(lambda: recorder.frames == 101)
        assert recorder.annotation == "slip"
        time.sleep(0.02)
        recorder.annotate("slip")
        time.sleep(0.1)
        source.send(frame(112), frame(113))
        wait_until(lambda: recorder.frames == 103)
    recording = read_recording(path)
    gap, *_, slip = sorted(recording.annotations, key=lambda a: a.label)
    assert (gap.label, slip.label) == ("gap", "slip")
    assert gap.start == pytest.approx(recording.time[99])
    assert gap.start < slip.start < gap.end == pytest.approx(recording.time[100])
    assert gap.end < slip.end < recording.time[102]
    labels = annotation_of_frames(recording.annotations, recording.time)
    assert labels.tolist() == ["none"] * 100 + ["slip", "none", "none"]


def test_outage_that_lasts_to_the_end_is_told(path):
    stream = Stream(FakeSource(*arrivals([*range(0, 1000, 10)])))
    with Recorder(path, stream) as recorder, stream:
        wait_until(lambda: recorder.frames == 100)
        time.sleep(0.6)
    assert stream.health().outages == 1
    recording = read_recording(path)
    (gap,) = recording.annotations
    assert gap.label == "gap"
    assert gap.start == pytest.approx(recording.time[-1])
    assert gap.end - gap.start > 0.55


def test_recording_that_ends_with_its_source_has_no_outage_at_its_end(path):
    stream, recording = streamed(
        ended(*arrivals([*range(0, 1000, 10)])), path, lambda recorder: time.sleep(0.4)
    )
    assert stream.open_outage(time.perf_counter()) is None
    assert recording.annotations == ()


def test_source_that_waits_has_no_outages():
    recording = Recording(np.r_[0:1:0.01, 5:6:0.01], np.ones((200, 2, 3)))
    source = ReplaySource(recording, speed=0)
    stream = Stream(source)
    with stream:
        wait_until(lambda: stream.state == "ended")
    assert stream.outages == ()
    assert stream.rate is None


def test_lasting_outage_is_shown_and_counted():
    source = FakeSource(*arrivals([*range(0, 500, 10)]))
    with Stream(source, silent_after=0.1) as stream:
        wait_until(lambda: stream.state == "silent")
        wait_until(lambda: stream.health().outages == 1)
        health = stream.health()
        assert health.outage_seconds > 0.2
        assert health.line().startswith("silent  ")
        source.send(frame(50))
        wait_until(lambda: stream.state == "open" and stream.health().frames == 51)
        assert (stream.health().outages, len(stream.outages)) == (1, 1)


def test_lost_source_is_an_outage_and_numbers_go_on():
    source = FakeSource(*arrivals([*range(0, 500, 10)]), OSError("unplugged"))
    with Stream(source) as stream:
        wait_until(lambda: stream.health().reconnects == 1)
        time.sleep(0.3)
        source.send(frame(50))
        wait_until(lambda: stream.health().frames == 51)
        (outage,) = stream.outages
    assert outage.seconds > 0.3
    assert outage.lost == 0


def test_label_of_gaps_is_the_recorders(tmp_path):
    with pytest.raises(ValueError, match="'label' must not be 'gap'"):
        Recorder(tmp_path / "a.mcap", Stream(FakeSource())).annotate("gap")


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_recording_of_seconds_ends_with_the_last_frame_in_them(path, rate):
    source = ended(*arrivals([round(1000 * i / rate) for i in range(300)]))
    stream = Stream(source)
    with Recorder(path, stream, max_seconds=1.2) as recorder, stream:
        wait_until(lambda: recorder.is_over)
    assert recorder.frames == round(1.2 * rate) + 1
    assert recorder.seconds == pytest.approx(1.2, abs=1e-3)
    assert read_recording(path).num_frames == recorder.frames
    with pytest.raises(ValueError, match="'max_seconds' must be positive"):
        Recorder(path.with_name("b.mcap"), stream, max_seconds=0)


def test_outage_over_the_end_of_the_seconds_is_annotated_up_to_it(path):
    source = ended(*arrivals([*range(0, 1000, 10), *range(3000, 3100, 10)]))
    stream = Stream(source)
    with Recorder(path, stream, max_seconds=2.0) as recorder, stream:
        wait_until(lambda: recorder.is_over)
    recording = read_recording(path)
    (gap,) = recording.annotations
    assert gap.label == "gap"
    assert (gap.start, gap.end) == pytest.approx((recording.time[-1], recording.time[0] + 2.0))


def read_together(size, rate=100.0, count=480, lost=()):
    """Frames of which so many are read together, as bursts of a cable."""
    start, out = time.perf_counter_ns() - 10**10, []
    for number in range(count):
        last = number // size * size + size - 1
        if number not in lost:
            received = start + round(last / rate * 1e9)
            out.append(frame(number, received, tactile=np.ones((1, 1), "f4") * number))
    return [[f for f in out if f.received == at] for at in sorted({f.received for f in out})]


@pytest.mark.parametrize("size", [1, 3, 16])
@pytest.mark.parametrize("lost", [(), tuple(range(201, 300, 7))], ids=["all", "lost"])
def test_rate_is_that_of_the_numbers(size, lost):
    stream, _ = streamed(ended(*read_together(size, lost=lost)))
    assert stream.rate == pytest.approx(100, rel=1e-3)
    assert stream.outages == ()
    meter = HealthMeter()
    reads = read_together(size, lost=lost)
    for one in reads:
        for each in one:
            meter.observe(each)
    health = meter.snapshot("open", FakeSource(), reads[-1][-1].received)
    assert health.rate == pytest.approx(100, rel=1e-3)


def test_rate_is_not_known_in_the_first_second():
    assert Stream(FakeSource()).rate is None
    stream, _ = streamed(ended(*arrivals([*range(0, 900, 10)])))
    assert stream.rate is None


def test_rate_of_a_replay_is_that_of_the_recording():
    recording = Recording(np.arange(300) / 100, np.ones((300, 2, 3)))
    stream = Stream(ReplaySource(recording, speed=2))
    with stream:
        wait_until(lambda: stream.state == "ended")
    assert stream.rate == pytest.approx(100, rel=0.01)


def test_device_times_that_repeat_are_too_coarse_and_numbers_make_times():
    start = time.perf_counter_ns() - 10**10
    coarse = [
        LiveFrame(i, 0.0, start + i * 4 * MS, i * 4 // 10 / 100, np.ones((2, 3), "f4"))
        for i in range(1000)
    ]
    stream = Stream(ended(*coarse))
    subscription = stream.subscribe()
    with stream:
        times = [each.time for each in subscription]
    assert np.diff(times[300:]) == pytest.approx(0.004, rel=0.05)


def test_times_of_frames_that_were_read_together_are_regular():
    stream = Stream(ended(*read_together(3, rate=187.5, count=900)))
    subscription = stream.subscribe()
    with stream:
        got = [(each.time, each.received * 1e-9) for each in subscription]
    times, received = np.array(got).T
    assert (times <= received).all()
    assert np.diff(times)[3:] == pytest.approx(1 / 187.5, rel=0.05)


def test_outage_by_hand():
    assert Outage(1.0, 3.5).seconds == 2.5
    assert Outage(1.0, 3.5, 4) == (1.0, 3.5, 4)
    assert frames(1)[0].sequence == 0
    assert Health(lost=1, corrupt=2).losses() == "1 lost and 2 corrupt in transmission"
