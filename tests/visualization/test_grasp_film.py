from dataclasses import asdict

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.sim import paper8
from torch_geometric_tactile.sim._grasp import PHASES
from torch_geometric_tactile.visualization import open_hand
from torch_geometric_tactile.visualization._grasp_film import plot_grasp_film, plot_grasp_forces
from torch_geometric_tactile.visualization._style import colormap

LAYOUT, HAND = allegro_uskin(), HandKinematics.allegro()
TUBE = paper8()[0]
NUM_FRAMES = 60
HEIGHT = 0.12


def trial(item=TUBE, meta=None, drop=(), num_frames=NUM_FRAMES, **kwargs):
    """Six phases of ten frames; taxel 7 is pressed with 2 N from the fourth on."""
    force = np.zeros((num_frames, 384, 3))
    force[30:, 7, 2] = 2.0
    pose = np.tile([0.0, 0.0, HEIGHT, 1.0, 0.0, 0.0, 0.0], (num_frames, 1))
    privileged = {
        "force": force,
        "object_pose": pose,
        "palm_pose": pose + np.array([0, 0, 0.1, 0, 0, 0, 0]),
        "phase": np.repeat(np.arange(6), 10)[:num_frames],
    }
    meta = (
        {"object_parameters": asdict(item), "phase_names": list(PHASES)} if meta is None else meta
    )
    return Recording(
        **{
            "time": np.arange(num_frames) / 10,
            "tactile": np.zeros((num_frames, 384, 3)),
            "joint": np.tile(open_hand(HAND).numpy(), (num_frames, 1)),
            "label": "$5 tube",
            "meta": meta,
            "privileged": {name: privileged[name] for name in privileged.keys() - set(drop)},
        }
        | kwargs
    )


def panels(figure):
    return [ax for ax in figure.axes if ax.get_title()]


def polygons(ax):
    (drawn,) = ax.collections
    return [path.vertices for path in drawn.get_paths()], drawn.get_facecolors()


def test_film_has_a_picture_of_every_phase():
    figure = plot_grasp_film(trial(), LAYOUT, HAND, frames=6)
    titles = [ax.get_title() for ax in panels(figure)]
    assert [title.split(", ")[1].split(":")[0] for title in titles] == list(PHASES)
    assert titles[0] == "0.4 s, hover: 0 N on the skin"
    assert titles[-1].endswith(" s, hold: 2 N on the skin")
    assert figure.get_suptitle() == r"Simulated grasp of \$5 tube"
    assert figure.axes[-1].get_xlabel().startswith("normal force on a taxel (N)")


def test_film_gives_a_short_phase_its_picture():
    recording = trial()
    recording.privileged["phase"] = np.repeat([0, 1, 2, 3, 4, 5], [20, 20, 2, 2, 2, 14])
    figure = plot_grasp_film(recording, LAYOUT, HAND, frames=6)
    assert [ax.get_title().split(", ")[1].split(":")[0] for ax in panels(figure)] == list(PHASES)


@pytest.mark.parametrize(("frames", "rows"), [(1, 1), (3, 1), (8, 2), (9, 3)])
def test_film_has_as_many_pictures_as_asked(frames, rows):
    figure = plot_grasp_film(trial(), LAYOUT, HAND, frames=frames)
    assert len(panels(figure)) == frames
    assert len({ax.get_subplotspec().rowspan.start for ax in panels(figure)}) == rows


# Faces: 54 of each box, 288 of each ellipsoid or tip, 240 of a cylinder, and 384 taxels.
@pytest.mark.parametrize(
    ("name", "faces"), [("sponge", 54), ("plastic_tube", 240), ("mango_replica", 288)]
)
def test_film_draws_object_stand_bones_and_taxels(name, faces):
    (item,) = (item for item in paper8() if item.name == name)
    figure = plot_grasp_film(trial(item), LAYOUT, HAND, frames=1)
    drawn, colors = polygons(figure.axes[0])
    assert len(drawn) == len(colors) == faces + 54 + 17 * 54 + 4 * 288 + 384


def test_film_shows_the_object_where_it_is():
    # Seen from the side, without height: x to the right, z up. Only the object is orange.
    figure = plot_grasp_film(
        trial(paper8()[1]), LAYOUT, HAND, frames=1, azimuth=-90.0, elevation=0.0
    )
    drawn, colors = polygons(figure.axes[0])
    orange = np.concatenate([p for p, c in zip(drawn, colors, strict=True) if c[0] > 1.4 * c[2]])
    assert orange.min(axis=0) == pytest.approx([-0.035, HEIGHT - 0.030])
    assert orange.max(axis=0) == pytest.approx([0.035, HEIGHT + 0.030])


