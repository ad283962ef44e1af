import subprocess
import sys

import pytest
import torch

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.sensors import TaxelLayout, as_layout, biotac_sp, grid
from torch_geometric_tactile.sensors._views import facing_axes
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_grasps,
    plot_layout,
    plot_protocols,
    plot_roc,
    save_figure,
)
from torch_geometric_tactile.visualization.layout import layout_plane

LAYOUT = grid(2, 3, pitch=0.002)


def circles(ax):
    return next(c for c in ax.collections if type(c).__name__ == "EllipseCollection")


def test_plane_of_a_grid_is_its_own_in_millimetres():
    expected = torch.tensor([[0, 0], [2, 0], [4, 0], [0, 2], [2, 2], [4, 2]]).float()
    torch.testing.assert_close(layout_plane(LAYOUT), expected)


def test_plane_of_biotac_sp_is_seen_from_the_pad():
    plane, pos = layout_plane(biotac_sp()), biotac_sp().pos * 1e3
    torch.testing.assert_close(plane[:, 0], pos[:, 0], atol=0.6, rtol=0)
    assert float(torch.corrcoef(torch.stack([plane[:, 1], pos[:, 2]]))[0, 1]) > 0.999


def test_plane_moves_with_the_sensor_and_keeps_distances():
    moved = TaxelLayout("moved", LAYOUT.pos + torch.tensor([0.1, 0.0, -0.2]), LAYOUT.normal)
    shift = layout_plane(moved) - layout_plane(LAYOUT)
    torch.testing.assert_close(shift, shift[:1].expand_as(shift), atol=1e-3, rtol=0)


def test_plane_without_normals_leaves_out_the_least_extent():
    bare = TaxelLayout("bare", LAYOUT.pos[:, [2, 1, 0]])
    torch.testing.assert_close(layout_plane(bare), 1e3 * bare.pos[:, 1:])  # y right, z up
    line = TaxelLayout("line", LAYOUT.pos[:3])
    torch.testing.assert_close(layout_plane(line), 1e3 * line.pos[:, :2])


# An L whose stem is along +y, and whose foot is along +x.
L_POS = torch.tensor([[0.0, 0.004 * i, 0.0] for i in range(6)] + [[0.004, 0, 0], [0.008, 0, 0]])


@pytest.mark.parametrize("has_normals", [True, False])
def test_plane_is_neither_mirrored_nor_turned(has_normals):
    normal = torch.tensor([[0.0, 0.0, 1.0]]).expand(8, 3) if has_normals else None
    layout = TaxelLayout("L", L_POS, normal)
    torch.testing.assert_close(layout_plane(layout), 1e3 * L_POS[:, :2])
    ax = plot_layout(layout).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (mm)", "y (mm)")


@pytest.mark.parametrize(
    ("normal", "right", "up"),
    [
        ([0, 0, 1], "x", "y"), ([0, 0, -1], "y", "x"), ([1, 0, 0], "y", "z"),
        ([-1, 0, 0], "z", "y"), ([0, 1, 0], "z", "x"), ([0, -1, 0], "x", "z"),
        ([0.3, -0.2, 0.9], "x", "y"), ([0.6, -0.7, 0.2], "x", "z"),
    ],
)  # fmt: skip
def test_pads_are_seen_from_the_side_that_is_touched(normal, right, up):
    toward = torch.tensor([normal], dtype=torch.double)
    toward = toward / toward.norm()
    pos = torch.randn(8, 3, generator=torch.Generator().manual_seed(0))
    axes = facing_axes(pos, toward.expand(8, 3))
    torch.testing.assert_close(axes[2:], toward)
    torch.testing.assert_close(axes @ axes.T, torch.eye(3).double())
    assert float(torch.linalg.det(axes)) == pytest.approx(1)
    assert ["xyz"[int(axis.argmax())] for axis in axes[:2]] == [right, up]
    ax = plot_layout(TaxelLayout("pad", pos, toward.float().expand(8, 3))).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == (f"{right} (mm)", f"{up} (mm)")


def test_joined_pads_are_side_by_side():
    single = TaxelLayout("L", L_POS)
    hand = TaxelLayout.join([single, LAYOUT, LAYOUT], ["stem", "pad", "tip"])
    plane, own = layout_plane(hand), layout_plane(single)
    torch.testing.assert_close(plane[:8] - plane[0], own - own[0])
    ends = [(part[:, 0].min(), part[:, 0].max()) for part in plane.split([8, 6, 6])]
    assert ends[0][1] < ends[1][0] <= ends[1][1] < ends[2][0]
    ax = plot_layout(hand).axes[0]
    assert [text.get_text() for text in ax.texts] == ["stem", "pad", "tip"]
    assert ax.get_ylim()[1] > ax.texts[0].get_position()[1]


