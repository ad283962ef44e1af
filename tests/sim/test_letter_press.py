import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, grid, letter_array
from torch_geometric_tactile.sim import LETTERS, LetterPress

PLAIN = LetterPress(
    size=(0.016, 0.016),
    angle=0.0,
    tilt=0.0,
    pressure=(50.0, 50.0),
    repeatability=(0.0, 0.0),
    crosstalk=0.0,
    bits=None,
)
FINE = grid(156, 156, pitch=0.00025)


def press(model, letter="R", count=1, seed=0, layout=None):
    return model.press(letter, count, np.random.default_rng(seed), layout)


def images(presses):
    return presses.readings.reshape(-1, 32, 32)


def test_presses_are_images_and_what_was_drawn():
    presses = press(LetterPress(), count=40)
    assert presses.readings.shape == (40, 1024)
    assert presses.readings.dtype == np.float32
    assert np.all((presses.size >= 0.014) & (presses.size <= 0.020))
    assert np.all((presses.pressure >= 30) & (presses.pressure <= 75))
    assert np.abs(np.degrees(presses.angle)).max() <= 20
    assert np.degrees(presses.angle).min() < -10 < 10 < np.degrees(presses.angle).max()
    assert presses.place.shape == presses.slope.shape == (40, 2)
    assert np.ptp(presses.place, axis=0).min() > 0.008


def test_no_presses():
    presses = press(LetterPress(), count=0)
    assert presses.readings.shape == (0, 1024)
    assert presses.place.shape == (0, 2)


def test_force_is_pressure_times_area():
    # An I is a bar with round ends: 13.5 mm between their middles, 2.5 mm wide.
    area = 0.0135 * 0.0025 + math.pi * 0.00125**2
    sharp = replace(PLAIN, blur_length=0.0, spread=0.0, sensel=0.00025)
    (readings,) = press(sharp, "I", layout=FINE).readings
    assert readings.sum() * 0.00025**2 == pytest.approx(50 * area, rel=2e-3)
    blurred = press(replace(PLAIN, margin=0.008), "I", count=3)
    assert blurred.readings.sum(axis=1) * 0.00125**2 == pytest.approx(50 * area, rel=0.01)


@pytest.mark.parametrize("letter", "IOWZ")
def test_letter_is_whole_within_the_margin_whatever_its_turn(letter):
    model = replace(PLAIN, angle=math.pi, blur_length=0.0, spread=0.0, sensel=0.00025)
    whole = press(replace(model, margin=0.005), letter, layout=FINE).readings.sum()
    presses = press(model, letter, count=30, seed=1, layout=FINE)
    assert presses.readings.sum(axis=1) == pytest.approx(whole, rel=5e-3)
    squares = presses.readings.reshape(30, 156, 156)
    touched = squares.max(axis=0) > 1
    edge = 4  # pixels of a quarter millimetre before 1.25 mm are reached
    assert not touched[:edge].any()
    assert not touched[-edge:].any()
    assert not touched[:, :edge].any()
    assert not touched[:, -edge:].any()


def test_reading_in_the_middle_of_a_bar_by_hand():
    # Far from its ends a bar is a difference of two edges.
    model = replace(PLAIN, size=(0.024, 0.024), sensel=1e-6, spread=0.3)
    presses = press(model, "I", layout=grid(401, 401, pitch=0.0001))
    inside = 0.00125 / math.sqrt(2)
    skirt = math.erf(inside / 0.003)
    expected = 50 * (0.7 * math.erf(inside / 0.001) + 0.3 * skirt)
    assert presses.readings.max() == pytest.approx(expected, rel=5e-3)


def test_wider_spread_is_lower_and_wider():
    narrow, wide = (
        press(replace(PLAIN, blur_length=b, spread=0.0)).readings for b in (0.0005, 0.0015)
    )
    assert narrow.max() > 1.2 * wide.max()
    assert (wide > 1).sum() > 1.1 * (narrow > 1).sum()


def test_turn_is_from_x_to_y():
    # Clockwise in an image: an I that turns a little has its top further right.
    model = replace(PLAIN, angle=math.pi)
    presses = press(model, "I", count=30)
    row, column = np.mgrid[:32, :32]
    for image, angle in zip(images(presses), presses.angle, strict=True):
        weight = image / image.sum()
        y, x = row - (row * weight).sum(), column - (column * weight).sum()
        xx, xy, yy = ((weight * a * b).sum() for a, b in ((x, x), (x, y), (y, y)))
        main = 0.5 * math.atan2(2 * xy, xx - yy)  # from x to y
        assert math.cos(2 * (main - angle - math.pi / 2)) > 0.99


def test_first_row_is_the_upper_one():
    (image,) = images(press(PLAIN, "T"))
    rows = np.flatnonzero(image.sum(axis=1) > 20)
    width = (image > 5).sum(axis=1)
    assert width[rows[1] : rows[3]].mean() > 2 * width[rows[-4] : rows[-2]].mean()
    (image,) = images(press(PLAIN, "L"))
    columns = np.flatnonzero(image.max(axis=0) > 5)
    height = (image > 5).sum(axis=0)
    assert height[columns[1]] > 2 * height[columns[-2]]  # its stem is on the left


