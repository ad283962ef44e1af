import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.experiments.grasp_numbers import Judged, grasp_differences
from torch_geometric_tactile.experiments.judgement import Judgement


def judged(right, y):
    prediction = np.where(right, y, 1 - y)
    return Judgement(score=prediction.astype(float), prediction=prediction, y=y)


def test_differences_are_those_of_one_kind_of_readings():
    y = np.array([0, 1, 0, 1])
    said = {
        Judged("net", "test", "raw", 0): judged([True, True, True, False], y),
        Judged("twin", "test", "raw", 0): judged([True, False, False, False], y),
        Judged("net", "test", "session", 0): judged([False] * 4, y),
    }
    (difference,) = grasp_differences(said, "raw", "net", "twin").values()
    assert difference.mean == pytest.approx(0.5)
    assert difference.num_splits == 1


def test_a_sample_that_all_seeds_judge_is_one_observation():
    y = np.array([0, 1, 0, 1])
    net, twin = judged([True, True, True, False], y), judged([True, False, False, False], y)
    folds = judged([True, True, True, False], y[::-1].copy())
    other = judged([True, False, False, False], y[::-1].copy())
    said = {
        Judged("net", "test", "raw", 0): net,
        Judged("net", "test", "raw", 1): net,
        Judged("net", "folds", "raw", 0): net,
        Judged("net", "folds", "raw", 1): folds,
        Judged("twin", "test", "raw", 0): twin,
        Judged("twin", "test", "raw", 1): twin,
        Judged("twin", "folds", "raw", 0): twin,
        Judged("twin", "folds", "raw", 1): other,
    }
    found = grasp_differences(said, "raw", "net", "twin")
    assert (found["test"].num_trials, found["folds"].num_trials) == (4, 8)
    assert found["test"].error > found["folds"].error
