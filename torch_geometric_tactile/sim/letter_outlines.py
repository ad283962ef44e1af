r"""Capital letters as strokes. They were drawn for this package and have its licence."""

import math
from functools import cache

import numpy as np

#: The letters that can be pressed, in the order of their classes.
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"

_ARC_STEP = 12.0  # degrees of an arc per straight piece; accurate to 0.6 % of the radius

_Points = list[tuple[float, float]]


def letter_strokes(letter: str) -> np.ndarray:
    r"""Returns the centre lines of a capital letter without serifs as straight pieces. The letter
    has height one, and the centre of its bounding box is at the origin; :math:`x` points to the
    right and :math:`y` downwards.

    The letters were drawn for this package and do not come from a font.

    Args:
        letter (str): One of the letters A to Z.

    Shapes:
        - **output:** coordinates :math:`x` and :math:`y` of the ends of each piece
          :math:`(S, 2, 2)`

    Raises:
        ValueError: If :obj:`letter` is not one of A to Z.

    Examples:
        >>> letter_strokes("I").tolist()
        [[[0.0, -0.5], [0.0, 0.5]]]
    """
    if not isinstance(letter, str) or len(letter) != 1 or letter not in LETTERS:
        raise ValueError(f"'letter' must be one of the capital letters A to Z (got {letter!r})")
    return _centred_strokes(letter).copy()


@cache
def _centred_strokes(letter: str) -> np.ndarray:
    lines = [np.array(line) for line in _LINES[letter]]
    pieces = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    centre = (pieces.min(axis=(0, 1)) + pieces.max(axis=(0, 1))) / 2
    centred: np.ndarray = pieces - centre
    return centred


def _arc(
    centre: tuple[float, float], radii: tuple[float, float], start: float, stop: float
) -> _Points:
    # Angles in degrees increase from the right over the bottom to the left, because y points
    # downwards.
    num_points = max(2, math.ceil(abs(stop - start) / _ARC_STEP) + 1)
    angles = [
        math.radians(start + (stop - start) * i / (num_points - 1)) for i in range(num_points)
    ]
    (x, y), (rx, ry) = centre, radii
    return [(x + rx * math.cos(angle), y + ry * math.sin(angle)) for angle in angles]


_STEM: _Points = [(0, 0), (0, 1)]
_P_BOWL: _Points = [(0, 0), *_arc((0.36, 0.27), (0.27, 0.27), 270, 450), (0, 0.54)]
_RING: _Points = _arc((0.44, 0.5), (0.44, 0.5), 0, 360)

_LINES: dict[str, list[_Points]] = {
    "A": [[(0, 1), (0.4, 0), (0.8, 1)], [(0.14, 0.65), (0.66, 0.65)]],
    "B": [
        _STEM,
        [(0, 0), *_arc((0.36, 0.24), (0.24, 0.24), 270, 450), (0, 0.48)],
        [(0, 0.48), *_arc((0.4, 0.74), (0.26, 0.26), 270, 450), (0, 1)],
    ],
    "C": [_arc((0.42, 0.5), (0.42, 0.5), 316, 44)],
    "D": [_STEM, [(0, 0), *_arc((0.28, 0.5), (0.46, 0.5), 270, 450), (0, 1)]],
    "E": [[(0.6, 0), (0, 0), (0, 1), (0.6, 1)], [(0, 0.5), (0.52, 0.5)]],
    "F": [[(0.6, 0), (0, 0), (0, 1)], [(0, 0.5), (0.5, 0.5)]],
    "G": [[*_arc((0.42, 0.5), (0.42, 0.5), 316, 31), (0.78, 0.54), (0.46, 0.54)]],
    "H": [_STEM, [(0.74, 0), (0.74, 1)], [(0, 0.5), (0.74, 0.5)]],
    "I": [_STEM],
    "J": [[(0.5, 0), *_arc((0.25, 0.72), (0.25, 0.28), 0, 155)]],
    "K": [_STEM, [(0.66, 0), (0, 0.6)], [(0.24, 0.382), (0.7, 1)]],
    "L": [[(0, 0), (0, 1), (0.58, 1)]],
    "M": [[(0, 1), (0, 0), (0.45, 0.75), (0.9, 0), (0.9, 1)]],
    "N": [[(0, 1), (0, 0), (0.74, 1), (0.74, 0)]],
    "O": [_RING],
    "P": [_STEM, _P_BOWL],
    "Q": [_RING, [(0.54, 0.66), (0.88, 1)]],
    "R": [_STEM, _P_BOWL, [(0.34, 0.54), (0.66, 1)]],
    "S": [
        [
            *_arc((0.33, 0.25), (0.31, 0.25), 335, 90),
            *_arc((0.33, 0.75), (0.33, 0.25), 270, 510)[1:],
        ]
    ],
    "T": [[(0, 0), (0.74, 0)], [(0.37, 0), (0.37, 1)]],
    "U": [[(0, 0), *_arc((0.36, 0.64), (0.36, 0.36), 180, 0), (0.72, 0)]],
    "V": [[(0, 0), (0.4, 1), (0.8, 0)]],
    "W": [[(0, 0), (0.26, 1), (0.52, 0.1), (0.78, 1), (1.04, 0)]],
    "X": [[(0, 0), (0.74, 1)], [(0.74, 0), (0, 1)]],
    "Y": [[(0, 0), (0.38, 0.5), (0.76, 0)], [(0.38, 0.5), (0.38, 1)]],
    "Z": [[(0, 0), (0.7, 0), (0, 1), (0.7, 1)]],
}