def test_film_paints_far_faces_first():
    # From above, the stand (grey, as much red as green) is behind all of the object on it.
    figure = plot_grasp_film(trial(), LAYOUT, HAND, frames=1, azimuth=0.0, elevation=90.0)
    _, colors = polygons(figure.axes[0])
    stand = np.flatnonzero(np.isclose(colors[:, 0], colors[:, 1]))
    orange = np.flatnonzero(colors[:, 0] > 1.4 * colors[:, 2])
    assert len(stand) == 54
    assert stand.max() < orange.min()


def test_film_shows_a_pressed_taxel_last_large_and_in_the_colour_of_its_force():
    figure = plot_grasp_film(trial(), LAYOUT, HAND, frames=6)
    end = colormap("sequential")(1.0)  # of 1 N and more
    for ax, is_pressed in zip(panels(figure), [False] * 3 + [True] * 3, strict=True):
        drawn, colors = polygons(ax)
        assert np.isclose(colors, end).all(axis=1).sum() == is_pressed
        assert np.allclose(colors[-1], end) == is_pressed
        if is_pressed:
            plain = [p for p, c in zip(drawn, colors, strict=True) if len(p) == len(drawn[-1])]
            sizes = sorted(float(np.ptp(polygon, axis=0).max()) for polygon in plain)
            assert sizes[-1] == pytest.approx(float(np.ptp(drawn[-1], axis=0).max()))


def test_film_follows_hand_and_object():
    figure = plot_grasp_film(trial(), LAYOUT, HAND, frames=2)
    for ax in panels(figure):
        drawn, _ = polygons(ax)
        low, high = ax.get_xlim()
        assert high - low < 0.36
        taxels = np.concatenate([polygon for polygon in drawn if len(polygon) > 5])
        assert low < taxels[:, 0].min() < taxels[:, 0].max() < high


def test_forces_have_a_hand_for_each_phase():
    figure = plot_grasp_forces(trial(), LAYOUT, HAND)
    hands = panels(figure)
    assert [ax.get_title() for ax in hands] == [
        *(f"{name}: 0.0 N" for name in PHASES[:3]),
        *(f"{name}: 2.0 N" for name in PHASES[3:]),
    ]
    (bar,) = (ax for ax in figure.axes if not ax.get_title())  # one scale for all
    assert bar.get_ylim() == (0.0, 2.0)
    assert bar.get_ylabel() == "normal force on a taxel (N)"
    assert figure.get_suptitle() == (
        r"Simulated grasp of \$5 tube: normal force on the skin by phase"
    )


def test_forces_without_contact_and_names_of_phases():
    recording = trial(meta={}, num_frames=25)
    figure = plot_grasp_forces(recording, LAYOUT, HAND)
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert titles == ["phase 0: 0.0 N", "phase 1: 0.0 N", "phase 2: 0.0 N"]


@pytest.mark.parametrize("plot", [plot_grasp_film, plot_grasp_forces])
def test_recordings_that_are_no_simulated_trial(plot):
    for name in ("force", "object_pose", "palm_pose", "phase"):
        with pytest.raises(ValueError, match=f"a simulated trial with the privileged '{name}'"):
            plot(trial(drop=[name]), LAYOUT, HAND)
    with pytest.raises(ValueError, match=r"must have frames and joint angles \(got none\)"):
        plot(trial(joint=None), LAYOUT, HAND)
    with pytest.raises(ValueError, match=r"must have frames and joint angles \(got none\)"):
        plot(trial(num_frames=0, joint=np.zeros((0, 16))), LAYOUT, HAND)


def test_film_of_no_picture():
    with pytest.raises(ValueError, match=r"'frames' must be at least 1 \(got 0\)"):
        plot_grasp_film(trial(), LAYOUT, HAND, frames=0)


def test_caller_keeps_the_recording():
    recording = trial()
    before = {name: values.copy() for name, values in recording.privileged.items()}
    plot_grasp_film(recording, LAYOUT, HAND, frames=1)
    assert all(np.array_equal(recording.privileged[name], before[name]) for name in before)
