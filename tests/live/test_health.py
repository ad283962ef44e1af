import math
from dataclasses import astuple

import numpy as np
import pytest
from fake_source import FakeSource, frame

from torch_geometric_tactile.live import Health
from torch_geometric_tactile.live.health import HealthMeter

MS = 1_000_000


def fed(tactiles, step=10 * MS, start=1000 * MS):
    meter = HealthMeter()
    received = start
    for number, tactile in enumerate(tactiles):
        received = start + number * step
        meter.observe(frame(number, received, tactile=np.float32(tactile)))
    return meter, received


def noise(count, num_taxels=4):
    return np.random.default_rng(0).normal(size=(count, num_taxels, 3))


def test_health_rate_age_and_jitter():
    meter, last = fed(noise(300))
    health = meter.snapshot("open", FakeSource(), last + MS)
    assert health.rate == pytest.approx(100, rel=1e-3)
    assert health.jitter == pytest.approx(0, abs=1e-9)
    assert health.age == pytest.approx(0.001)
    assert health.frames == 300


def test_health_jitter_by_hand():
    meter = HealthMeter()
    for number, at in enumerate([0, 10, 30, 40, 60]):
        meter.observe(frame(number, 1000 * MS + at * MS))
    health = meter.snapshot("open", FakeSource(), 1060 * MS)
    assert health.jitter == pytest.approx(0.005)
    assert health.rate == pytest.approx(4 / 0.06)


def test_health_of_a_stream_that_stopped_slows_down():
    meter, last = fed(noise(300))
    slower = meter.snapshot("silent", FakeSource(), last + 1000 * MS)
    assert 0 < slower.rate < 60
    assert meter.snapshot("silent", FakeSource(), last + 3000 * MS).rate == 0


def test_health_of_more_frames_than_are_kept():
    meter, last = fed(noise(5000, 1), step=MS)
    assert meter.snapshot("open", FakeSource(), last).rate == pytest.approx(1000, rel=1e-3)


def test_health_tells_the_first_reason_until_a_frame_comes():
    source = FakeSource()
    source.counts.refuse("'taxels' must be an integer")
    source.counts.refuse("another one")
    meter = HealthMeter()
    health = meter.snapshot("silent", source)
    assert health.reason == "'taxels' must be an integer"
    assert health.line() == "silent, no frame: 'taxels' must be an integer"
    meter.observe(frame(0))
    assert "no frame" not in meter.snapshot("open", source).line()


def test_health_before_the_first_frame():
    health = HealthMeter().snapshot("open", FakeSource())
    assert health == Health("open")
    assert not any((*astuple(health)[1:11], health.reason))
    assert math.isnan(health.age)
    assert health.line() == "0.0 Hz  jitter 0.0 ms  lost 0  corrupt 0"


def test_health_counts_of_the_source():
    source = FakeSource()
    source.counts.lost, source.counts.corrupt, source.counts.skipped = 1, 2, 3
    source.repeats = 4
    meter = HealthMeter()
    meter.dropped, meter.reconnects = 5, 6
    health = meter.snapshot("lost", source)
    assert (health.lost, health.corrupt, health.skipped, health.repeated) == (1, 2, 3, 4)
    assert (health.dropped, health.reconnects, health.checksum) == (5, 6, "none")
    assert health.line().startswith("lost  0.0 Hz  ")
    assert health.line().endswith("corrupt 2  reconnects 6")


def test_health_repeated_frames_are_bit_for_bit():
    first, second = [[1.0, 2, 3]], [[1.0, 2, 4]]
    holes = [[1.0, math.nan, 4]]
    meter, _ = fed([first, first, second, first, holes, holes, holes])
    assert meter.snapshot("open", FakeSource()).repeated == 3


def test_health_stale_taxels_are_still_while_others_change():
    tactiles = noise(350)
    tactiles[:, 1] = 5
    tactiles[:, 2] = math.nan
    tactiles[200:, 3] = 7
    meter, last = fed(tactiles[:20])
    assert meter.snapshot("open", FakeSource(), last).stale_taxels == 1
    meter, last = fed(tactiles[:150])
    assert meter.snapshot("open", FakeSource(), last).stale_taxels == 2
    meter, last = fed(tactiles[:250])
    assert meter.snapshot("open", FakeSource(), last).stale_taxels == 2
    meter, last = fed(tactiles)
    assert meter.snapshot("open", FakeSource(), last).stale_taxels == 3


def test_health_taxel_that_comes_and_goes_is_not_stale():
    tactiles = noise(300)
    tactiles[:, 1] = 5
    tactiles[::10, 1, 0] = math.nan
    meter, last = fed(tactiles)
    assert meter.snapshot("open", FakeSource(), last).stale_taxels == 0


def test_health_is_not_stale_when_nothing_changes():
    meter, last = fed(np.ones((300, 4, 3)))
    assert meter.snapshot("open", FakeSource(), last).stale_taxels == 0


def test_health_takes_another_number_of_taxels():
    meter, _ = fed(noise(200))
    meter.observe(frame(200, 10_000 * MS, num_taxels=7))
    assert meter.snapshot("open", FakeSource()).frames == 201


@pytest.mark.parametrize(
    ("age", "text"), [(0.999, "age 999 ms"), (1.0, "age 1.0 s"), (12.34, "age 12.3 s")]
)
def test_health_age_in_line(age, text):
    assert Health("lost", age=age).line().endswith(text)
