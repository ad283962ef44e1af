import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_feature_maps,
    plot_sample_embeddings,
)
from torch_geometric_tactile.visualization._training_history import LearningCurves, plot_training

_CURVES = LearningCurves([2.0, 1.0], [2.1, 1.5], [0.2, 0.6], {"conv1": [0.1, 0.2, 0.3, 0.4, 0.5]})


def test_training_is_drawn_with_the_numbers_given() -> None:
    figure = plot_training({"net": _CURVES, "$other": _CURVES}, "How they learnt")
    losses, accuracy, gradients = figure.axes[:3]
    assert [line.get_ydata().tolist() for line in losses.get_lines()] == [[2.0, 1.0], [2.1, 1.5]]
    assert accuracy.get_lines()[0].get_ydata().tolist() == [20.0, 60.0]
    assert [label.get_text() for label in gradients.get_xticklabels()] == ["conv1"]
    assert gradients.get_yscale() == "log"
    assert len(figure.axes) == 6


def test_training_without_epochs_is_refused() -> None:
    with pytest.raises(ValueError, match="'curves' must hold networks with at least one epoch"):
        plot_training({"net": _CURVES._replace(train_loss=[])}, "none")
    with pytest.raises(ValueError, match="'curves' must hold networks"):
        plot_training({}, "none")


def test_feature_maps_of_a_kind_share_a_scale() -> None:
    maps = np.arange(3 * 4, dtype=float).reshape(3, 2, 2)
    figure = plot_feature_maps(np.eye(4), {"first": maps, "second": -maps}, "Maps", columns=2)
    images = [ax.get_images()[0] for ax in figure.axes]
    assert len(images) == 1 + 3 + 3
    assert np.array_equal(images[2].get_array(), maps[1])
    assert [image.get_clim() for image in images[1:4]] == [(0.0, 11.0)] * 3
    assert [image.get_clim() for image in images[4:]] == [(-11.0, 0.0)] * 3


@pytest.mark.parametrize("maps", [{}, {"flat": np.zeros((2, 2))}], ids=["none", "flat"])
def test_feature_maps_of_another_shape_are_refused(maps: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match=r"'maps' must hold maps of shape"):
        plot_feature_maps(np.eye(2), maps, "none")


def test_samples_have_one_colour_for_a_class_in_all_panels() -> None:
    places = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    panels = {"net": (places, ["A", "B", "A"]), "words": (places, ["B", "B", "A"])}
    figure = plot_sample_embeddings(panels, "t-SNE")
    drawn = [
        {entry.get_label(): entry for entry in ax.collections if len(entry.get_offsets())}
        for ax in figure.axes
    ]
    assert drawn[0]["A"].get_offsets().tolist() == [[0.0, 1.0], [4.0, 5.0]]
    assert drawn[1]["B"].get_offsets().tolist() == [[0.0, 1.0], [2.0, 3.0]]
    for name in ("A", "B"):
        colors = [panel[name].get_facecolor().tolist() for panel in drawn]
        assert colors[0] == colors[1]


def test_samples_without_a_class_each_are_refused() -> None:
    with pytest.raises(ValueError, match=r"'places' of 'net' must have shape \(2, 2\) \(got"):
        plot_sample_embeddings({"net": (np.zeros((3, 2)), ["A", "B"])}, "none")
    with pytest.raises(ValueError, match="'panels' must hold at least one model"):
        plot_sample_embeddings({}, "none")


def test_many_classes_are_drawn_small_with_percentages() -> None:
    counts = np.eye(26, dtype=int) * 30
    counts[0, 1] = 10
    figure = plot_confusion(counts, [chr(65 + i) for i in range(26)], "Letters")
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts[:2] == ["75.0", "25.0"]
    assert texts[2:] == ["100"] * 25
    assert max(figure.get_size_inches()) < 12