def test_place_is_the_middle_of_the_letter():
    presses = press(PLAIN, "O", count=5)
    pos = letter_array().pos[:, :2].double().numpy()
    for readings, place in zip(presses.readings, presses.place, strict=True):
        middle = (readings[:, None] * pos).sum(axis=0) / readings.sum()
        assert middle == pytest.approx(place, abs=2e-4)


def test_tilt_changes_pressure_over_the_letter():
    even = press(PLAIN, "I", count=20)
    tilted = press(replace(PLAIN, tilt=0.5, blur_length=0.0005, spread=0.0), "I", count=20)
    sharp = press(replace(PLAIN, blur_length=0.0005, spread=0.0), "I", count=20)
    assert not even.slope.any()
    assert np.linalg.norm(tilted.slope, axis=1).max() <= 0.5 / 0.008
    assert np.linalg.norm(tilted.slope, axis=1).max() > 0.3 / 0.008
    pos = letter_array().pos[:, :2].double().numpy()
    for i in range(20):
        seen = sharp.readings[i] > 20
        ratio = tilted.readings[i][seen] / sharp.readings[i][seen]
        expected = 1 + (pos[seen] - tilted.place[i]) @ tilted.slope[i]
        assert ratio == pytest.approx(expected, abs=0.05)


def test_repeatability_is_of_each_pixel_and_press():
    exact = press(PLAIN, count=1).readings[0]
    model = replace(PLAIN, repeatability=(-0.02, 0.06))
    first, second = press(model).readings[0], press(model, count=2).readings[0]
    seen = exact > 1
    ratio = first[seen] / exact[seen]
    assert -0.02 - 1e-5 <= ratio.min() - 1 < -0.015
    assert 0.055 < ratio.max() - 1 <= 0.06 + 1e-5
    assert not np.array_equal(first, second)  # two presses were drawn before its errors


def test_crosstalk_is_of_rows_and_columns():
    exact, mixed = (
        images(press(replace(PLAIN, crosstalk=part)))[0].astype(float) for part in (0.0, 0.1)
    )
    rows = exact.sum(axis=1, keepdims=True) - exact
    columns = exact.sum(axis=0, keepdims=True) - exact
    assert mixed == pytest.approx(exact + 0.1 * (rows + columns) / 31, abs=1e-4)
    beside = (exact < 1e-3) & (mixed > 0.05)
    assert beside.sum() > 100


def test_layout_without_image_map_has_no_crosstalk():
    full = letter_array()
    plain = TaxelLayout("plain", full.pos)
    assert np.array_equal(
        press(replace(PLAIN, crosstalk=0.5), layout=plain).readings, press(PLAIN).readings
    )


def test_lines_of_a_thinned_layout_are_those_of_its_pixels():
    full = letter_array()
    keep = torch.arange(0, 1024, 3)
    thin = TaxelLayout("thin", full.pos[keep], image_map=full.image_map[keep])
    model = replace(PLAIN, margin=0.003)
    exact, mixed = (
        press(replace(model, crosstalk=part), layout=thin).readings[0].astype(float)
        for part in (0.0, 0.1)
    )
    row, column = thin.image_map.numpy().T
    for i in range(0, len(keep), 17):
        others = [
            exact[(line == line[i]) & (np.arange(len(keep)) != i)].mean() for line in (row, column)
        ]
        assert mixed[i] == pytest.approx(exact[i] + 0.1 * sum(others), abs=1e-4)


def test_other_layout_of_the_same_size_gets_the_same_presses():
    full = letter_array()
    keep = torch.randperm(1024, generator=torch.Generator().manual_seed(0))[:600]
    thin = TaxelLayout("thin", full.pos[keep])
    here, there = press(LetterPress(), count=3), press(LetterPress(), count=3, layout=thin)
    for name in ("size", "angle", "place", "pressure", "slope"):
        assert np.array_equal(getattr(here, name), getattr(there, name)), name
    exact, thinned = press(PLAIN), press(PLAIN, layout=thin)
    assert thinned.readings[0] == pytest.approx(exact.readings[0][keep.numpy()], abs=1e-5)


def test_readings_are_rounded_to_steps():
    model = replace(PLAIN, bits=8)
    exact, rounded = press(PLAIN).readings, press(model).readings
    steps = rounded.astype(float) / (100 / 255)
    assert steps == pytest.approx(np.rint(steps), abs=1e-4)
    assert 0.4 * 100 / 255 < np.abs(rounded - exact).max() <= 0.5 * 100 / 255 + 1e-4
    assert len(np.unique(press(replace(model, bits=2)).readings)) <= 4


