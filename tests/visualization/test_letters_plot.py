import numpy as np
import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.visualization import plot_presses

SIX = grid(2, 3, pitch=0.001)


def panels(figure):
    axes = [ax for ax in figure.axes if ax.get_label() != "<colorbar>"]
    return [ax for ax in axes if ax.get_title()]


def bar(figure):
    (ax,) = [ax for ax in figure.axes if ax.get_label() == "<colorbar>"]
    return ax


def test_images_with_titles():
    readings = np.arange(18.0).reshape(3, 6)
    figure = plot_presses(readings, ["A", "B", "$C"], SIX, columns=2, title="all")
    shown = panels(figure)
    assert [ax.get_title() for ax in shown] == ["A", "B", r"\$C"]
    for ax, press in zip(shown, readings, strict=True):
        (image,) = ax.images
        assert image.get_array().tolist() == press.reshape(2, 3).tolist()
        # 17 positive readings, 1 to 17: the quantile is at 1 + 0.995 * 16.
        assert image.get_clim() == pytest.approx((0.0, 16.92))
    assert bar(figure).get_ylabel() == "reading"
    assert figure.get_suptitle() == "all"


def test_stacks_of_images_are_the_same():
    figure = plot_presses(np.arange(12.0).reshape(2, 2, 3), "AB", SIX)
    assert panels(figure)[1].images[0].get_array().tolist() == [[6, 7, 8], [9, 10, 11]]


def test_missing_pixels_are_no_readings():
    thin = TaxelLayout("thin", SIX.pos[1:], image_map=SIX.image_map[1:])
    figure = plot_presses(np.ones((1, 5)), "A", thin)
    array = panels(figure)[0].images[0].get_array()
    assert np.ma.getmaskarray(np.ma.masked_invalid(array)).tolist() == [
        [True, *[False] * 2],
        [False] * 3,
    ]


def test_layout_without_image_map_is_drawn_as_circles_from_the_top():
    layout = TaxelLayout("plain", torch.tensor([[0.0, 0.0], [0.001, 0.003]]))
    figure = plot_presses(np.array([[0.0, 5.0]]), "A", layout, limits=(0, 10), cmap="gray")
    (ax,) = panels(figure)
    assert not ax.images
    (circles,) = ax.collections
    assert circles.get_offsets().tolist() == pytest.approx(np.array([[0.0, 0.0], [1.0, 3.0]]))
    colors = circles.get_facecolors()
    assert colors[0, :3].tolist() == [0, 0, 0]
    assert colors[1, :3] == pytest.approx([0.5] * 3, abs=0.01)
    bottom, top = ax.get_ylim()
    assert bottom > 3 > 0 > top


def test_an_outlier_does_not_set_the_colours():
    readings = np.zeros((2, 1024))
    readings[:, :500] = np.linspace(0.1, 5.0, 500)
    readings[0, 7] = 900.0
    figure = plot_presses(readings, "AB", label="kPa")
    low, high = panels(figure)[0].images[0].get_clim()
    assert low == 0
    assert 4.9 < high < 5.1
    assert bar(figure).get_ylabel() == "kPa"
    assert bar(figure)._colorbar.extend == "max"
    readings[0, 7] = 0.0
    figure = plot_presses(readings, "AB", limits=(0, 6))
    assert bar(figure)._colorbar.extend == "neither"


def test_presses_of_nothing_are_drawn():
    figure = plot_presses(np.zeros((1, 6)), "A", SIX)
    assert panels(figure)[0].images[0].get_clim()[0] == 0
    figure = plot_presses(np.full((1, 6), np.nan), "A", SIX)
    figure.canvas.draw()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((0, 6)), "", SIX), r"'readings' must be presses with shape .* \(got \(0, 6\)\)"),
        ((np.zeros(6), "A", SIX), r"'readings' must be presses with shape .* \(got \(6,\)\)"),
        ((np.zeros((1, 5)), "A", SIX), r"one number for each of 6 taxels \(got 5\)"),
        ((np.zeros((1, 6)), "A"), r"one number for each of 1024 taxels \(got 6\)"),
        ((np.zeros((2, 6)), "A", SIX), r"'titles' must have 2, one per press \(got 1\)"),
    ],
    ids=["none", "flat", "short", "default", "titles"],
)
def test_wrong_presses(arguments, message):
    with pytest.raises(ValueError, match=message):
        plot_presses(*arguments)


def test_wrong_looks():
    with pytest.raises(ValueError, match=r"'columns' must be at least 1 \(got 0\)"):
        plot_presses(np.zeros((1, 6)), "A", SIX, columns=0)
    with pytest.raises(ValueError, match=r"'limits' must be increasing \(got 3 and 2\)"):
        plot_presses(np.zeros((1, 6)), "A", SIX, limits=(3, 2))
