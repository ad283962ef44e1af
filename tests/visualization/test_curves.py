import math

import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.visualization import plot_curves

CURVES = {
    "DF ($)": [(1, 80.0, 2.0), (2, 90.0, 1.0), (3, 85.0, math.nan)],
    "FF": [(1, 70.0, math.nan), (2, 75.0, math.nan)],
}


def test_a_line_and_a_band_for_each_series():
    figure = plot_curves(CURVES, "k", "Accuracy in %", "By k")
    (ax,) = figure.axes
    assert [line.get_ydata().tolist() for line in ax.lines] == [[80.0, 90.0, 85.0], [70.0, 75.0]]
    (band,) = ax.collections
    low, high = band.get_datalim(ax.transData).intervaly
    assert (low, high) == (78.0, 91.0)
    assert ax.get_xticks().tolist() == [1, 2, 3]
    assert [line.get_markerfacecolor() == "#ffffff" for line in ax.lines] == [False, True]
    assert figure.legends[0].get_texts()[-1].get_text() == "hollow: no spread known"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("k", "Accuracy in %")


def test_nothing_to_draw():
    with pytest.raises(ValueError, match=r"'curves' must hold at least one point \(got none\)"):
        plot_curves({"DF": []}, "k", "Accuracy in %", "By k")