def test_readings_end_at_full_scale():
    presses = press(replace(PLAIN, pressure=(400.0, 400.0), bits=8))
    assert presses.readings.max() == pytest.approx(100.0)
    assert (presses.readings == presses.readings.max()).sum() > 20


def test_dead_rows_are_those_of_the_device():
    model = LetterPress(dead_rows=5, margin=0.0)
    presses = images(press(model, "O", count=40))
    alive = presses.max(axis=(0, 2)) > 0
    assert (~alive).sum() == 5
    again = images(press(model, "H", count=40, seed=1))
    assert np.array_equal(again.max(axis=(0, 2)) > 0, alive)
    other = images(press(replace(model, device_seed=1), "O", count=40))
    assert not np.array_equal(other.max(axis=(0, 2)) > 0, alive)
    assert not press(replace(model, dead_rows=32)).readings.any()


def test_letters_are_told_by_their_shape():
    # By the largest correlation with an upright letter of one size, wherever it is.
    def spectra(presses):
        flat = presses - presses.mean(axis=(-2, -1), keepdims=True)
        flat /= np.linalg.norm(flat, axis=(-2, -1), keepdims=True)
        return np.fft.rfft2(flat, s=(64, 64))

    upright = replace(PLAIN, size=(0.017, 0.017))
    templates = spectra(np.concatenate([images(press(upright, letter)) for letter in LETTERS]))
    model = LetterPress(size=(0.016, 0.018), angle=math.radians(10))
    right = 0
    for number, letter in enumerate(LETTERS):
        shown = spectra(images(press(model, letter, count=6)))
        fit = np.fft.irfft2(shown[:, None] * templates.conj()).max(axis=(-2, -1))
        right += (fit.argmax(axis=1) == number).sum()
    assert right >= 0.85 * 6 * 26, right


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size": (0.02, 0.01)}, r"'size' must be two numbers above -1, the smaller first"),
        ({"size": 0.02}, r"'size' must be two numbers above -1, the smaller first \(got 0.02\)"),
        ({"size": (0.002, 0.01)}, r"'size' must be above 'stroke', 0.0025 m \(got 0.002\)"),
        ({"pressure": (30.0, math.nan)}, "'pressure' must be two numbers"),
        ({"pressure": (-0.5, 3.0)}, r"'pressure' must not be negative \(got -0.5\)"),
        ({"repeatability": (-1.5, 0.0)}, "'repeatability' must be two numbers above -1"),
        ({"stroke": 0.0}, r"'stroke' must be positive and finite \(got 0.0\)"),
        ({"sensel": math.inf}, r"'sensel' must be positive and finite \(got inf\)"),
        ({"full_scale": -1.0}, r"'full_scale' must be positive and finite"),
        ({"margin": -0.1}, r"'margin' must be not negative and finite \(got -0.1\)"),
        ({"blur_length": math.nan}, "'blur_length' must be not negative and finite"),
        ({"spread_length": -1.0}, "'spread_length' must be not negative and finite"),
        ({"tilt": 1.0}, r"'tilt' must be at least 0 and below 1 \(got 1.0\)"),
        ({"spread": -0.1}, "'spread' must be at least 0 and below 1"),
        ({"crosstalk": math.nan}, "'crosstalk' must be at least 0 and below 1"),
        ({"angle": 20.0}, r"'angle' must be between 0 and pi, in radians \(got 20.0\)"),
        ({"bits": 0}, r"'bits' must be from 1 to 16, or None \(got 0\)"),
        ({"dead_rows": -1}, r"'dead_rows' must not be negative \(got -1\)"),
        ({"device_seed": -1}, r"'device_seed' must not be negative \(got -1\)"),
    ],
)
def test_wrong_parameters(changes, message):
    with pytest.raises(ValueError, match=message):
        LetterPress(**changes)


@pytest.mark.parametrize(
    ("model", "layout", "message"),
    [
        (LetterPress(), grid(8, 8, pitch=0.00125), "'layout' must have room for letters of 20 mm"),
        (LetterPress(margin=0.01), letter_array(), r"which need 27.7 mm at any angle \(got 18.8 "),
        (LetterPress(), allegro_uskin(), "'layout' must be flat, with one z for all taxels"),
        (LetterPress(dead_rows=33), letter_array(), r"the image map of 'layout', 32 \(got 33\)"),
        (
            LetterPress(dead_rows=1),
            TaxelLayout("plain", letter_array().pos),
            r"the image map of 'layout', 0 \(got 1\)",
        ),
    ],
    ids=["small", "margin", "hand", "rows", "no_rows"],
)
def test_wrong_layouts(model, layout, message):
    with pytest.raises(ValueError, match=message):
        press(model, layout=layout)


def test_wrong_presses():
    with pytest.raises(ValueError, match="'letter' must be one of the capital letters"):
        press(LetterPress(), letter="ab")
    with pytest.raises(ValueError, match=r"'count' must not be negative \(got -1\)"):
        press(LetterPress(), count=-1)
