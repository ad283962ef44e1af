import numpy as np
import pytest

pytest.importorskip("matplotlib")

from torch_geometric_tactile.visualization import AlarmCurves, plot_early_slip

SECONDS = [0.1, 0.5, 1.0]


def _curves() -> AlarmCurves:
    recall = np.array([[0.9, 0.5, np.nan], [0.7, 0.3, np.nan]])
    return AlarmCurves(recall, np.array([[0.1, 0.05, 0.04], [0.1, 0.07, 0.02]]))


def test_plot_early_slip_draws_means_with_the_onset_at_the_right() -> None:
    methods = {"LSTM": _curves(), "force $": AlarmCurves(np.array([0.6, 0.2, 0.1]), np.zeros(3))}
    figure = plot_early_slip(SECONDS, methods, "Early slip")
    left, right = figure.axes
    assert left.get_xlim()[1] == right.get_xlim()[1] == 0.0
    first = left.lines[0]
    np.testing.assert_allclose(first.get_xdata(), [0.1, 0.5])
    np.testing.assert_allclose(first.get_ydata(), [0.8, 0.4])
    np.testing.assert_allclose(right.lines[0].get_ydata(), [0.1, 0.06, 0.03])
    assert len(left.collections) == 1  # one training has no spread
    colors = [line.get_markerfacecolor() for line in left.lines]
    assert colors[0] != "#ffffff" == colors[1]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "LSTM",
        r"force \$",
        "hollow: no spread known",
    ]


def test_plot_early_slip_without_any_count_draws_no_line() -> None:
    nothing = np.full((1, 3), np.nan)
    figure = plot_early_slip(SECONDS, {"LSTM": AlarmCurves(nothing, nothing)}, "Early slip")
    assert len(figure.axes[0].lines) == 0


def test_plot_early_slip_bad_input() -> None:
    with pytest.raises(ValueError, match="at least one method"):
        plot_early_slip(SECONDS, {}, "Early slip")
    with pytest.raises(ValueError, match="'LSTM' must have 3 times"):
        plot_early_slip(SECONDS, {"LSTM": AlarmCurves(np.zeros(2), np.zeros(3))}, "Early slip")
