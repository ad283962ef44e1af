import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from recordings import noisy_recording

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.reports._recording import describe_recording
from torch_geometric_tactile.visualization import plot_recording, save_figure

NAN = float("nan")


def recording(*size, **fields):
    return noisy_recording(*size, rate=10, start=100, **fields)


def panels(figure):
    return [ax for ax in figure.axes if ax.get_ylabel() and ax.get_label() != "<colorbar>"]


def image(ax):
    return ax.get_images()[0].get_array()


def test_plot_has_a_panel_for_each_axis_the_sum_and_the_joints():
    figure = plot_recording(recording(joint=np.zeros((40, 2)), meta={"unit": "newton"}))
    labels = [ax.get_ylabel() for ax in panels(figure)]
    assert labels == [
        "x\ntaxel",
        "y\ntaxel",
        "z\ntaxel",
        "sum of\n|reading - rest|\n(N)",
        "joint angle\n(rad)",
    ]
    assert panels(figure)[-1].get_xlabel() == "time since the first frame (s)"
    names = [text.get_text() for text in panels(figure)[-1].get_legend().get_texts()]
    assert names == ["joint 0", "joint 1"]


def test_plot_has_a_panel_of_steps_for_the_actions():
    span = [(100.5, 101.0, "slip")]
    for joint in (None, np.zeros((40, 2))):
        rec = recording(joint=joint, action=np.arange(80.0).reshape(40, 2), annotations=span)
        panel = panels(plot_recording(rec))[-1]  # the annotations have no label
        assert panel.get_ylabel() == "action"
        assert [line.get_drawstyle() for line in panel.lines[:2]] == ["steps-post"] * 2
        assert panel.lines[1].get_ydata().tolist() == [*range(1, 80, 2)]
        names = [text.get_text() for text in panel.get_legend().get_texts()]
        assert names == ["action 0", "action 1"]


def test_plot_subtracts_the_rest_of_each_taxel():
    tactile = np.zeros((40, 2, 1))
    tactile[:, 0] = 33000
    tactile[:, 1] = 36000
    tactile[20:, 1] += 5
    figure = plot_recording(Recording(np.arange(40) / 10, tactile))
    first, total = panels(figure)
    assert image(first).shape == (2, 40)
    assert image(first)[0].tolist() == [0] * 40
    assert image(first)[1].tolist() == [0] * 20 + [5] * 20
    assert total.lines[0].get_ydata().tolist() == [0] * 20 + [5] * 20
    assert total.lines[0].get_xdata()[0] == 0


def test_plot_rest_of_a_taxel_that_is_missing_at_first_is_its_later_median():
    tactile = np.full((40, 1, 1), 7.0)
    tactile[:10] = NAN
    (first, *_) = panels(plot_recording(Recording(np.arange(40) / 10, tactile)))
    assert image(first).mask[0].tolist() == [True] * 10 + [False] * 30
    assert image(first)[0, 10:].tolist() == [0] * 30


def test_plot_dead_taxels_are_grey_and_named_in_the_title():
    rec = recording()
    tactile = rec.tactile.copy()
    tactile[:, 2] = NAN
    figure = plot_recording(Recording(rec.time, tactile, label="$5 mug"))
    assert image(panels(figure)[0]).mask[2].all()
    assert "1 dead taxel (grey)" in figure.get_suptitle()
    assert r"label \$5 mug" in figure.get_suptitle()


def test_plot_of_many_frames_keeps_the_farthest_reading():
    tactile = np.zeros((20_001, 1, 1))
    tactile[12_345] = -9
    (first, *_) = panels(plot_recording(Recording(np.arange(20_001) / 100, tactile)))
    assert image(first).shape[1] <= 1500
    assert image(first).min() == -9


def texts(figure):
    return [text.get_text() for ax in figure.axes for text in ax.texts]


@pytest.mark.parametrize(
    ("phase", "meta", "names"),
    [
        (np.repeat([0, 1], 20), {"phase_names": ["hover", "lift"]}, ["hover", "lift"]),
        (np.repeat([0, 3], 20), {"phase_names": ["hover", "lift"]}, ["hover", "phase 3"]),
        (np.repeat(["a", "b", "a", "c"], 10), {}, ["a", "b", "a", "c"]),
        (np.zeros(40, dtype=int), {}, ["phase 0"]),
    ],
)
def test_plot_marks_phases(phase, meta, names):
    assert texts(plot_recording(recording(meta=meta, privileged={"phase": phase}))) == names