def test_numbers_are_those_of_the_readings():
    from matplotlib.textpath import TextPath

    (drawn,) = (
        c for c in plot_layout(LAYOUT).axes[0].collections if type(c).__name__ == "PathCollection"
    )
    for i, path in enumerate(drawn.get_paths()):
        assert len(path.vertices) == len(TextPath((0, 0), str(i), size=1.0).vertices), i


def test_layout_colours_follow_values_and_edges_are_drawn_once():
    values = torch.tensor([0.0, 1.0, 2.0, 0.0, 1.0, float("nan")])
    edges = torch.tensor([[0, 1, 1], [1, 0, 2]])
    (ax, *_) = plot_layout(LAYOUT, values, edges).axes
    colors = circles(ax).get_facecolors()
    assert len(colors) == 6
    assert (colors[0] == colors[3]).all()
    assert not (colors[0] == colors[2]).all()
    assert colors[5].tolist() == [1, 1, 1, 1]  # a missing reading is white
    lines = next(c for c in ax.collections if type(c).__name__ == "LineCollection")
    assert len(lines.get_segments()) == 2


def test_layout_of_a_single_taxel():
    assert len(circles(plot_layout(grid(1, 1, pitch=0.002)).axes[0]).get_offsets()) == 1


def test_grasps_share_one_symmetric_scale():
    readings = {"stable": torch.full((6, 2), -1.0), "slip": torch.full((6, 2), 3.0)}
    figure = plot_grasps(LAYOUT, readings, ["index", "thumb"])
    panels = [ax for ax in figure.axes if ax.collections and ax.get_title()]
    assert [ax.get_title() for ax in panels] == ["index", "thumb"] * 2
    bar = next(ax for ax in figure.axes if "standard deviations" in ax.get_ylabel())
    assert bar.get_ylim() == pytest.approx((-3, 3))
    headings = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert headings == ["stable", "slip"]


def test_confusion_shows_counts_and_rows_in_percent():
    figure = plot_confusion([[3, 1], [0, 0]], ["stable", "slip"], "title")
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["3\n75.0 %", "1\n25.0 %", "0\n-", "0\n-"]


def test_roc_shows_its_curves_and_areas():
    figure = plot_roc({"SVM": ([0, 0.5, 1], [0, 1, 1], 0.75)}, "title")
    curve, chance = figure.axes[0].get_lines()
    assert curve.get_xydata().tolist() == [[0, 0], [0.5, 1], [1, 1]]
    assert chance.get_xydata().tolist() == [[0, 0], [1, 1]]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["SVM (AUC 0.750)", "chance (AUC 0.500)"]


def test_protocols_show_means_and_deviations():
    table = {"SVM": {"folds": {"raw": (0.9, 0.05)}, "test": {"raw": (0.7, float("nan"))}}}
    figure = plot_protocols(table, chance=0.5)
    assert [ax.get_title() for ax in figure.axes] == ["folds", "test"]
    assert [tick.get_text() for tick in figure.axes[0].get_yticklabels()] == ["SVM, raw"]
    ends = []
    for ax, mean in zip(figure.axes, (0.9, 0.7), strict=True):
        (points,) = ax.containers
        assert points.lines[0].get_xydata().tolist() == [[mean, 0]]
        (bars,) = points.lines[2]
        ends += [segment[:, 0].tolist() for segment in bars.get_segments()]
        assert [text.get_text() for text in ax.texts] == [f"{100 * mean:.1f}"]
        assert ax.get_xlim() == (0.4, 1.0)
    assert ends[0] == pytest.approx([0.85, 0.95])
    assert ends[1] == pytest.approx([0.7, 0.7])


