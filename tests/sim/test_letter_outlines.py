import numpy as np
import pytest
from scipy import ndimage

from torch_geometric_tactile.sim import LETTERS, letter_strokes

HOLES = {"A": 1, "B": 2, "D": 1, "O": 1, "P": 1, "Q": 1, "R": 1}


def drawn(letter, width=0.103, cell=0.01):
    """Where a letter with thin strokes is."""
    place = np.arange(-0.75, 0.75, cell)
    points = np.stack(np.meshgrid(place, place), axis=-1)
    out = np.zeros(points.shape[:2], dtype=bool)
    for start, end in letter_strokes(letter):
        part = ((points - start) @ (end - start)) / ((end - start) @ (end - start))
        nearest = start + np.clip(part, 0, 1)[..., None] * (end - start)
        out |= np.linalg.norm(points - nearest, axis=-1) < width / 2
    return out


@pytest.mark.parametrize("letter", LETTERS)
def test_letter_is_one_piece_with_its_holes(letter):
    mask = drawn(letter)
    assert ndimage.label(mask, np.ones((3, 3)))[1] == 1
    assert ndimage.label(~mask)[1] - 1 == HOLES.get(letter, 0)


@pytest.mark.parametrize("letter", LETTERS)
def test_letter_is_one_high_and_about_its_middle(letter):
    strokes = letter_strokes(letter)
    assert np.ptp(strokes[..., 1]) == pytest.approx(1.0, abs=0.01)
    assert strokes.min(axis=(0, 1)) + strokes.max(axis=(0, 1)) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(strokes[:, 1] - strokes[:, 0], axis=1).min() > 0.02


def test_top_is_up():
    # y points downwards: the bar of T is above, that of L below.
    def bar(letter):
        flat = [piece for piece in letter_strokes(letter) if piece[0, 1] == piece[1, 1]]
        return [piece[0, 1] for piece in flat]

    assert bar("T") == [-0.5]
    assert bar("L") == [0.5]
    assert letter_strokes("L")[0, :, 0].tolist() == [-0.29, -0.29]  # and its stem on the left


def test_mirrored_letters_are_themselves():
    for letter in "AHIMOTUVWXY":
        mask = drawn(letter)[:, 1:]  # from -0.74 to 0.74
        assert (mask != mask[:, ::-1]).mean() < 0.01, letter
    for letter in "BCDEFGJKLNPQRSZ":
        mask = drawn(letter)[:, 1:]
        assert (mask != mask[:, ::-1]).mean() > 0.02, letter


def test_result_can_be_changed():
    letter_strokes("A")[:] = 0
    assert letter_strokes("A").any()


@pytest.mark.parametrize("letter", ["a", "AB", "", "Ä", 1, None])
def test_no_letter(letter):
    with pytest.raises(ValueError, match="'letter' must be one of the capital letters A to Z"):
        letter_strokes(letter)