@pytest.mark.full
@pytest.mark.parametrize(
    "rec",
    [
        recording(1, 1, 1),
        recording(2),
        recording(40, 384, 3, joint=np.zeros((40, 40))),
        recording(3, 2, 5),
        Recording([0.0, 1.0], np.full((2, 3, 3), NAN), joint=np.full((2, 1), NAN)),
    ],
)
def test_plot_of_unusual_sizes_can_be_saved(rec, tmp_path):
    save_figure(plot_recording(rec), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_plot_of_one_frame_shows_the_difference_to_the_median_taxel():
    (first, *_) = panels(plot_recording(Recording([0.0], [[[1.0], [2.0], [5.0]]])))
    assert image(first)[:, 0].tolist() == [-1, 0, 3]


def test_plot_refuses():
    with pytest.raises(ValueError, match=r"at least one frame to be drawn \(got none\)"):
        plot_recording(recording(0))
    with pytest.raises(ValueError, match=r"'rest' must be at least 0 seconds \(got -1\)"):
        plot_recording(recording(), rest=-1)


def test_describe_names_every_fact():
    tactile = np.arange(24, dtype=float).reshape(4, 2, 3)
    tactile[:, 1] = NAN
    tactile[2, 0, 0] = NAN
    rec = Recording(
        [0, 0.01, 0.02, 0.03],
        tactile,
        joint=[[0, -0.5], [0.25, 0], [0, 0], [0, 1]],
        label="cup",
        meta={"unit": "count", "joint_names": ["base", "tip"], "long": "a" * 200},
        privileged={"pose": np.zeros((4, 7))},
        extra={"pac": np.zeros((4, 3, 22))},
    )
    assert describe_recording(rec).splitlines() == [
        "frames       4 in 0.03 s, 100 per second",
        "gaps         none",
        "taxels       2 of 3 channels",
        "readings     0 to 20 counts",
        "joints       2, -0.5 to 1 rad",
        "             base: 0 to 0.25 rad",
        "             tip: -0.5 to 1 rad",
        "missing      5 of 8 readings of a taxel in a frame (62.5 %)",
        "dead taxels  1: 1",
        "constant     none",
        "saturated    none",
        "equal        none",
        "label        cup",
        "metadata     unit = count",
        '             joint_names = ["base", "tip"]',
        f"             long = {'a' * 97}...",
        "privileged   pose (4, 7)",
        "extra        pac (4, 3, 22)",
    ]


def test_describe_no_frame_and_many_dead_taxels():
    lines = describe_recording(Recording([], np.zeros((0, 2, 1)))).splitlines()
    assert lines[0] == "frames       0"
    assert lines[3] == "readings     none"
    lines = describe_recording(Recording([0.0], np.full((1, 15, 1), NAN))).splitlines()
    assert lines[6] == "dead taxels  15: 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 and 3 more"


def test_names_that_are_no_formula_can_be_drawn(tmp_path):
    text = "$$\\frac{ \\$5$ a\0b\x1b\u202e two\nlines $"
    rec = recording(
        num_frames=3,
        label=text,
        joint=np.zeros((3, 1)),
        meta={"joint_names": [text], "phase_names": [text], "object": text, "unit": "count"},
        privileged={"phase": np.zeros(3, int)},
    )
    figure = plot_recording(rec)
    save_figure(figure, tmp_path / "a.png")
    assert all(line.isprintable() for line in figure.get_suptitle().split("\n"))


def test_describe_shows_what_a_terminal_would_obey():
    lines = describe_recording(recording(label="a\x1b[2J\n\u202eb", meta={"k\n": "\x9b"})).split(
        "\n"
    )
    assert r"label        a\x1b[2J\n\u202eb" in lines
    assert r"metadata     k\n = \x9b" in lines
    assert len(lines) == 14


def test_annotations_have_a_lane_for_each_label():
    spans = [(100.5, 101.5, "hold"), (101, 101, "tap"), (102, 103, "hold")]
    figure = plot_recording(recording(joint=np.zeros((40, 2)), annotations=spans))
    ax = figure.axes[5]
    assert [text.get_text() for text in ax.get_yticklabels()] == ["hold", "tap"]
    assert ax.get_xlabel() == "time since the first frame (s)"
    boxes = [c.get_extents().x0 for lane in ax.collections for c in lane.get_paths()]
    np.testing.assert_allclose(boxes, [0.5, 2.0, 1.0])
    assert len(plot_recording(recording(joint=np.zeros((40, 2)))).axes) == len(figure.axes) - 1


def test_many_labels_share_the_last_lane():
    spans = [(100 + i / 10, 101 + i / 10, f"label {i:02d} with a long name") for i in range(11)]
    ax = plot_recording(recording(annotations=spans)).axes[4]
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert (len(names), names[0], names[-1]) == (8, "label 00 with a l...", "4 others")


def test_annotations_are_told_since_the_first_frame():
    spans = [(100.5, 101.5, "hold"), *[(102, 103, "tap")] * 21]
    lines = describe_recording(recording(annotations=spans)).splitlines()
    first = lines.index("annotations  0.50 to 1.50 s  hold")
    assert lines[first + 20] == "             and 2 more"
    assert "annotations" not in describe_recording(recording())


def test_time_without_frames_is_blank():
    time = np.r_[np.arange(20), 400 + np.arange(20)] / 10
    gap = recording(num_frames=40, annotations=[(100.5, 101.0, "hold")])
    gap = replace(gap, time=100 + time)
    axes = plot_recording(gap).axes
    panels = [ax for ax in axes if ax.get_ylabel()][:4]
    for ax in panels:
        (cover,) = [c for c in ax.collections if c.get_zorder() == 2.4]
        box = cover.get_paths()[0].get_extents()
        np.testing.assert_allclose([box.x0, box.x1], [1.9, 40.0])
    whole = plot_recording(recording(num_frames=40)).axes
    assert not [c for ax in whole for c in ax.collections if c.get_zorder() == 2.4]


def test_events_are_in_seconds_since_the_first_frame():
    events = [
        {"time": 7.25, "kind": "mark", "text": ""},
        {"time": 8.0, "kind": "touch", "text": "by hand"},
    ]
    made = Recording([7.0, 9.0], np.zeros((2, 2, 1)), meta={"events": events, "unit": "count"})
    lines = describe_recording(made).splitlines()
    at = lines.index("events       0.25 s  mark")
    assert lines[at + 1 : at + 3] == [
        "             1.00 s  touch  by hand",
        "metadata     unit = count",
    ]


@pytest.mark.parametrize("events", [3, [3], [{"time": 1}], [{"time": "a", "kind": "", "text": ""}]])
def test_other_metadata_named_events_stays_metadata(events):
    made = Recording([0.0, 1.0], np.zeros((2, 2, 1)), meta={"events": events})
    assert f"metadata     events = {json.dumps(events)}" in describe_recording(made)
