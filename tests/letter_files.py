"""Small folders of presses for the tests of image data sets."""

import string
from pathlib import Path

import numpy as np

LETTERS = tuple(string.ascii_uppercase)
_SIZE = 32


def write_letters(folder: Path, letters=LETTERS, presses: int = 5, seed: int = 0) -> Path:
    """A stack of blurred shapes for each letter, quantised, in a folder."""
    draw = np.random.default_rng(seed)
    corners = draw.uniform(-8, 8, (len(letters), 4, 2))
    for letter, shape in zip(letters, corners, strict=True):
        (folder / letter).mkdir(parents=True, exist_ok=True)
        stack = np.stack([_press(shape, draw) for _ in range(presses)])
        np.save(folder / letter / f"{letter}_0000.npy", (255 * stack).round().astype(np.uint8))
    return folder


def _press(shape: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """The blurred outline of a polygon, turned, moved, bent and pressed anew each time."""
    angle = draw.uniform(-1.2, 1.2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    place = _SIZE / 2 + draw.uniform(-6, 6, 2)
    corners = (shape + draw.normal(0, 2, shape.shape)) @ turn + place
    pixels = np.stack(np.meshgrid(np.arange(_SIZE), np.arange(_SIZE), indexing="ij"), axis=-1)
    distance = np.min(
        [_distances(pixels, a, b) for a, b in zip(corners, np.roll(corners, 1, 0), strict=True)],
        axis=0,
    )
    return draw.uniform(0.3, 0.75) * np.exp(-((distance / 1.2) ** 2))


def _distances(pixels: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = ((pixels - a) @ (b - a) / ((b - a) @ (b - a))).clip(0, 1)
    found: np.ndarray = np.linalg.norm(pixels - a - along[..., None] * (b - a), axis=-1)
    return found
