import math
from dataclasses import replace

import numpy as np
import pytest

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.live import Rest
from torch_geometric_tactile.live._viewer.page import FirstSecond

RATE = 100


def frame(i, tactile, joint=None):
    time = 5 + i / RATE
    return LiveFrame(i, time, int(time * 1e9), None, np.asarray(tactile, np.float32), joint)


def still(count, first=0, noise=3.0, base=30000.0, seed=0, taxels=20):
    draw = np.random.default_rng(seed)
    values = base + noise * draw.standard_normal((count, taxels, 3))
    return [frame(first + i, value) for i, value in enumerate(values)]


def fill(rest, frames):
    return [i for i, one in enumerate(frames) if rest.add(one)]


def test_a_rest_is_the_mean_of_its_frames():
    rest = Rest(seconds=0.5)
    frames = still(80)
    ready = list(range(50, 80))  # from the first that is half a second after the first
    assert fill(rest, frames) == ready
    tactile = np.stack([one.tactile for one in frames[:51]]).astype(np.float64)
    np.testing.assert_allclose(rest.value, tactile.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(rest.noise, 3.0, rtol=0.5)
    assert rest.frames.tactile.shape == (51, 20, 3)
    assert [kind for _, kind, _ in rest.events] == ["rest"]
    assert repr(rest) == "Rest(seconds=0.5, min_frames=30, max_movement=5, ready=True)"


def test_rest_without_settings():
    rest = Rest()
    assert repr(rest) == "Rest(seconds=1, min_frames=30, max_movement=5, ready=False)"
    assert rest.max_drift == 5
    assert Rest(min_frames=1).min_frames == 10  # two in each of its five parts


def test_a_rest_of_any_length_has_at_most_20000_frames():
    frames = [frame(i, np.zeros((1, 1))) for i in range(20_000)]
    assert fill(Rest(seconds=1e9), frames) == [19_999]


def test_a_rest_has_enough_frames():
    rest = Rest(seconds=0.01, min_frames=40)
    rest.need(45)
    assert fill(rest, still(60))[0] == 44


@pytest.mark.parametrize("taxel", [0, 19])
def test_a_touch_is_no_rest(taxel):
    rest = Rest(seconds=0.5)
    frames = still(51)
    for i, one in enumerate(frames[30:]):
        one.tactile[taxel, 2] += 2.0 * i
    assert fill(rest, frames) == []
    (event,) = rest.events
    assert event[1] == "moved"
    assert f"taxel {taxel} by" in event[2]
    assert "keep the sensor untouched" in rest.status()
    with pytest.raises(
        RuntimeError, match=r"the rest must be measured first: keep the .*: 0 still"
    ):
        _ = rest.value
    assert fill(rest, still(80, first=51, seed=1))[0] == 50  # once more, from the next frame on


@pytest.mark.parametrize(
    ("part", "last", "noise"),
    [
        ([0, 2], [0, 2], 2**0.5),
        ([0, 3, 0], [0, 3, 0], 3**0.5),
        ([0, 2], [0, 20], 2 * 2**0.5),  # a loud part is at most twice the usual noise
    ],
)
def test_noise_by_hand(part, last, noise):
    readings = [*part * 4, *last]
    rest = Rest(seconds=0.01, min_frames=len(readings))
    assert fill(rest, [frame(i, [[value]]) for i, value in enumerate(readings)])
    assert rest.noise == pytest.approx(noise)


def test_quiet_taxel_is_taken_to_have_the_noise_of_all():
    rest = Rest(seconds=0.01, min_frames=10, max_movement=2.5)
    # The noise of both is 0 and the root of 2: together 1.
    assert not fill(rest, [frame(i, [[3 * (i > 7)], [i % 2 * 2]]) for i in range(10)])
    assert rest.reason == "1 of 2 taxels move, taxel 0 by 3 times its noise (at most 2.5)"


def test_noise_is_a_rest():
    for seed in range(20):
        rest = Rest(seconds=0.3)
        assert fill(rest, still(40, seed=seed, taxels=384)), rest.events


def test_whole_numbers_that_tip_over_are_a_rest():
    rest = Rest(seconds=0.5)
    frames = [frame(i, np.round(one.tactile)) for i, one in enumerate(still(60, noise=0.3))]
    assert fill(rest, frames), rest.events


def test_readings_that_never_change_are_a_rest():
    rest = Rest(seconds=0.5)
    frames = still(60, noise=0.0)
    assert fill(rest, frames)
    assert (rest.noise == 0).all()
    moved = Rest(seconds=0.5)
    frames[40].tactile[3, 1] += 1
    assert not fill(moved, frames)
    assert "taxel 3 by inf" in moved.events[0][2]


def test_dead_taxels_stay_missing():
    rest = Rest(seconds=0.5)
    frames = still(60)
    for i, one in enumerate(frames):
        one.tactile[4] = np.nan
        if i % 2:
            one.tactile[7] = np.nan
    assert fill(rest, frames)
    assert np.isnan(rest.value[4]).all()
    assert np.isfinite(np.delete(rest.value, 4, axis=0)).all()
    assert rest.events[0][2] == "rest of 51 frames, 1 taxels without a reading"


def test_retare_collects_anew_and_is_an_event():
    told = []
    rest = Rest(seconds=0.5, on_event=lambda *event: told.append(event))
    fill(rest, still(60))
    rest.retare()
    assert not rest.ready
    fill(rest, still(60, first=60, base=31000.0))
    np.testing.assert_allclose(rest.value, 31000.0, atol=5)
    assert rest.number == 2
    assert [kind for _, kind, _ in rest.events] == ["rest", "retare", "rest"]
    assert told == rest.events


def test_retare_is_told_at_the_last_frame():
    rest = Rest(seconds=0.5)
    rest.retare()
    fill(rest, still(51))
    rest.retare()
    fill(rest, still(1, first=60))
    rest.retare()
    times = [time for time, kind, _ in rest.events if kind == "retare"]
    assert times == pytest.approx([math.nan, 5.5, 5.6], nan_ok=True)


def test_a_frame_that_was_given_before_is_ignored():
    rest = Rest(seconds=0.5)
    frames = [one for one in still(60) for _ in range(2)]
    assert fill(rest, frames)[0] == 100
    assert len(rest.frames.tactile) == 51
    at_once = [replace(one, received=0) for one in still(60)]  # frames of one read
    assert fill(Rest(seconds=0.5), at_once)[0] == 50


def test_joints_are_kept_if_all_frames_have_them():
    rest = Rest(seconds=0.5)
    for one in still(60):
        rest.add(frame(one.sequence, one.tactile, np.full(2, one.sequence)))
    assert rest.frames.joint.shape == (51, 2)


def test_drift_is_told_once(caplog):
    rest = Rest(seconds=0.5)
    assert math.isnan(rest.drift(still(1)[0]).amount)  # no rest yet
    fill(rest, still(60))
    near = [rest.drift(one) for one in still(60, first=60, seed=2)]
    assert math.isnan(near[28].amount)
    assert near[-1].amount < 3
    assert near[-1].taxels.tolist() == []
    away = still(80, first=120, seed=3)
    for one in away:
        one.tactile[[2, 5]] += 40
    far = [rest.drift(one) for one in away]
    assert far[-1].taxels.tolist() == [2, 5]
    assert 8 < far[-1].amount < 20
    assert [kind for _, kind, _ in rest.events] == ["rest", "drift"]
    assert len(caplog.records) == 1


def test_readings_without_noise_that_change_are_a_drift():
    rest = Rest(seconds=0.5, max_movement=0.5)
    fill(rest, still(60, noise=0.0))
    frames = still(62, first=60, noise=0.0)
    drifts = [rest.drift(one) for one in frames[:30]]
    assert [drift.taxels.tolist() for drift in drifts] == [[]] * 30
    assert drifts[-1].amount == 0
    for one in frames[30:]:
        one.tactile[3] += 1
    drifts = [rest.drift(one) for one in frames[30:]]
    assert [(drift.amount, drift.taxels.tolist()) for drift in drifts[29:]] == [(math.inf, [3])] * 3
    assert [kind for _, kind, _ in rest.events] == ["rest", "drift"]
    rest.retare()
    fill(rest, still(60, first=122, noise=0.0))
    for one in frames[30:]:
        rest.drift(one)
    assert [kind for _, kind, _ in rest.events[2:]] == ["retare", "rest", "drift"]


def test_movement_is_no_drift():
    rest = Rest(seconds=0.5)
    fill(rest, still(60))
    frames = still(60, first=60)
    for i, one in enumerate(frames):
        one.tactile[:] += 30 * i
    assert all(math.isnan(rest.drift(one).amount) for one in frames)


@pytest.mark.parametrize("name", ["seconds", "min_frames", "max_movement", "max_drift"])
@pytest.mark.parametrize("value", [0, -1.0, math.inf, math.nan])
def test_bad_numbers(name, value):
    with pytest.raises(ValueError, match=f"'{name}' must be positive and finite"):
        Rest(**{name: value})


def test_bad_frames():
    rest = Rest()
    rest.add(frame(0, np.zeros((3, 2))))
    with pytest.raises(
        ValueError, match=r"a frame must have shape \(3, 2\), as the previous frames"
    ):
        rest.add(frame(1, np.zeros((4, 2))))


def test_readings_are_relative_to_the_mean_so_far_and_then_to_the_rest():
    rest = Rest(seconds=0.5)
    frames = still(60)
    frames[0].tactile[4] = np.nan
    assert rest.shape is None
    assert np.isnan(rest.relative(frames[0])[4]).all()
    for count in (2, 3):
        tactile = np.stack([one.tactile for one in frames[:count]]).astype(np.float64)
        wanted = (frames[count - 1].tactile - np.nanmean(tactile, axis=0)).astype(np.float32)
        assert (rest.relative(frames[count - 1]) == wanted).all()
    fill(rest, frames[3:])
    assert rest.shape == (20, 3)
    wanted = (frames[59].tactile - rest.value).astype(np.float32)
    assert (rest.relative(frames[59]) == wanted).all()
    rest.retare()
    assert (rest.relative(frames[1]) == 0).all()


def test_readings_relative_to_frames_that_were_refused():
    rest = Rest(seconds=0.5)
    frames = still(51)
    frames[40].tactile[3, 1] += 1000
    for one in frames[:50]:
        rest.relative(one)
    with pytest.raises(RuntimeError, match=r"the rest must be measured first: .*taxel 3 by"):
        rest.relative(frames[50])


def test_what_is_shown_first_is_a_rest_whatever_moves():
    rest = FirstSecond()
    for time, value, shown in (
        (10.0, 4.0, 0.0),
        (10.5, 8.0, 2.0),
        (11.0, 6.0, 0.0),
        (11.1, 16, 10),
    ):
        reading = np.array([[value], [np.nan if time < 11 else value]], np.float32)
        one = LiveFrame(0, time, int(time * 1e9), None, reading)
        assert rest.relative(one)[0, 0] == shown
        assert rest.ready == (time >= 11)
    assert rest.value.tolist() == [[6.0], [6.0]]
