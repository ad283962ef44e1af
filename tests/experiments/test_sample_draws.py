import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.experiments._sample_draws import Draws
from torch_geometric_tactile.experiments.predictions import Predictions


def judged(right):
    right = np.asarray(right)
    y = np.zeros(len(right), dtype=np.int64)
    return Predictions(score=np.zeros((len(right), 3)), prediction=(~right).astype(np.int64), y=y)


def test_paper_draws_1500_of_2500():
    draws = Draws()
    assert (draws.count, draws.num_drawn(2500)) == (10, 1500)
    # p (1 - p) / 1500 * 1000 / 2499, in squared percent
    assert 1e4 * draws.variance(0.5, 2500) == pytest.approx(0.25 / 1500 * 1000 / 2499 * 1e4)
    assert 1e4 * draws.variance(0.5, 2500) == pytest.approx(0.667, abs=1e-3)
    assert draws.variance(1.0, 2500) == draws.variance(0.0, 2500) == 0


def test_drawn_by_hand():
    # Three of four: a draw holds the wrong one (two thirds right), or not.
    draws = Draws(count=40, part=0.75)
    found = draws.accuracies(judged([True, True, False, True]))
    assert set(found.round(6).tolist()) == {round(2 / 3, 6), 1.0}
    metrics = draws.metrics(judged([True, True, False, True]))
    assert metrics["draws_accuracy"] == pytest.approx(found.mean())
    assert metrics["draws_variance"] == pytest.approx(np.sum((found - found.mean()) ** 2) / 39)


def test_variance_is_the_expected_one():
    right = np.random.default_rng(0).random(2500) < 0.8
    draws = Draws(count=4000)
    found = draws.metrics(judged(right))
    assert found["draws_accuracy"] == pytest.approx(right.mean(), abs=2e-4)
    assert found["draws_variance"] == pytest.approx(draws.variance(right.mean(), 2500), rel=0.1)


def test_draws_are_the_same_again_and_others_by_seed():
    right = np.random.default_rng(1).random(500) < 0.7
    assert np.array_equal(Draws().accuracies(judged(right)), Draws().accuracies(judged(right)))
    other = Draws(seed=1).accuracies(judged(right))
    assert not np.array_equal(Draws().accuracies(judged(right)), other)


def test_labels_are_right_if_all_are():
    y = np.array([[0, 1], [1, 1], [0, 0], [1, 0]])
    prediction = y.copy()
    prediction[0, 0] = 1
    predicted = Predictions(score=y.astype(float), prediction=prediction, y=y)
    assert Draws(count=3, part=0.99).accuracies(predicted).tolist() == [0.75] * 3


def test_one_sample_is_drawn_of_very_few():
    assert Draws(part=0.1).num_drawn(2) == 1
    assert Draws().metrics(judged([True])) == {"draws_accuracy": 1.0, "draws_variance": 0.0}
    assert Draws().variance(0.5, 1) == 0


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"count": 1}, r"'count' of draws must be a whole number of at least 2 \(got 1\)"),
        ({"count": 2.5}, r"'count' of draws must be a whole number .*\(got 2.5\)"),
        ({"seed": -1}, r"'seed' of draws must be a whole number of at least 0 \(got -1\)"),
        ({"part": 0.0}, r"'part' of draws must be between 0 and 1 \(got 0.0\)"),
        ({"part": 1.0}, r"'part' of draws must be between 0 and 1 \(got 1.0\)"),
        ({"part": "half"}, r"'part' of draws must be between 0 and 1 \(got 'half'\)"),
    ],
)
def test_bad_draws_are_named(arguments, match):
    with pytest.raises(ValueError, match=match):
        Draws(**arguments)
