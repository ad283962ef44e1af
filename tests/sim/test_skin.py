from dataclasses import replace

import numpy as np
import pytest

from torch_geometric_tactile.sensors import allegro_uskin, grid
from torch_geometric_tactile.sim import SkinModel

PAD = grid(2, 2, 0.005)
REST = (33000, 33000, 37000)
# Every part switched off: 100 counts per newton, and nothing else.
PLAIN = SkinModel(
    spread=0,
    lag=0,
    saturation=(float("inf"),) * 3,
    gain=(100.0,) * 3,
    mixing=0,
    gain_spread=0,
    offset_spread=0,
    drift=0,
    noise=0,
    quantize=False,
)


def newtons(skin, force, rate=100.0, layout=PAD, rng=None):
    """What the skin makes of forces, in newtons."""
    counts = skin.readings(
        np.asarray(force, dtype=float), np.arange(len(force)) / rate, layout, rng
    )
    return (counts.astype(float) - REST) / 100


def one_press(layout=PAD, taxel=0, axis=2, size=1.0, frames=1):
    force = np.zeros((frames, layout.num_taxels, 3))
    force[:, taxel, axis] = size
    return force


def test_plain_skin_is_a_gain_and_an_offset():
    force = np.random.default_rng(0).normal(size=(5, 4, 3))
    assert np.abs(newtons(PLAIN, force) - force).max() < 1e-4


def test_force_spreads_within_its_patch_and_is_conserved():
    layout = allegro_uskin()
    skin = replace(PLAIN, spread=0.35)
    force = np.random.default_rng(0).normal(size=(2, 384, 3))
    read = newtons(skin, force, layout=layout)
    patch = layout.patch.numpy()
    for number in np.unique(patch):
        total = force[:, patch == number].sum(axis=1)
        assert read[:, patch == number].sum(axis=1) == pytest.approx(total, abs=1e-3)
    read = newtons(skin, one_press(layout, taxel=100), layout=layout)[0, :, 2]
    assert read[100] == pytest.approx(0.65, abs=1e-3)
    assert (read[patch != patch[100]] == 0).all()
    near = np.linalg.norm(layout.pos.numpy() - layout.pos[100].numpy(), axis=1)
    others = (patch == patch[100]) & (near > 0)
    order = near[others].argsort(kind="stable")
    assert (np.diff(read[others][order]) <= 1e-4).all()  # the nearer, the more


def test_single_taxel_keeps_its_force():
    one = grid(1, 1, 0.005)
    assert newtons(replace(PLAIN, spread=0.35), one_press(one), layout=one)[0, 0, 2] == 1


def test_axes_mix():
    read = newtons(replace(PLAIN, mixing=0.06), one_press(axis=0, size=10.0))[0, 0]
    assert read[0] == pytest.approx(10)
    assert 0 < np.abs(read[1:]).max() <= 0.6
    assert not newtons(replace(PLAIN, mixing=0.06), one_press(axis=0, size=10.0))[0, 1:].any()


@pytest.mark.parametrize(
    ("seconds", "loop"),
    [
        (1.0, 0.050),
        (5.0, 2 * 0.1 * 0.6 / 5),
        (10.0, 2 * 0.1 * 0.6 / 10),
        (20.0, 2 * 0.1 * 0.6 / 20),
    ],
)
def test_press_and_release_differ_by_the_lag(seconds, loop):
    # Both the press and the release are behind by the lag times the slope times the time constant.
    up = np.linspace(0, 1, int(seconds * 100))
    force = np.concatenate([up, up[::-1]])[:, None, None] * np.ones((1, 4, 3))
    read = newtons(replace(PLAIN, lag=0.10, lag_time=0.6), force)[:, 0, 2]
    pressed, released = read[: len(up)], read[len(up) :][::-1]
    assert (released - pressed).max() == pytest.approx(loop, rel=0.04)
    assert newtons(PLAIN, force)[:, 0, 2] == pytest.approx(force[:, 0, 2], abs=1e-4)


def test_late_part_follows_a_step_with_its_time_constant():
    force = np.concatenate([one_press(size=0.0), one_press(frames=300)])
    read = newtons(replace(PLAIN, lag=0.10, lag_time=0.6), force)[:, 0, 2]
    assert read[1] == pytest.approx(0.9, abs=0.01)
    assert read[60] == pytest.approx(1 - 0.1 / np.e, abs=0.002)
    assert read[-1] == pytest.approx(1, abs=0.002)


def test_response_saturates():
    skin = replace(PLAIN, saturation=(4.0, 4.0, 10.0))
    read = newtons(skin, np.array([0.1, 10.0, 100.0])[:, None, None] * np.ones((1, 4, 3)))[:, 0]
    assert read[0] == pytest.approx([0.1, 0.1, 0.1], rel=1e-3)
    assert read[1] == pytest.approx([4 * np.tanh(2.5), 4 * np.tanh(2.5), 10 * np.tanh(1)], rel=1e-4)
    assert read[2] == pytest.approx([4, 4, 10], rel=1e-4)
    assert newtons(skin, np.full((1, 4, 3), -100.0))[0, 0] == pytest.approx([-4, -4, -10])


