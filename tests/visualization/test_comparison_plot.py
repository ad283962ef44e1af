import math

import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.visualization import ComparisonPanel, plot_comparison

ROWS = {
    "GCN: T": {"published": (79.5, math.nan), "ours": (60.0, 2.0)},
    "GCN: T + E": {"published": (84.8, math.nan)},
    "MT-GCN: T + E": {"published": (86.1, math.nan), "ours": (62.0, math.nan)},
}


def texts(ax):
    return [label.get_text() for label in ax.get_yticklabels()]


def test_points_stand_where_the_numbers_are():
    figure = plot_comparison(
        [ComparisonPanel("with joints", "%", ROWS)], ["published", "ours"], "A"
    )
    (ax,) = figure.axes
    assert texts(ax) == list(ROWS)
    points = [line.get_xydata()[0] for line in ax.lines if line.get_marker() in ("D", "o")]
    assert [round(x, 1) for x, _ in points] == [79.5, 60.0, 84.8, 86.1, 62.0]
    assert [round(y) for _, y in points] == [0, 0, 1, 2, 2]
    bars = [collection for collection in ax.collections if len(collection.get_segments())]
    assert [segment[:, 0].tolist() for bar in bars for segment in bar.get_segments()] == [
        [58.0, 62.0]
    ]
    assert ax.get_ylim() == (2.5, -0.5)  # the first row above
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["published", "ours", "hollow: no spread known"]


def test_points_without_spread_are_hollow():
    (ax,) = plot_comparison([ComparisonPanel("", "%", ROWS)], ["published", "ours"], "A").axes
    points = [line for line in ax.lines if line.get_marker() in ("D", "o")]
    hollow = [line.get_markerfacecolor() == "#ffffff" for line in points]
    assert hollow == [True, False, True, True, True]
    known = {"a": {"ours": (1.0, 0.1)}}
    figure = plot_comparison([ComparisonPanel("", "%", known)], ["ours"], "A")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ours"]


def test_points_of_rows_with_one_kind_each_stand_in_the_middle():
    rows = {"svm": {"plain": (80.0, 1.0)}, "net": {"graph": (81.0, 1.0)}}
    (ax,) = plot_comparison([ComparisonPanel("", "%", rows)], ["plain", "graph"], "A").axes
    points = [line.get_xydata()[0] for line in ax.lines if line.get_marker() in ("D", "o")]
    assert [y for _, y in points] == [0.0, 1.0]


def test_panels_two_by_two_share_names_and_axes():
    panels = [ComparisonPanel(str(i), "%", ROWS) for i in range(2)]
    panels += [ComparisonPanel(str(i), "MB", ROWS, from_zero=True) for i in range(2)]
    axes = plot_comparison(panels, ["published", "ours"], "A").axes
    assert axes[0].get_xlim() == axes[1].get_xlim()
    assert axes[0].get_xlim()[0] > 0 == axes[2].get_xlim()[0] == axes[3].get_xlim()[0]
    shown = [ax.yaxis.get_tick_params()["labelleft"] for ax in axes]
    assert shown == [True, False, True, False]


def test_all_points_are_within_the_axis_that_panels_share():
    high = {"GCN: T": {"published": (99.0, 4.0)}, "GCN: T + E": {"published": (20.0, math.nan)}}
    panels = [ComparisonPanel("a", "%", ROWS), ComparisonPanel("b", "%", high)]
    figure = plot_comparison(panels, ["published", "ours"], "A")
    for ax in figure.axes:
        low, up = ax.get_xlim()
        assert low < 20.0 < 103.0 < up


def test_no_texts_overlap():
    panels = [ComparisonPanel(name, "accuracy in %", ROWS) for name in ("without", "with")]
    figure = plot_comparison(panels, ["published", "ours"], "A long title of a table " * 5)
    figure.canvas.draw()
    texts = [figure._suptitle, *figure.legends[0].get_texts()]
    for ax in figure.axes:
        texts += [ax.title, ax.xaxis.label, *(t for t in ax.get_yticklabels() if t.get_visible())]
    boxes = [text.get_window_extent() for text in texts if text.get_text()]
    page = figure.bbox
    for i, box in enumerate(boxes):
        assert page.x0 <= box.x0 < box.x1 <= page.x1
        assert page.y0 <= box.y0 < box.y1 <= page.y1
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_panels_of_long_names_stand_below_one_another():
    other = {
        f"{'a very long name of a row of the table ' * 2}{i}": row
        for i, row in enumerate(ROWS.values())
    }
    panels = [ComparisonPanel("a", "%", ROWS), ComparisonPanel("b", "MB", other)]
    figure = plot_comparison(panels, ["published", "ours"], "A")
    assert figure.axes[0].get_subplotspec().rowspan.start == 0
    assert figure.axes[1].get_subplotspec().rowspan.start == 1
    assert figure.get_figwidth() <= 8


def test_rejects():
    with pytest.raises(ValueError, match=r"'panels' must hold at least one panel .*\(got none\)"):
        plot_comparison([], ["a"], "A")
    with pytest.raises(ValueError, match=r"'panels' must hold at least one panel with .* row"):
        plot_comparison([ComparisonPanel("a", "b", {})], ["a"], "A")
    with pytest.raises(ValueError, match=r"'series' must hold all names .*lacks \['ours'\]"):
        plot_comparison([ComparisonPanel("a", "b", ROWS)], ["published"], "A")
