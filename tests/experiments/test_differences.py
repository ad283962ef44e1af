import math

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np

from torch_geometric_tactile.experiments._scores import prediction_scores, sample_scores
from torch_geometric_tactile.experiments.differences import Difference, paired_difference
from torch_geometric_tactile.experiments.predictions import Predictions

Y = np.array([0, 0, 1, 1])


def said(*hits, y=Y, trial=(0, 0, 1, 1), index=None):
    hit = np.array(hits, dtype=bool)
    prediction = np.where(hit, y, 1 - y)
    trial = None if trial is None else np.array(trial)
    return Predictions(prediction, prediction, y, trial=trial, index=index)


def test_difference_by_hand():
    # Gains: 1, 0, 0, 0 and 1, 1, -1, 0; trial 0 adds 1/4 and 2/4, trial 1 adds 0 and -1/4.
    first = [said(1, 1, 0, 1), said(1, 1, 0, 1, trial=(2, 2, 3, 3))]
    second = [said(0, 1, 0, 1), said(0, 0, 1, 1, trial=(2, 2, 3, 3))]
    found = paired_difference(first, second, "accuracy")
    assert found.mean == 0.25
    assert found.over_splits == 0.0
    gains = [(0.75 - 0.25) / 8, (-0.25 - 0.25) / 8, (0.75 + 0.75) / 8, (-1.25 - 0.25) / 8]
    assert found.over_units == pytest.approx(math.sqrt(4 / 3 * np.square(gains).sum()))
    assert (found.num_splits, found.num_units) == (2, 4)


def test_trial_of_several_splits_is_one_observation():
    first, second = said(1, 1, 1, 1), said(0, 0, 1, 1)
    once = paired_difference([first], [second], "accuracy")
    twice = paired_difference([first] * 2, [second] * 2, "accuracy")
    assert once.over_units == pytest.approx(twice.over_units)
    assert math.isnan(once.over_splits)
    assert twice.over_splits == 0.0
    assert twice.num_units == 2


def test_frames_of_a_trial_do_not_make_it_sure():
    few = paired_difference([said(1, 1, 1, 1)], [said(0, 0, 1, 1)], "accuracy")
    y = Y.repeat(10)
    many = paired_difference(
        [said(*[1] * 40, y=y, trial=[0] * 20 + [1] * 20)],
        [said(*[0] * 20, *[1] * 20, y=y, trial=[0] * 20 + [1] * 20)],
        "accuracy",
    )
    assert many.over_units == pytest.approx(few.over_units)
    alone = paired_difference(
        [said(*[1] * 40, y=y, trial=None)],
        [said(*[0] * 20, *[1] * 20, y=y, trial=None)],
        "accuracy",
    )
    assert alone.num_units == 40
    assert alone.over_units < many.over_units / 3


@pytest.mark.parametrize(("starts", "count"), [((0, 0), 4), ((0, 4), 8), ((0, 2), 6)])
def test_sample_that_two_splits_test_on_is_one_observation(starts, count):
    places = [np.arange(start, start + 4) for start in starts]
    first = [said(1, 1, 1, 1, trial=None, index=index) for index in places]
    second = [said(0, 1, 1, 1, trial=None, index=index) for index in places]
    assert paired_difference(first, second, "accuracy").num_units == count


def test_overlap_of_training_parts_by_hand():
    # Gains of three folds: 1/4, 2/4 and 3/4; a test part is half as large as a training part.
    hits = [(1, 0, 0, 0), (1, 1, 0, 0), (1, 1, 1, 0)]
    first = [
        said(*hit, trial=[4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3]) for i, hit in enumerate(hits)
    ]
    second = [said(0, 0, 0, 0, trial=predicted.trial) for predicted in first]
    apart, found = (paired_difference(first, second, "accuracy", *o) for o in ((), (0.5,)))
    assert apart.over_splits == pytest.approx(0.25 / math.sqrt(3))  # 0.1443
    assert found.over_splits == pytest.approx(0.25 * math.sqrt(1 / 3 + 1 / 2))  # 0.2282
    assert found.margin == pytest.approx(4.302653 * 0.228218, rel=1e-5)  # t of two degrees
    assert found.mean == 0.5
    assert found.verdict == "within the noise"  # twice the uncorrected error would be 0.29


