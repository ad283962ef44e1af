r"""A stamp with a letter that is pressed on a flexible pressure array."""

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout, letter_array
from torch_geometric_tactile.sim._pressure_field import CELL, FieldSampling, field_sampling
from torch_geometric_tactile.sim.letter_outlines import LETTERS, letter_strokes

_PAIRS = ("size", "pressure", "repeatability")
_POSITIVE = ("stroke", "sensel", "full_scale")
_NOT_NEGATIVE = ("margin", "blur_length", "spread_length")
_PARTS = ("tilt", "spread", "crosstalk")


class LetterPresses(NamedTuple):
    r"""Simulated presses of a letter: the readings, and the size, angle, place and pressure drawn
    for each.

    Shapes:
        - **readings:** kPa :math:`(P, N)`
        - **size:** height of the letter in metres :math:`(P,)`
        - **angle:** its turn in radians, from :math:`x` to :math:`y` :math:`(P,)`
        - **place:** its middle in the plane of the layout, in metres :math:`(P, 2)`
        - **pressure:** pressure below its middle in kPa :math:`(P,)`
        - **slope:** relative change of the pressure per metre along :math:`x` and :math:`y`
          :math:`(P, 2)`

    Examples:
        >>> presses = LetterPress().press("A", 2, np.random.default_rng(0))
        >>> presses.readings.shape, presses.place.shape
        ((2, 1024), (2, 2))
    """

    readings: np.ndarray
    size: np.ndarray
    angle: np.ndarray
    place: np.ndarray
    pressure: np.ndarray
    slope: np.ndarray


class _Draw(NamedTuple):
    size: float
    angle: float
    place: np.ndarray
    pressure: float
    slope: np.ndarray
    pieces: np.ndarray  # of the strokes, in the plane of the layout


