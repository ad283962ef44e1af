import math

import numpy as np
import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.sim._pressure_field import CELL, field_sampling


def readings(layout, sensel, lengths, parts, pressure):
    """What pixels take up of a pressure that is a function of x and y in metres."""
    sampling = field_sampling(layout, sensel, lengths, parts)
    x, y, cells = sampling.cells_in_box(sampling.low, sampling.high)
    field = np.broadcast_to(pressure(x[None, :], y[:, None]), (len(y), len(x)))
    return sampling.at_pixels(field.astype(float), cells)


def line(places):
    """A layout along x, with two far pixels that make it 40 mm wide and high."""
    pos = torch.tensor([[x, 0.02] for x in places] + [[0.0, 0.0], [0.04, 0.04]])
    return TaxelLayout("line", pos)


def test_even_pressure_is_read_as_it_is():
    layout = grid(5, 5, pitch=0.01)
    out = readings(layout, 0.0007, (0.001, 0.003), (0.7, 0.3), lambda x, y: np.array(50.0))
    assert out.reshape(5, 5)[2, 2] == pytest.approx(50.0, rel=1e-6)
    assert out.reshape(5, 5)[0, 2] == pytest.approx(25.0, rel=1e-6)  # half of it is beside


def test_blurred_edge_is_that_of_the_formula():
    places = 0.02 + np.array([-0.003, -0.001, 0.0, 0.0015, 0.004])
    layout = line(places.tolist())
    out = readings(layout, 1e-5, (0.001, 0.003), (0.7, 0.3), lambda x, y: 100.0 * (x > 0.02))
    for place, value in zip(places - 0.02, out, strict=False):
        core, skirt = (math.erf(place / length / math.sqrt(2)) for length in (0.001, 0.003))
        assert value == pytest.approx(50 + 35 * core + 15 * skirt, abs=1e-3)


def test_pixel_takes_its_mean_over_a_square():
    half = 0.0005  # of its side, two cells
    layout = line([0.02 - half, 0.02 - half / 2, 0.02, 0.02 + half / 2, 0.02 + half])
    out = readings(layout, 2 * half, (0.0,), (1.0,), lambda x, y: 1.0 * (x > 0.02))
    assert out[:5] == pytest.approx([0, 0.25, 0.5, 0.75, 1], abs=1e-5)


def test_force_is_kept():
    layout = grid(41, 41, pitch=0.001)
    sampled = readings(
        layout, 0.001, (0.001, 0.003), (0.7, 0.3), lambda x, y: np.hypot(x - 0.02, y - 0.02) < 0.005
    )
    cells = (np.arange(160) + 0.5) * CELL - 0.02
    area = (np.hypot(cells[None], cells[:, None]) < 0.005).sum() * CELL**2
    assert sampled.sum() * 0.001**2 == pytest.approx(area, rel=1e-4)


def test_only_the_cells_of_a_box_are_evaluated():
    layout = grid(5, 5, pitch=0.01)
    sampling = field_sampling(layout, 0.0007, (0.001,), (1.0,))
    x, y, cells = sampling.cells_in_box(np.array([0.0101, -0.5]), np.array([0.0109, 0.0006]))
    assert x == pytest.approx((0.010125, 0.010375, 0.010625, 0.010875))
    assert y == pytest.approx((0.000125, 0.000375, 0.000625))
    whole = np.zeros((160, 160))
    whole[:3, 40:44] = 1.0
    everything = (slice(0, 160), slice(0, 160))
    assert sampling.at_pixels(np.ones((3, 4)), cells) == pytest.approx(
        sampling.at_pixels(whole, everything)
    )