def test_seeds_of_one_test_part_are_one_split():
    # Object 0 is left out with two seeds (gains 0.5 and 0), object 1 with two (1 and 0.5).
    one = [said(1, 1, 1, 1, index=np.arange(4))] * 2 + [said(1, 1, 1, 1, index=np.arange(4, 8))] * 2
    other = [
        said(0, 0, 1, 1, index=np.arange(4)),
        said(1, 1, 1, 1, index=np.arange(4)),
        said(0, 0, 0, 0, index=np.arange(4, 8)),
        said(0, 0, 1, 1, index=np.arange(4, 8)),
    ]
    found = paired_difference(one, other, "accuracy", overlap=1.0)
    assert (found.mean, found.num_splits) == (0.5, 2)
    assert found.over_splits == pytest.approx(math.sqrt(0.125) * math.sqrt(1 / 2 + 1))
    assert found.verdict == "too few splits"
    assert found.num_seeds == 1  # of two test parts


def test_seeds_of_given_parts_add_to_the_error_over_units():
    # Gains 0.5 and 0 of two seeds on one test part: 0.25 on average, 0.25 over seeds.
    index = np.arange(4)
    one = [said(1, 1, 1, 1, trial=None, index=index)] * 2
    other = [said(0, 0, 1, 1, trial=None, index=index), said(1, 1, 1, 1, trial=None, index=index)]
    found = paired_difference(one, other, "accuracy")
    assert (found.mean, found.num_splits, found.num_seeds, found.num_units) == (0.25, 1, 2, 4)
    assert math.isnan(found.over_splits)
    # Gains of the samples, mean of both seeds: 0.5, 0.5, 0, 0.
    assert found.over_units == pytest.approx(np.std([0.5, 0.5, 0, 0], ddof=1) / 2)
    assert found.over_seeds == pytest.approx(0.25)
    assert found.error == pytest.approx(math.hypot(found.over_units, 0.25))
    assert found.margin == pytest.approx(3.182446 * found.error)  # t of three degrees
    assert found.verdict == "within the noise"
    same = paired_difference(one[:1] * 3, other[:1] * 3, "accuracy")  # models without randomness
    assert (same.num_splits, same.num_seeds, same.over_seeds) == (1, 3, 0.0)
    assert same.margin == paired_difference(one[:1], other[:1], "accuracy").margin


def test_one_given_part_is_judged_by_its_units():
    hits = np.array([1, 1, 1, 1, 1, 0], dtype=bool)
    y, trial, index = np.array([0, 1] * 3), np.arange(6), np.arange(10, 16)
    first, second = (
        said(*hit, y=y, trial=trial, index=index) for hit in (hits | True, ~hits & False)
    )
    one = paired_difference([first], [second], "accuracy", unit="person")
    assert one.has_one_test_part
    assert (one.unit, one.units, one.splits) == ("person", (6, 0), (1, 0))
    assert one.is_beyond_noise
    almost = paired_difference([first], [said(*hits, y=y, trial=trial, index=index)], "accuracy")
    assert almost.mean == pytest.approx(1 / 6)
    # Gains 0, 0, 0, 0, 0, 1: standard error 1/6, times 2.571 of five degrees.
    assert almost.over_units == pytest.approx(1 / 6)
    assert almost.margin == pytest.approx(2.570582 / 6, rel=1e-5)
    assert almost.verdict == "within the noise"
    two = [said(1, 1, trial=(0, 1), y=np.array([0, 1]), index=np.arange(2))] * 2
    assert paired_difference(two, two, "accuracy", unit="person").verdict == "too few persons"