def test_each_device_has_gains_and_offsets_of_its_own():
    layout = allegro_uskin()
    rest, press = np.zeros((1, 384, 3)), np.ones((1, 384, 3))
    skin = replace(PLAIN, offset_spread=250.0)
    offset = 100 * newtons(skin, rest, layout=layout)[0]
    assert np.abs(offset.mean(axis=0)).max() < 60
    assert offset.std() == pytest.approx(250, rel=0.1)
    skin = replace(PLAIN, gain_spread=0.10)
    gain = newtons(skin, press, layout=layout)[0]
    assert gain.mean() == pytest.approx(1, abs=0.02)
    assert gain.std() == pytest.approx(0.1, rel=0.1)
    again = newtons(replace(skin), press, layout=layout)[0]
    other = newtons(replace(skin, device_seed=1), press, layout=layout)[0]
    assert np.array_equal(gain, again)
    assert not np.allclose(gain, other, atol=0.01)


def test_each_trial_drifts_in_its_own_way():
    layout = allegro_uskin()
    rest = np.zeros((1001, 384, 3))  # ten seconds
    skin = replace(PLAIN, drift=10.0)
    first, second = (
        100 * newtons(skin, rest, layout=layout, rng=np.random.default_rng(seed)) for seed in (0, 1)
    )
    assert first[0].std() == pytest.approx(10, rel=0.1)
    assert (first[-1] - first[0]).std() == pytest.approx(10, rel=0.1)
    assert np.abs(np.diff(first, n=2, axis=0)).max() < 0.02  # along a line, to float32
    assert np.abs(first - second).max() > 10
    assert not newtons(skin, rest, layout=layout).any()  # none without a generator


def test_noise():
    rest = np.zeros((2000, 4, 3))
    skin = replace(PLAIN, noise=10.0)
    read = 100 * newtons(skin, rest, rng=np.random.default_rng(0))
    assert read.std(axis=0) == pytest.approx(10, rel=0.1)
    assert abs(np.corrcoef(read[:-1, 0, 2], read[1:, 0, 2])[0, 1]) < 0.1
    assert not newtons(skin, rest).any()


def test_counts_are_whole_and_of_16_bits():
    force = np.array([0.111, 1e4, -1e4])[:, None, None] * np.ones((1, 4, 3))
    counts = replace(PLAIN, quantize=True).readings(force, np.arange(3.0), PAD)
    assert counts.dtype == np.float32
    assert counts[0, 0].tolist() == [33011, 33011, 37011]
    assert (counts[1] == 65535).all()
    assert (counts[2] == 0).all()


def test_whole_skin_rests_where_it_should():
    layout = allegro_uskin()
    rng = np.random.default_rng(0)
    counts = SkinModel().readings(np.zeros((100, 384, 3)), np.arange(100) / 100, layout, rng)
    assert counts.mean(axis=(0, 1)) == pytest.approx(REST, abs=60)
    assert np.array_equal(counts, counts.round())


def test_same_seeds_give_the_same_bits():
    force = np.random.default_rng(0).normal(size=(5, 4, 3))
    first, again, other = (
        SkinModel().readings(force, np.arange(5.0), PAD, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_caller_keeps_the_forces():
    force = np.ones((3, 4, 3))
    SkinModel().readings(force, np.arange(3.0), PAD, np.random.default_rng(0))
    assert (force == 1).all()


def test_no_frames():
    empty = SkinModel().readings(np.zeros((0, 4, 3)), np.zeros(0), PAD, np.random.default_rng(0))
    assert empty.shape == (0, 4, 3)


def test_bad_values_are_named():
    for key in ("spread", "lag", "mixing"):
        for value in (-0.1, 1.0, float("nan")):
            with pytest.raises(ValueError, match=f"'{key}' must be at least 0 and below 1"):
                SkinModel(**{key: value})
    for key in ("gain_spread", "offset_spread", "drift", "noise"):
        with pytest.raises(ValueError, match=f"'{key}' must not be negative"):
            SkinModel(**{key: -1.0})
    for key in ("spread_length", "lag_time"):
        with pytest.raises(ValueError, match=rf"'{key}' must be positive \(got 0\)"):
            SkinModel(**{key: 0})
    for key in ("saturation", "gain"):
        for value in ((1.0, 1.0), (1.0, 0.0, 1.0)):
            with pytest.raises(ValueError, match=f"'{key}' must be three positive numbers"):
                SkinModel(**{key: value})
    with pytest.raises(ValueError, match=r"'force' must have shape \(2, 4, 3\) \(got \(2, 4\)\)"):
        SkinModel().readings(np.zeros((2, 4)), np.zeros(2), PAD)
