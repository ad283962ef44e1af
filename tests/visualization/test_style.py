import threading

import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

import matplotlib as mpl
from matplotlib.colors import to_rgb

from torch_geometric_tactile.sensors import allegro_uskin, grid
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_curves,
    plot_grasps,
    plot_hand,
    plot_hand_panels,
    plot_label_confusions,
    plot_layout,
    plot_presses,
    plot_protocols,
    plot_roc,
    theme,
)
from torch_geometric_tactile.visualization._style import (
    MAX_WIDTH,
    colormap,
    current_theme,
    new_figure,
    style_axes,
    wrap_text,
)

LAYOUT, HAND = grid(2, 3, pitch=0.002), allegro_uskin()
LONG = "A long title that says what was held out, the seed and the readings, " * 3

PLOTS = {
    "confusion": lambda: plot_confusion([[3, 1], [0, 4]], ["stable", "slip"], LONG),
    "many": lambda: plot_confusion([[1] * 26] * 26, [f"class {i}" for i in range(26)], LONG),
    "labels": lambda: plot_label_confusions([[[3, 1], [0, 4]]] * 6, list("abcdef"), LONG),
    "roc": lambda: plot_roc({f"model {i}": ([0, 1], [0, 1], 0.5) for i in range(9)}, LONG),
    "protocols": lambda: plot_protocols(
        {
            f"a model of name {i}, common mode, middle + thumb": {
                f"leave objects out {j}": {"raw": (0.9, 0.05)} for j in range(4)
            }
            for i in range(4)
        }
    ),
    "curves": lambda: plot_curves({"a": [(1, 2.0, 0.1)]}, "k", "accuracy in %", LONG),
    "grasps": lambda: plot_grasps(LAYOUT, {LONG: torch.rand(6, 3)}, ["index", "middle", "thumb"]),
    "hand": lambda: plot_hand(HAND, value=torch.rand(384), title="readings"),
    "panels": lambda: plot_hand_panels(HAND, {n: torch.rand(384) for n in "abcdef"}, title=LONG),
    "presses": lambda: plot_presses(torch.rand(14, 6).numpy(), "A" * 14, LAYOUT, title=LONG),
}


def brightness(color):
    return sum(to_rgb(color)) / 3


@pytest.mark.parametrize("name", PLOTS)
def test_figures_fit_a_column_and_hold_their_titles(name):
    figure = PLOTS[name]()
    assert figure.get_figwidth() <= MAX_WIDTH + 0.1
    figure.canvas.draw()
    texts = [figure._suptitle, *(ax.title for ax in figure.axes)]
    for text in (text for text in texts if text is not None and text.get_text()):
        box = text.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1


@pytest.mark.parametrize("name", PLOTS)
def test_dark_figures_have_light_texts_on_a_dark_page(name):
    with theme("dark"):
        figure = PLOTS[name]()
    assert brightness(figure.get_facecolor()) < 0.15
    for ax in figure.axes:
        texts = [ax.title, ax.xaxis.label, *ax.get_xticklabels(), *ax.get_yticklabels()]
        assert all(brightness(text.get_color()) > 0.6 for text in texts if text.get_text())
        inside = [text for text in ax.texts if not ax.images and not text.get_bbox_patch()]
        assert all(brightness(text.get_color()) > 0.6 for text in inside)
    for legend in figure.legends:
        assert all(brightness(text.get_color()) > 0.6 for text in legend.get_texts())


def test_theme_ends_with_its_block_even_when_it_fails():
    assert brightness(current_theme().ground) == 1
    with theme("dark"):
        assert brightness(current_theme().ground) < 0.15
        with pytest.raises(RuntimeError, match="broken off"), theme("light"):
            raise RuntimeError(f"broken off {brightness(current_theme().ground)}")
        assert brightness(current_theme().ground) < 0.15
    assert brightness(current_theme().ground) == 1


def test_theme_of_one_thread_is_not_that_of_another():
    seen = []
    with theme("dark"):
        thread = threading.Thread(target=lambda: seen.append(brightness(current_theme().ground)))
        thread.start()
        thread.join()
    assert seen == [1]


def test_unknown_theme_is_refused():
    message = r"'name' must be 'light' or 'dark' \(got 'sepia'\)"
    with pytest.raises(ValueError, match=message), theme("sepia"):
        pass


def test_defaults_of_matplotlib_stay():
    before = dict(mpl.rcParams)
    with theme("dark"):
        plot_layout(LAYOUT, torch.rand(6))
    assert dict(mpl.rcParams) == before


def test_series_are_told_apart_in_both_themes():
    for name in ("light", "dark"):
        with theme(name):
            look = current_theme()
            assert len(set(look.palette)) == 7
            # Contrast of at least 0.15 with the page, in mean of the channels.
            for color in look.palette:
                assert abs(brightness(color) - brightness(look.ground)) > 0.15


@pytest.mark.parametrize("name", ["light", "dark"])
def test_middle_of_signed_values_is_near_the_page(name):
    with theme(name):
        middle, ground = brightness(colormap("diverging")(0.5)[:3]), current_theme().ground
        assert abs(middle - brightness(ground)) < 0.12
        ends = [brightness(colormap("diverging")(end)[:3]) for end in (0.0, 1.0)]
        assert all(abs(end - middle) > 0.4 for end in ends)


def test_own_axes_keep_what_they_show():
    ax = new_figure(2, 2).add_subplot()
    ax.plot([0, 1], [1, 3])
    style_axes(ax)
    assert ax.lines[0].get_ydata().tolist() == [1, 3]


def test_wrapped_texts_hold_no_formula():
    assert wrap_text("a $5 mug of tea", 8) == "a \\$5 mug\nof tea"