def test_signs_count_splits_and_units():
    first = [said(1, 1, 0, 0, trial=(0, 0, 1, 1)), said(1, 1, 1, 1, trial=(2, 2, 3, 3))]
    second = [said(0, 1, 1, 1, trial=(0, 0, 1, 1)), said(0, 1, 1, 1, trial=(2, 2, 3, 3))]
    found = paired_difference(first, second, "accuracy")
    assert found.splits == (1, 1)  # -1/4 and 1/4
    assert found.units == (2, 1)  # trials 0 and 2 against trial 1; trial 3 is level


@pytest.mark.parametrize(
    ("mean", "over_units", "expected"),
    [(0.21, 0.02, True), (0.205, 0.02, False), (0.21, 0.2, False)],
)
def test_more_folds_could_prove_a_difference(mean, over_units, expected):
    # Ten folds in place of three: 0.1 * sqrt((1 + 10/9) / (1 + 3/2)) * 2.262 = 0.2079.
    found = Difference(mean, 0.1, over_units, 3, 100)
    assert found.verdict == "within the noise"
    assert found.is_proved_by(10) is expected


@pytest.mark.parametrize("metric", ["accuracy", "balanced_accuracy"])
def test_mean_of_sample_scores_is_the_score(metric):
    draw = np.random.default_rng(0)
    y, prediction = draw.integers(0, 4, 50), draw.integers(0, 4, 50)
    expected = prediction_scores(y, prediction, is_regression=False)[metric]
    assert sample_scores(y, prediction, metric).mean() == pytest.approx(expected)


def test_errors_of_numbers():
    y = np.array([[0.0, 1.0], [2.0, 3.0]])
    prediction = np.array([[1.0, 1.0], [0.0, 3.0]])
    assert sample_scores(y, prediction, "mae").tolist() == [0.5, 1.0]
    assert prediction_scores(y, prediction, is_regression=True)["mae"] == 0.75


def test_all_labels_of_a_sample_must_be_right():
    y = np.array([[1, 0], [0, 1], [1, 1]])
    other = np.array([[1, 0], [0, 0], [1, 1]])
    first, second = (Predictions(p, p, y, trial=np.arange(3)) for p in (y, other))
    found = paired_difference([first], [second], "accuracy")
    assert found.mean == pytest.approx(1 / 3)


def test_scores_are_those_of_scikit_learn():
    from sklearn.metrics import balanced_accuracy_score, f1_score

    draw = np.random.default_rng(1)
    y, prediction = draw.integers(0, 3, 40), draw.integers(0, 5, 40)
    found = prediction_scores(y, prediction, is_regression=False)
    assert found["f1"] == pytest.approx(f1_score(y, prediction, average="macro"))
    y, prediction = np.append(y[prediction < 3], 3), np.append(prediction[prediction < 3], 3)
    found = prediction_scores(y, prediction, is_regression=False)  # with a class of one sample
    expected = balanced_accuracy_score(y, prediction)
    assert found["balanced_accuracy"] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("mean", "over_splits", "over_trials", "counts", "verdict"),
    [
        (0.3, 0.1, 0.13, (5, 9), "beyond the noise"),  # 2.776 over splits, 2.306 over trials
        (-0.3, 0.1, 0.13, (5, 9), "beyond the noise"),
        (0.3, 0.11, 0.13, (5, 9), "within the noise"),
        (0.3, 0.1, 0.14, (5, 9), "within the noise"),
        (0.3, 0.01, 0.01, (2, 9), "too few splits"),
        (0.3, math.nan, 0.01, (1, 9), "too few splits"),
        (0.3, 0.01, 0.01, (3, 2), "too few trials"),
        (0.0, 0.0, 0.0, (5, 9), "within the noise"),
    ],
)
def test_one_rule_for_the_noise(mean, over_splits, over_trials, counts, verdict):
    found = Difference(mean, over_splits, over_trials, *counts)
    assert found.verdict == verdict
    assert found.is_beyond_noise is (verdict == "beyond the noise")


def test_other_samples_are_refused():
    with pytest.raises(ValueError, match="'second' must have the same samples as 'first'"):
        paired_difference([said(1, 1, 1, 1)], [said(1, 1, 1, 1, y=1 - Y)], "accuracy")
