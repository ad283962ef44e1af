import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from torch_geometric_tactile.sim import LiftObject, draw_lift_object


def levels(item):
    """Mass and friction within their ranges, from 0 to 1."""
    return np.array([math.log(item.mass / 0.05) / math.log(8), (item.friction - 0.3) / 0.7])


def test_training_leaves_out_the_corners_and_two_widths():
    items = [draw_lift_object(seed) for seed in range(500)]
    level = np.array([levels(item) for item in items])
    assert level.min() >= 0
    assert level.max() <= 1
    outer = np.abs(level - 0.5) > 0.2
    assert not outer.all(axis=1).any()
    assert {0, 1} <= set(outer.sum(axis=1).tolist())  # light or slippery alone is in training
    assert {item.width for item in items} == {0.030, 0.040, 0.060}


def test_held_out_objects_are_of_the_corners_and_of_two_other_widths():
    items = [draw_lift_object(seed, held_out=True) for seed in range(200)]
    level = np.array([levels(item) for item in items])
    assert (np.abs(level - 0.5) > 0.2).all()
    corners = set(map(tuple, (level > 0.5).tolist()))
    assert len(corners) == 4
    assert {item.width for item in items} == {0.035, 0.050}


def test_centre_of_mass_is_up_to_12_mm_beside_the_middle():
    offset = np.array([draw_lift_object(seed).offset for seed in range(500)])
    assert 0.0115 < offset.max() <= 0.012
    assert -0.0115 > offset.min() >= -0.012


def test_narrow_object_differs_in_breadth_and_place_only():
    wide, narrow = draw_lift_object(3), draw_lift_object(3, narrow=True)
    assert narrow.breadth == 0.010
    moved = replace(wide, breadth=0.010, place=narrow.place, offset=narrow.place + wide.offset)
    assert astuple(narrow) == pytest.approx(astuple(moved))


def test_seed_determines_the_object():
    assert draw_lift_object(1) == draw_lift_object(1) != draw_lift_object(2)
    with pytest.raises(ValueError, match=r"'seed' must not be negative \(got -1\)"):
        draw_lift_object(-1)


@pytest.mark.parametrize("key", ["mass", "friction", "width", "breadth"])
@pytest.mark.parametrize("value", [0, -1.0, float("inf"), float("nan")])
def test_sizes_must_be_positive(key, value):
    with pytest.raises(ValueError, match=f"'{key}' must be a positive number"):
        LiftObject(**{"mass": 0.1, "friction": 0.5} | {key: value})


@pytest.mark.parametrize("key", ["offset", "place"])
def test_distances_must_be_finite(key):
    with pytest.raises(ValueError, match=f"'{key}' must be a finite distance in metres"):
        LiftObject(0.1, 0.5, **{key: float("nan")})


def test_edges_of_narrow_objects_are_away_from_the_columns():
    place = np.array([draw_lift_object(seed, narrow=True).place for seed in range(200)])
    assert set(np.round(place / 0.005).tolist()) == {-1, 0, 1}
    edges = place[:, None] + np.array([-0.005, 0.005])
    columns = np.array([-0.0075, -0.0025, 0.0025, 0.0075])
    assert np.abs(edges[..., None] - columns).min() > 0.0015 - 1e-9
    assert np.ptp(place % 0.005) > 0.001