@dataclass(frozen=True)
class LetterPress:
    r"""A stiff stamp with a raised capital letter that is pressed on an array of pressure pixels in
    an elastic layer, after the data set of the "A Novel Bilinear Feature and Multi-Layer Fused
    Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors 2020, 20, 5822). A
    model: the paper measured pressure, repeatability, pixel size and pitch; all else is plausible,
    not measured.

    The parts, in their order: size, turn, place and pressure of the letter are drawn, and a tilt
    that makes pressure differ over it; the layer spreads the pressure, a part of it further (two
    Gaussians, :obj:`blur_length` and :obj:`spread_length`); each pixel takes its mean over the
    square of a sensel and reads it up to :obj:`repeatability` wrong, by another amount in each
    press; dead rows read nothing; each pixel also reads a part of the mean of the others on its row
    and of those on its column (:obj:`crosstalk`); the result is rounded to :obj:`bits` between 0
    and :obj:`full_scale`.

    Rows and columns are those of the layout's image map. A layout without one has no crosstalk.

    Args:
        size (tuple of float): Least and largest height of a letter in metres.
        stroke (float): Width of its strokes in metres.
        angle (float): Largest turn to either side in radians, 20 degrees by default. From 45
            degrees on, a turned N can be a turned Z; with all turns, M and W are hardly told apart.
        margin (float): Least distance of a letter from the edge of the array in metres; the edge is
            the box around the middles of the pixels.
        pressure (tuple of float): Least and largest pressure in kPa.
        tilt (float): Largest change of the pressure, as a part of it, from the middle of the letter
            to half its height in any direction.
        blur_length (float): Standard deviation in metres of the spread of most of the pressure.
        spread (float): Part of the pressure that spreads further.
        spread_length (float): Standard deviation of its spread in metres.
        sensel (float): Side of a pixel's sensitive square in metres.
        repeatability (tuple of float): Least and largest error of a reading, as a part of it.
        crosstalk (float): Part of the mean of the other pixels on its row that a pixel reads, and
            the same of its column.
        full_scale (float): Largest reading in kPa.
        bits (int, optional): Bits of a reading, up to 16; not rounded if :obj:`None`.
        dead_rows (int): Number of rows that are broken.
        device_seed (int): Decides which.

    Raises:
        ValueError: If a number is negative, a range falls, a part is not below one, or an angle is
            above half a turn.

    Examples:
        >>> presses = LetterPress().press("T", 2, np.random.default_rng(0))
        >>> presses.readings.shape
        (2, 1024)
        >>> bool(presses.readings.max() < 100)
        True
    """

    size: tuple[float, float] = (0.014, 0.020)
    stroke: float = 0.0025
    angle: float = math.pi / 9
    margin: float = 0.00125
    pressure: tuple[float, float] = (30.0, 75.0)
    tilt: float = 0.3
    blur_length: float = 0.001
    spread: float = 0.3
    spread_length: float = 0.003
    sensel: float = 0.0007
    repeatability: tuple[float, float] = (-0.02, 0.06)
    crosstalk: float = 0.05
    full_scale: float = 100.0
    bits: int | None = 8
    dead_rows: int = 0
    device_seed: int = 0

    def __post_init__(self) -> None:
        for name in _PAIRS:
            pair = getattr(self, name)
            if np.shape(pair) != (2,) or not -1 < pair[0] <= pair[1] < math.inf:
                raise ValueError(
                    f"'{name}' must be two numbers above -1 that do not fall (got {pair})"
                )
            object.__setattr__(self, name, tuple(map(float, pair)))
        for name in (*_POSITIVE, *_NOT_NEGATIVE):
            value = getattr(self, name)
            if not 0 <= value < math.inf or (value == 0 and name in _POSITIVE):
                least = "positive" if name in _POSITIVE else "not negative"
                raise ValueError(f"'{name}' must be {least} and finite (got {value})")
        for name in _PARTS:
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(
                    f"'{name}' must be at least 0 and below 1 (got {getattr(self, name)})"
                )
        need(0 <= self.angle <= math.pi, "'angle' must be between 0 and pi, in radians", self.angle)
        if self.size[0] <= self.stroke:
            raise ValueError(f"'size' must be above 'stroke', {self.stroke} m (got {self.size[0]})")
        if self.pressure[0] < 0:
            raise ValueError(f"'pressure' must not be negative (got {self.pressure[0]})")
        if self.bits is not None and not 1 <= self.bits <= 16:
            raise ValueError(f"'bits' must be from 1 to 16, or None (got {self.bits})")
        for name in ("dead_rows", "device_seed"):
            if getattr(self, name) < 0:
                raise ValueError(f"'{name}' must not be negative (got {getattr(self, name)})")

    def press(
        self,
        letter: str,
        count: int,
        rng: np.random.Generator,
        layout: TaxelLayout | None = None,
    ) -> LetterPresses:
        r"""Returns the readings of several presses of a letter.

        Args:
            letter (str): One of the letters A to Z.
            count (int): Number of presses.
            rng (numpy.random.Generator): Draws them, and the errors of the pixels.
            layout (TaxelLayout, optional): The pixels, in a plane of constant :math:`z` whose
                :math:`y` points downwards in an image; :func:`letter_array` if left out. From equal
                generators, layouts of the same outer size get the same presses of one.

        Raises:
            ValueError: If there is no such letter, :obj:`count` is negative, or the layout is not
                flat, too small for the letters, or has fewer rows than dead ones.
        """
        need(count >= 0, "'count' must not be negative", count)
        strokes = letter_strokes(letter)
        layout = _default_layout() if layout is None else layout
        self.check_layout(layout)
        sampling = field_sampling(
            layout,
            self.sensel,
            (self.blur_length, self.spread_length),
            (1 - self.spread, self.spread),
        )
        # All presses before any reading: they do not depend on the number of pixels.
        draws = [self._draw(strokes, sampling, rng) for _ in range(count)]
        readings = np.empty((count, layout.num_taxels), dtype=np.float32)
        for i, draw in enumerate(draws):
            readings[i] = self._read(self._at_pixels(draw, sampling), layout, rng)
        return LetterPresses(
            readings,
            np.array([draw.size for draw in draws]),
            np.array([draw.angle for draw in draws]),
            np.array([draw.place for draw in draws]).reshape(count, 2),
            np.array([draw.pressure for draw in draws]),
            np.array([draw.slope for draw in draws]).reshape(count, 2),
        )

    def check_layout(self, layout: TaxelLayout) -> None:
        r"""Raises a :obj:`ValueError` if letters cannot be pressed on a layout.

        Args:
            layout (TaxelLayout): The pixels.
        """
        pos = layout.pos.double().numpy()
        if len(pos) == 0 or np.ptp(pos[:, 2]) > 1e-6:
            raise ValueError(f"'layout' must be flat, with one z for all taxels (got {layout!r})")
        room = float(np.ptp(pos[:, :2], axis=0).min()) - 2 * self.margin
        needed = (self.size[1] - self.stroke) * _longest_diagonal() + self.stroke
        if needed > room:
            raise ValueError(
                f"'layout' must have room for letters of {1000 * self.size[1]:.3g} mm, which need "
                f"{1000 * needed:.3g} mm at any angle (got {1000 * room:.3g} mm within the margin)"
            )
        rows = 0 if layout.image_map is None else len(layout.image_map[:, 0].unique())
        if self.dead_rows > rows:
            raise ValueError(
                f"'dead_rows' must be at most the number of rows of the image map of 'layout', "
                f"{rows} (got {self.dead_rows})"
            )

    def _draw(
        self, strokes: np.ndarray, sampling: FieldSampling, rng: np.random.Generator
    ) -> _Draw:
        part = rng.random(7)
        size = _between(self.size, part[0])
        angle = self.angle * (2 * part[1] - 1)
        cos, sin = math.cos(angle), math.sin(angle)
        turned = (size - self.stroke) * (strokes @ np.array([[cos, sin], [-sin, cos]]))
        edge = self.stroke / 2 + self.margin
        low = sampling.low + edge - turned.min(axis=(0, 1))
        high = sampling.high - edge - turned.max(axis=(0, 1))
        place = low + part[2:4] * (high - low)
        direction = 2 * math.pi * part[5]
        steep = self.tilt * part[6] / (size / 2)
        slope = steep * np.array([math.cos(direction), math.sin(direction)])
        return _Draw(size, angle, place, _between(self.pressure, part[4]), slope, turned + place)

    def _at_pixels(self, draw: _Draw, sampling: FieldSampling) -> np.ndarray:
        # Only cells that the letter touches are evaluated.
        edge = self.stroke / 2 + CELL
        x, y, cells = sampling.cells(
            draw.pieces.min(axis=(0, 1)) - edge, draw.pieces.max(axis=(0, 1)) + edge
        )
        distance = _distance(x, y, draw.pieces)
        covered = np.clip(0.5 - (distance - self.stroke / 2) / CELL, 0.0, 1.0)
        tilted = (
            1
            + draw.slope[0] * (x - draw.place[0])[None, :]
            + draw.slope[1] * (y - draw.place[1])[:, None]
        )
        return draw.pressure * sampling.at_pixels(covered * np.maximum(tilted, 0.0), cells)

    def _read(
        self, pressure: np.ndarray, layout: TaxelLayout, rng: np.random.Generator
    ) -> np.ndarray:
        low, high = self.repeatability
        out = pressure * (1 + rng.uniform(low, high, len(pressure)))
        if layout.image_map is not None:
            rows, columns = layout.image_map.numpy().T
            dead = self._dead(rows)
            out[dead] = 0.0
            if self.crosstalk:
                others = _mean_of_others(out, rows) + _mean_of_others(out, columns)
                out = out + self.crosstalk * others
                out[dead] = 0.0
        out = np.clip(out, 0.0, self.full_scale)
        if self.bits is not None:
            steps = 2**self.bits - 1
            out = np.rint(out * (steps / self.full_scale)) * (self.full_scale / steps)
        return out

    def _dead(self, rows: np.ndarray) -> np.ndarray:
        device = np.random.default_rng(self.device_seed)
        return np.isin(rows, device.permutation(np.unique(rows))[: self.dead_rows])


@cache
def _default_layout() -> TaxelLayout:
    return letter_array()


@cache
def _longest_diagonal() -> float:
    # Of the box of a letter of height one.
    return max(float(np.hypot(*np.ptp(letter_strokes(name), axis=(0, 1)))) for name in LETTERS)


def _between(ends: tuple[float, float], part: float) -> float:
    return ends[0] + part * (ends[1] - ends[0])


def _distance(x: np.ndarray, y: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    # Of each point of a grid to the nearest piece.
    nearest = np.full((len(y), len(x)), np.inf)
    for start, end in pieces:
        along = end - start
        dx, dy = (x - start[0])[None, :], (y - start[1])[:, None]
        part = np.clip((dx * along[0] + dy * along[1]) / (along @ along), 0.0, 1.0)
        square = (dx - part * along[0]) ** 2 + (dy - part * along[1]) ** 2
        np.minimum(nearest, square, out=nearest)
    return np.sqrt(nearest)


def _mean_of_others(readings: np.ndarray, line: np.ndarray) -> np.ndarray:
    total = np.bincount(line, weights=readings)
    others = np.bincount(line) - 1
    mean: np.ndarray = (total[line] - readings) / np.maximum(others, 1)[line]
    return mean
