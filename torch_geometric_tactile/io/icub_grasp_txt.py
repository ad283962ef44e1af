r"""The text files of the iCub Grasp data set: one trial a file, seven lines a frame."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._csv_table import is_number_cell

_ICUB_FINGERS = ("thumb", "index", "middle", "ring", "little")
_NUM_ENCODERS = 9
_NUM_TAXELS = 12
_HEAD = -10000.0
_FULL = 255.0
_APART = 6.0  # counts that a maximum is from its readings, at most, in the published files
_MOST_CHARACTERS = 1000  # of a line; the published ones have 76 at most
_LINES = (
    ("encoders", _NUM_ENCODERS),
    ("maxima", len(_ICUB_FINGERS)),
    *((f"taxels of the {finger} finger", _NUM_TAXELS) for finger in _ICUB_FINGERS),
)


class ICubGraspFrames(NamedTuple):
    r"""The frames of one trial of the iCub Grasp data set, as stored in its file.

    :obj:`reading` are counts :math:`(T, 60)`, finger by finger (thumb, index, middle, ring, little)
    and taxel by taxel, lower where pressed; :obj:`encoder` are joint angles in radians
    :math:`(T, 9)`, of iCub's joints 7 to 15; :obj:`maximum` is 255 less the lowest reading of each
    finger :math:`(T, 5)`, as the robot computed it, in counts.

    Examples:
        >>> frames = ICubGraspFrames(np.full((2, 60), 240), np.zeros((2, 9)), np.full((2, 5), 15))
        >>> frames.reading.shape
        (2, 60)
    """

    reading: np.ndarray
    encoder: np.ndarray
    maximum: np.ndarray


def read_icub_grasp_txt(path: PathLike) -> ICubGraspFrames:
    r"""Reads one file of the iCub Grasp data set: a line -10000, then seven lines for each frame,
    nine encoders, five maxima, and the twelve taxels of five fingers.

    The files tell no unit of the encoders; as iCub's encoders always are, and as their values say,
    they are taken as degrees, and converted to radians. A maximum was taken at another moment than
    the readings: in the published files it is at most 6 counts apart from them.

    Args:
        path (str or PathLike): The file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a line has another number of numbers, a cell is not a finite number, a
            reading is no whole number from 0 to 255, a maximum is further from the readings of its
            finger, an encoder is beyond a full turn, the last frame is not whole, or there is none.
            The message names file and line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> frame = " ".join(["90"] * 9) + "\n" + " ".join(["15"] * 5) + "\n"
        >>> frame += (" ".join(["240"] * 12) + "\n") * 5
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "cup_1.txt"
        ...     _ = path.write_text("-10000\n" + 2 * frame)
        ...     frames = read_icub_grasp_txt(path)
        >>> frames.reading.shape, round(frames.encoder[0, 0].item(), 4)
        ((2, 60), 1.5708)
    """
    path = existing_file(path, "put the file of the iCub Grasp data set there")
    lines = _lines(path)
    _, first = next(lines, (0, ""))
    if not is_number_cell(first) or not first.strip() or float(first) != _HEAD:
        raise ValueError(f"'{path}', line 1 must be -10000 (got {quoted(first)})")
    columns: list[list[np.ndarray]] = [[] for _ in _LINES]
    for i, (line, text) in enumerate(lines):
        what, count = _LINES[i % len(_LINES)]
        where = f"'{path}', line {line}"
        numbers = _numbers(text, where, what, count)
        _check(numbers, where, what)
        columns[i % len(_LINES)].append(numbers)
        if i % len(_LINES) >= 2:
            _check_maximum(numbers, columns[1][-1][i % len(_LINES) - 2], where, what)
    if not columns[0] or len(columns[0]) > len(columns[-1]):
        raise ValueError(
            f"'{path}' must hold {len(_LINES)} lines for each frame, and at least one frame (got "
            f"{sum(map(len, columns))} lines): is the file truncated?"
        )
    return ICubGraspFrames(
        reading=np.concatenate([np.array(column) for column in columns[2:]], axis=1).astype("f4"),
        encoder=np.deg2rad(np.array(columns[0])).astype("f4"),
        maximum=np.array(columns[1]).astype("f4"),
    )


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    number = 0
    with path.open("rb") as file:
        while line := file.readline(_MOST_CHARACTERS):
            number += 1
            if not line.endswith(b"\n"):
                raise ValueError(
                    f"'{path}', line {number} must end with a line break, and be below "
                    f"{_MOST_CHARACTERS} characters: is the file truncated?"
                )
            text = line[:-1].removesuffix(b"\r").replace(b"\t", b" ")
            if not text.isascii() or not text.decode("ascii").isprintable():
                raise ValueError(f"'{path}', line {number} must be plain text (got {text[:20]!r})")
            yield number, text.decode("ascii")


def _numbers(text: str, where: str, what: str, count: int) -> np.ndarray:
    cells = text.split()
    need(len(cells) == count, f"{where} must hold {count} numbers, {what}", len(cells))
    for cell in cells:
        if not is_number_cell(cell) or not abs(float(cell)) < float("inf"):
            raise ValueError(f"{where}: {what} must be finite numbers (got {quoted(cell)})")
    return np.array([float(cell) for cell in cells])


def _check(numbers: np.ndarray, where: str, what: str) -> None:
    if what == "encoders":
        wrong, rule = np.abs(numbers) > 360.0, "at most 360 degrees in size"
    else:
        is_whole = numbers == np.round(numbers)
        wrong = ~is_whole | (numbers < 0) | (numbers > _FULL)
        rule = f"whole numbers from 0 to {_FULL:g}"
    if wrong.any():
        raise ValueError(f"{where}: {what} must be {rule} (got {numbers[wrong][0]:g})")


def _check_maximum(reading: np.ndarray, maximum: float, where: str, what: str) -> None:
    expected = _FULL - reading.min()
    if abs(expected - maximum) > _APART:
        raise ValueError(
            f"{where}: {what} must fit the maximum of their finger, {maximum:g}, within "
            f"{_APART:g} (got a lowest reading of {reading.min():g}): was a line moved?"
        )
