from itertools import pairwise

import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.sensors import allegro_uskin
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_embedding,
    plot_hand_panels,
    plot_label_confusions,
    plot_roc,
    save_figure,
)
from torch_geometric_tactile.visualization._taxel_map import segment_colors

LAYOUT = allegro_uskin()
PLACES = torch.randn(384, 3, generator=torch.Generator().manual_seed(0))


def points(ax):
    return [item for item in ax.collections if type(item).__name__ == "PathCollection"]


@pytest.mark.parametrize(("dims", "views"), [(2, [(0, 1)]), (3, [(0, 1), (0, 2), (1, 2)])])
def test_embedding_is_seen_along_each_axis(tmp_path, dims, views):
    figure = plot_embedding(PLACES[:, :dims], LAYOUT, axis_name="t-SNE", title="title")
    *axes, hand = figure.axes
    assert len(axes) == len(views)
    for ax, (x, y) in zip(axes, views, strict=True):
        assert (ax.get_xlabel(), ax.get_ylabel()) == (f"t-SNE {x + 1}", f"t-SNE {y + 1}")
        for i, item in enumerate(points(ax)):
            expected = PLACES[LAYOUT.digit == i][:, [x, y]].double()
            assert torch.tensor(item.get_offsets().data).equal(expected)
    assert not points(hand)
    save_figure(figure, tmp_path / "a.png")


@pytest.mark.parametrize(("dims", "views"), [(2, 1), (3, 3)])
def test_embedding_has_its_untrained_twin_beside(dims, views):
    places, twin = PLACES[:, :dims], PLACES[:, :dims].flip(0)
    figure = plot_embedding(places, LAYOUT, untrained=twin)
    axes = figure.axes[: 2 * views]
    assert [ax.get_title() for ax in (axes[0], axes[views])] == ["trained", "untrained"]
    chosen = LAYOUT.digit == 0
    for ax, expected in ((axes[0], places), (axes[views], twin)):
        drawn = torch.tensor(points(ax)[0].get_offsets().data)
        assert drawn.equal(expected[chosen][:, :2].double())
    assert figure.get_figwidth() <= 8
    with pytest.raises(ValueError, match=r"'untrained' must have the shape of 'places'"):
        plot_embedding(PLACES, LAYOUT, untrained=PLACES[:, :2])
    with pytest.raises(ValueError, match="'untrained' must hold finite"):
        plot_embedding(PLACES, LAYOUT, untrained=PLACES / 0)


@pytest.mark.parametrize("by", ["patch", "digit"])
def test_colours_are_those_of_the_hand(by):
    figure = plot_embedding(PLACES[:, :2], LAYOUT, color_by=by)
    colors = torch.tensor(segment_colors(LAYOUT, by))
    for i, item in enumerate(points(figure.axes[0])):
        found = torch.tensor(item.get_facecolors())[:, :3].float()
        torch.testing.assert_close(found, colors[LAYOUT.digit == i])
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == list(LAYOUT.digit_names)


def test_panels_share_one_symmetric_scale():
    values = {"a": torch.zeros(384), "b": torch.full((384,), -2.0)}
    values["a"][0] = 1
    figure = plot_hand_panels(LAYOUT, values, label="attribution (logit)")
    assert [ax.get_title() for ax in figure.axes[:2]] == ["a", "b"]
    bar = figure.axes[-1]
    assert bar.get_ylim() == (-2, 2)
    assert bar.get_ylabel() == "attribution (logit)"
    colors = [ax.collections[0].get_facecolors() for ax in figure.axes[:2]]
    assert colors[0].max(axis=1).min() > 0.9  # about white, and one light red
    assert (colors[1] == colors[1][0]).all()


def test_panels_clip_at_the_limit():
    values = {"a": torch.tensor([-9.0, 1.0]).repeat(192)}
    figure = plot_hand_panels(LAYOUT, values, limit=1.0)
    assert figure.axes[-1].get_ylim() == (-1, 1)
    with pytest.raises(ValueError, match=r"'limit' must be positive \(got 0\)"):
        plot_hand_panels(LAYOUT, values, limit=0)


def test_panels_wrap():
    figure = plot_hand_panels(LAYOUT, {str(i): torch.zeros(384) for i in range(3)}, columns=2)
    assert [ax.get_visible() for ax in figure.axes[:4]] == [True, True, True, False]


def test_label_confusions_show_counts():
    figure = plot_label_confusions([[[3, 1], [0, 4]], [[0, 0], [2, 2]]], ["soft", "heavy"], "t")
    texts = [[text.get_text() for text in ax.texts] for ax in figure.axes]
    assert texts[0] == ["3\n75.0 %", "1\n25.0 %", "0\n0.0 %", "4\n100.0 %"]
    assert texts[1][:2] == ["0\n-", "0\n-"]
    assert [ax.get_title() for ax in figure.axes] == ["soft", "heavy"]


def test_names_of_classes_do_not_touch():
    names = ["potato_chip_can", "mango_replica", "kitchen_paper", "plastic_tube"] * 2
    figure = plot_confusion([[1] * 8] * 8, names, "t")
    figure.canvas.draw()
    boxes = [tick.get_window_extent() for tick in figure.axes[0].get_xticklabels()]
    assert not any(a.overlaps(b) for a, b in pairwise(boxes))


def test_roc_of_long_names_keeps_its_label():
    curves = {f"potato chip can {i}": ([0, 1], [0, 1], 0.5) for i in range(9)}
    figure = plot_roc(curves, "t", bold="potato chip can 8")
    figure.canvas.draw()
    assert figure.axes[0].yaxis.label.get_window_extent().x0 >= 0
    assert figure.axes[0].get_lines()[8].get_linewidth() == 3.0


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"'places' must have shape \(384, 2\) or \(384, 3\)"):
        plot_embedding(PLACES[:, :1], LAYOUT)
    with pytest.raises(ValueError, match="'places' must hold finite"):
        plot_embedding(PLACES / 0, LAYOUT)
    with pytest.raises(ValueError, match=r"'color_by' must be 'patch' or 'digit' \(got 'link'\)"):
        plot_embedding(PLACES, LAYOUT, color_by="link")
    with pytest.raises(ValueError, match="'values' must hold the values of at least one picture"):
        plot_hand_panels(LAYOUT, {})
    with pytest.raises(ValueError, match=r"\"?'values\['a'\]' must have shape \(384,\)"):
        plot_hand_panels(LAYOUT, {"a": torch.zeros(3)})
    with pytest.raises(ValueError, match=r"'columns' must be at least 1 \(got 0\)"):
        plot_hand_panels(LAYOUT, {"a": torch.zeros(384)}, columns=0)
    with pytest.raises(ValueError, match=r"'matrices' must have shape \(1, 2, 2\)"):
        plot_label_confusions([[1, 2]], ["a"], "t")
    with pytest.raises(ValueError, match="'matrices' must hold counts"):
        plot_label_confusions([[[1, 2], [0.5, 0]]], ["a"], "t")
    with pytest.raises(ValueError, match=r"'columns' must be at least 1 \(got 0\)"):
        plot_label_confusions([[[1, 2], [0, 0]]], ["a"], "t", columns=0)
    with pytest.raises(ValueError, match=r"'bold' must be the name of a curve \(got 'b'\)"):
        plot_roc({"a": ([0, 1], [0, 1], 0.5)}, "t", bold="b")
