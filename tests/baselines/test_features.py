import numpy as np
import pytest

from torch_geometric_tactile.baselines._features import FEATURE_NAMES, statistical_features

BY_HAND = {
    "maximum": 3.0,
    "minimum": -1.0,
    "peak": 3.0,
    "mean": 1.0,
    "variance": 4.0,
    "standard_deviation": 2.0,
    "absolute_mean": 2.0,
    "root_mean_square": 5**0.5,
    "crest_factor": 3 / 5**0.5,
    "form_factor": 5**0.5 / 2,
    "pulse_factor": 1.5,
    "margin_factor": 3 / ((3**0.5 + 1) / 2) ** 2,
}


@pytest.mark.parametrize("name", FEATURE_NAMES)
def test_statistical_features_by_hand(name):
    found = dict(zip(FEATURE_NAMES, statistical_features(np.array([3.0, -1.0])), strict=True))
    assert found[name] == pytest.approx(BY_HAND[name], rel=1e-12)


def test_statistical_features_order():
    assert tuple(BY_HAND) == FEATURE_NAMES  # that of the paper


def test_statistical_features_zeros():
    assert statistical_features(np.zeros(60)).tolist() == [0.0] * 12


def test_statistical_features_constant():
    found = dict(zip(FEATURE_NAMES, statistical_features(np.full(60, -2.0)), strict=True))
    assert found["peak"] == 2.0
    assert found["variance"] == 0.0
    for name in ("crest_factor", "form_factor", "pulse_factor", "margin_factor"):
        assert found[name] == pytest.approx(1.0)


def test_statistical_features_peak_of_the_other_sign():
    found = dict(zip(FEATURE_NAMES, statistical_features(np.array([-3.0, 1.0])), strict=True))
    assert (found["maximum"], found["minimum"], found["peak"]) == (1.0, -3.0, 3.0)


def test_statistical_features_leading_dimensions():
    signal = np.random.default_rng(0).normal(size=(5, 19, 3, 60)).astype(np.float32)
    found = statistical_features(signal)
    assert found.shape == (5, 19, 3, 12)
    assert np.allclose(found[2, 7, 1], statistical_features(signal[2, 7, 1]))
    assert statistical_features(signal[:0]).shape == (0, 19, 3, 12)


def test_statistical_features_scaling():
    # In another unit, sizes scale and factors do not.
    signal = np.random.default_rng(0).normal(size=60)
    once, twice = statistical_features(signal), statistical_features(2 * signal)
    assert np.allclose(twice / once, [2, 2, 2, 2, 4, 2, 2, 2, 1, 1, 1, 1])


@pytest.mark.parametrize("size", [(), (5, 0)])
def test_statistical_features_no_frame(size):
    with pytest.raises(ValueError, match="'signal' must hold at least one frame"):
        statistical_features(np.zeros(size))


@pytest.mark.parametrize("size", [(6,), (4, 3, 6)])
def test_statistical_features_missing_readings(size):
    # A ratio of NaN to zero would be zero.
    signal = np.ones(size)
    signal[(2, *[0] * (len(size) - 1))] = np.nan
    match = r"'signal' must hold finite readings only \(got 1 NaN .*, the first is 2\); fill .*Fill"
    with pytest.raises(ValueError, match=match):
        statistical_features(signal)
