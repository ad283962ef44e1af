import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.visualization import plot_bigs_grasps

META = {
    "object": "ball",
    "pickup_time": 0.2,
    "phase_names": ["closing", "hold", "lift", "shake"],
    "finger_names": ["left", "middle", "right"],
}


def recording(slip_time=None, **changes):
    frames, rng = 40, np.random.default_rng(0)
    values = {
        "time": (np.arange(frames) + 1) / 100,
        "tactile": rng.normal(3000, 10, (frames, 19, 3)),
        "label": "success" if slip_time is None else "failure",
        "meta": {**META, "slip_time": slip_time},
        "privileged": {
            "normal_force": rng.random((frames, 3)),
            "shear_force": rng.random((frames, 3)),
            "phase": np.repeat([0, 1, 2, 3], frames // 4),
        },
        "extra": {"pac": rng.integers(2000, 2100, (frames, 3, 22))},
    }
    return Recording(**{**values, **changes})


def test_each_grasp_has_a_column_and_slip_a_line():
    figure = plot_bigs_grasps([recording(), recording(slip_time=0.3)])
    axes = [ax for ax in figure.axes if ax.get_label() != "<colorbar>"]
    assert len(axes) == 12
    red = [[line for line in ax.lines if line.get_color() == "#b00020"] for ax in axes]
    assert [len(lines) for lines in red] == [0, 1] * 6
    assert axes[0].get_title() == "ball, success"
    assert {text.get_text() for text in axes[0].texts} == set(META["phase_names"])


def test_no_grasps_are_refused():
    with pytest.raises(ValueError, match=r"'recordings' must hold at least one grasp \(got none\)"):
        plot_bigs_grasps([])


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"privileged": {}}, "normal_force"), ({"extra": {}}, "pac"), ({"meta": {}}, "pickup_time")],
)
def test_other_recordings_are_refused(changes, name):
    with pytest.raises(ValueError, match=f"must be simulated grasps with frames and '{name}'"):
        plot_bigs_grasps([recording(**changes)])