def test_protocols_have_a_line_for_each_model_and_its_readings():
    table = {
        "GCN": {"folds": {"raw": (0.3, 0.0), "session": (0.8, 0.0)}},
        "SVM": {"folds": {"session": (0.6, 0.0)}, "test": {"raw": (0.7, 0.0)}},
    }
    folds, test = plot_protocols(table).axes
    lines = ["GCN, raw", "GCN, session", "SVM, session", "SVM, raw"]
    assert [tick.get_text() for tick in folds.get_yticklabels()] == lines
    points = [container.lines[0].get_xydata()[0].tolist() for container in folds.containers]
    assert points == [[0.3, 0], [0.8, 1], [0.6, 2]]
    colors = [container.lines[0].get_color() for container in folds.containers]
    assert colors[1] == colors[2] != colors[0]
    assert test.containers[0].lines[0].get_xydata().tolist() == [[0.7, 3]]
    assert folds.get_xlim()[0] == 0.3  # lower than usual, for a result that is


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"'values' must have shape \(6,\)"):
        plot_layout(LAYOUT, torch.zeros(5))
    with pytest.raises(ValueError, match=r"'edge_index' must have shape \(2, num_edges\)"):
        plot_layout(LAYOUT, edge_index=torch.zeros(3, 1))
    with pytest.raises(ValueError, match="'edge_index' must join taxels 0 to 5"):
        plot_layout(LAYOUT, edge_index=torch.tensor([[0], [6]]))
    with pytest.raises(ValueError, match=r"'limits' must be increasing \(got 1 and 1\)"):
        plot_layout(LAYOUT, limits=(1, 1))
    with pytest.raises(ValueError, match="'readings' must hold at least one grasp"):
        plot_grasps(LAYOUT, {}, ["index"])
    with pytest.raises(ValueError, match="'finger_names' must hold at least one name"):
        plot_grasps(LAYOUT, {"a": torch.zeros(6, 1)}, [])
    with pytest.raises(ValueError, match=r"'readings' must have shape \(6, 1\).*'a'"):
        plot_grasps(LAYOUT, {"a": torch.zeros(6, 2)}, ["index"])
    with pytest.raises(ValueError, match=r"'matrix' must have shape \(2, 2\)"):
        plot_confusion([[1]], ["a", "b"], "")
    with pytest.raises(ValueError, match="'matrix' must hold counts"):
        plot_confusion([[-1]], ["a"], "")
    with pytest.raises(ValueError, match="'curves' must hold at least one model"):
        plot_roc({}, "")
    with pytest.raises(ValueError, match="'curves' must hold rates with the same length"):
        plot_roc({"a": ([0, 1], [0], 0.5)}, "")
    with pytest.raises(ValueError, match="'curves' must hold rates from 0 to 1"):
        plot_roc({"a": ([0, 2], [0, 1], 0.5)}, "")
    with pytest.raises(ValueError, match="'table' must hold at least one result"):
        plot_protocols({})
    with pytest.raises(ValueError, match=r"accuracies from 0 to 1 \(got 90"):
        plot_protocols({"a": {"b": {"c": (90.0, 1.0)}}})


def test_saved_figure_is_whole_or_absent(tmp_path, monkeypatch):
    figure = plot_layout(LAYOUT)
    path = tmp_path / "a.png"
    save_figure(figure, path)
    before = path.read_bytes()
    assert before.startswith(b"\x89PNG")

    def break_off(target, **kwargs):
        target.write_bytes(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(figure, "savefig", break_off)
    with pytest.raises(OSError, match="disk full"):
        save_figure(figure, path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.png"]
    with pytest.raises(ValueError, match=r"'path' must end in '.png'"):
        save_figure(figure, tmp_path / "a.pdf")


def test_pyplot_is_not_imported():
    code = (
        "import sys; from torch_geometric_tactile.sensors import grid; "
        "from torch_geometric_tactile.visualization import plot_layout; "
        "plot_layout(grid(1, 2, 0.002)); sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_missing_extra_is_named_at_the_call(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(ImportError, match=r'pip install "torch-geometric-tactile\[viz\]"'):
        plot_layout(LAYOUT)


@pytest.mark.parametrize("width", [3.9, 5.0])
@pytest.mark.parametrize("name", ["icub_hand", "leap_paxini", "uskin_gripper"])
def test_names_of_pads_are_apart_and_beside_the_taxels(name, width):
    from matplotlib.figure import Figure

    layout = as_layout(name)
    figure = Figure(figsize=(width, 3.0), layout="constrained")
    ax = figure.add_subplot()
    plot_layout(layout, ax=ax)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert [text.get_text() for text in ax.texts] == list(layout.link_names)
    frame = ax.get_window_extent()
    highest = ax.transData.transform(layout_plane(layout).numpy())[:, 1].max()
    for number, box in enumerate(boxes):
        assert not any(box.overlaps(one) for one in boxes[:number])
        assert box.y0 > highest
        assert box.y1 <= frame.y1
        assert frame.x0 - 1 <= box.x0
        assert box.x1 <= frame.x1 + 1
