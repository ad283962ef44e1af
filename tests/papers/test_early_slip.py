import math

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.papers.early_slip import (
    SlipScores,
    alarm_threshold,
    lead_times,
    slip_summary,
)


def _scores() -> SlipScores:
    # Grasp 0 slips at 1.0 s, grasp 1 at 2.0 s, grasps 2 and 3 hold; a moment every 0.5 s.
    return SlipScores(
        score=[0.2, 0.9, 0.1, 0.3, 0.4, 0.2, 0.6, 0.1, 0.1, 0.1, 0.1, 0.5, 0.1],
        to_slip=[1.0, 0.5, 2.0, 1.5, 1.0, 0.5] + [math.inf] * 7,
        moment=[0.0, 0.5, 0.0, 0.5, 1.0, 1.5, 0.0, 0.5, 1.0, 1.5, 0.0, 0.5, 1.5],
        trial=[0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3],
    )


def test_alarm_threshold_of_two_in_seven() -> None:
    scores = _scores()
    threshold = alarm_threshold(scores, 2 / 7)
    assert threshold == 0.5
    assert (scores.score[~scores.slips] >= threshold).sum() == 2


def test_alarm_threshold_never_lets_more_through() -> None:
    draw = np.random.default_rng(0)
    held = SlipScores(draw.integers(0, 9, 200), [math.inf] * 200, np.arange(200), [0] * 200)
    for part in (0.004, 0.05, 0.3, 0.99):
        assert (held.score >= alarm_threshold(held, part)).mean() <= part
    assert not (held.score >= alarm_threshold(held, 0.004)).any()


def test_alarm_threshold_at_the_moments_of_slips() -> None:
    # 0.5 s before a slip: grasps 2 and 3 say 0.1, 0.1, 0.5 and 0.1; 1 s before: 0.6, 0.1 and 0.1.
    scores = _scores()
    assert alarm_threshold(scores, 0.25, before=0.5) == 0.5
    assert alarm_threshold(scores, 1 / 3, before=1.0) == 0.6
    for before in (0.5, 1.0):
        threshold = alarm_threshold(scores, 0.4, before)
        assert lead_times(scores, threshold, [before]).false_alarms <= 0.4
    with pytest.raises(ValueError, match="must have grasps that hold"):
        alarm_threshold(scores, 0.25, before=3.0)  # no grasp has a moment then


def test_lead_times_by_hand() -> None:
    found = lead_times(_scores(), 0.4, [0.5, 1.0, 1.5, 3.0])
    assert found.num_slips.tolist() == [2, 2, 1, 0]
    np.testing.assert_allclose(found.recall, [0.5, 0.5, 0.0, math.nan])
    # 0.5 s before: the moments 0.5 and 1.5 of grasps 2 and 3; 1 s before: 0.0 and 1.0.
    np.testing.assert_allclose(found.false_alarms, [0.25, 1 / 3, 0.5, math.nan])


def test_a_clock_has_no_skill() -> None:
    # All slips happen at 1 s, and the score is a clock: it alarms in grasps that hold as well.
    moment = np.tile(np.arange(0.0, 0.96, 0.1), 20)
    trial = np.repeat(np.arange(20), 10)
    to_slip = np.where(trial < 10, 1.0 - moment, math.inf)
    found = lead_times(SlipScores(moment, to_slip, moment, trial), 0.75, [0.1, 0.2, 0.5])
    np.testing.assert_allclose(found.recall, [1.0, 1.0, 0.0])
    np.testing.assert_allclose(found.false_alarms, found.recall)


def test_slip_summary_by_hand() -> None:
    found = slip_summary(_scores(), 0.4, within=1.0)
    assert found.announced == 1.0
    assert found.held_alarmed == 1.0
    assert found.moments_alarmed == pytest.approx(2 / 7)
    assert found.median_lead == pytest.approx(0.75)  # 0.5 s and 1.0 s
    soon, held = [0.2, 0.9, 0.4, 0.2], [0.6, 0.1, 0.1, 0.1, 0.1, 0.5, 0.1]
    pairs = [(a > b) + 0.5 * (a == b) for a in soon for b in held]
    assert found.roc_auc == pytest.approx(np.mean(pairs))


def test_slip_summary_without_slips_or_holds() -> None:
    scores = _scores()
    held = slip_summary(scores.select(~scores.slips), 0.4, within=1.0)
    assert math.isnan(held.announced)
    assert math.isnan(held.median_lead)
    assert math.isnan(held.roc_auc)
    slipping = slip_summary(scores.select(scores.slips), 2.0, within=1.0)
    assert slipping.announced == 0.0
    assert math.isnan(slipping.held_alarmed)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"to_slip": [0.0, 0.5]}, "above zero"),
        ({"to_slip": [math.nan, 0.5]}, "above zero"),
        ({"score": [math.nan, 0.5]}, "'score' must be finite"),
        ({"moment": [0.0]}, "'moment' must have one value a moment"),
        ({"moment": [0.0, 0.9]}, "one onset of slip"),
        ({"to_slip": [1.0, math.inf]}, "one onset of slip"),
    ],
)
def test_bad_scores(changed: dict[str, list[float]], message: str) -> None:
    given = {"score": [0.1, 0.2], "to_slip": [1.0, 0.5], "moment": [0.0, 0.5], "trial": [0, 0]}
    SlipScores(**given)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=message):
        SlipScores(**given | changed)  # type: ignore[arg-type]


def test_bad_arguments() -> None:
    scores = _scores()
    with pytest.raises(ValueError, match="'false_alarms' must be between"):
        alarm_threshold(scores, 0.0)
    with pytest.raises(ValueError, match="grasps that hold"):
        alarm_threshold(scores.select(scores.slips), 0.1)
    with pytest.raises(ValueError, match="times above zero"):
        lead_times(scores, 0.5, [0.0])
