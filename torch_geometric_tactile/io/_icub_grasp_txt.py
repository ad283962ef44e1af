r"""Reader of the text files of the iCub Grasp data set, with seven lines per frame."""

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
_FIRST_NUMBER = -10000.0
_MAX_COUNT = 255.0
_MAXIMUM_TOLERANCE = (
    6.0  # counts: the largest difference of a maximum and its readings in the published files
)
_MAX_LINE_LENGTH = 1000  # characters; published lines have at most 76
_LINES = (
    ("encoders", _NUM_ENCODERS),
    ("maxima", len(_ICUB_FINGERS)),
    *((f"taxels of the {finger} finger", _NUM_TAXELS) for finger in _ICUB_FINGERS),
)


class ICubGraspFrames(NamedTuple):
    r"""The frames of one trial of the iCub Grasp data set, as stored in its file.

    :obj:`reading` holds counts :math:`(T, 60)` by finger (thumb, index, middle, ring, little) and
    taxel, which decrease under pressure. :obj:`encoder` holds the angles of iCub's joints 7 to 15
    in radians :math:`(T, 9)`. :obj:`maximum` is 255 minus the lowest reading of each finger
    :math:`(T, 5)` in counts, as computed by the robot.

    Examples:
        >>> frames = ICubGraspFrames(np.full((2, 60), 240), np.zeros((2, 9)), np.full((2, 5), 15))
        >>> frames.reading.shape
        (2, 60)
    """

    reading: np.ndarray
    encoder: np.ndarray
    maximum: np.ndarray


def read_icub_grasp_txt(path: PathLike) -> ICubGraspFrames:
    r"""Reads one file of the iCub Grasp data set: a line -10000, then seven lines for each frame
    with nine encoders, five maxima, and the twelve taxels of each of five fingers.

    The files state no unit of the encoders. Encoders of the iCub are in degrees, and the values in
    the files agree with this, so they are converted from degrees to radians. A maximum and the
    readings were sampled at different moments. In the published files they differ by at most 6
    counts.

    Args:
        path (str or PathLike): The file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a line does not have the expected number of finite numbers, a reading is not
            an integer from 0 to 255, a maximum differs from its readings by more than 6 counts, an
            encoder exceeds a full turn, the last frame is incomplete, or there is no frame. The
            message names file and line.

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
    path = existing_file(path, "put the file from the iCub Grasp data set there")
    lines = _read_lines(path)
    _, first_line = next(lines, (0, ""))
    if (
        not is_number_cell(first_line)
        or not first_line.strip()
        or float(first_line) != _FIRST_NUMBER
    ):
        raise ValueError(f"'{path}', line 1 must be -10000 (got {quoted(first_line)})")
    columns: list[list[np.ndarray]] = [[] for _ in _LINES]
    for i, (line, text) in enumerate(lines):
        noun, num_numbers = _LINES[i % len(_LINES)]
        where = f"'{path}', line {line}"
        numbers = _parse_numbers(text, where, noun, num_numbers)
        _check_range(numbers, where, noun)
        columns[i % len(_LINES)].append(numbers)
        if i % len(_LINES) >= 2:  # a line of taxels, after encoders and maxima
            _check_maximum(numbers, columns[1][-1][i % len(_LINES) - 2], where, noun)
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


def _read_lines(path: Path) -> Iterator[tuple[int, str]]:
    number = 0
    with path.open("rb") as file:
        while line := file.readline(_MAX_LINE_LENGTH):
            number += 1
            if not line.endswith(b"\n"):
                raise ValueError(
                    f"'{path}', line {number} must end with a line break after fewer "
                    f"than {_MAX_LINE_LENGTH} characters: is the file truncated?"
                )
            text = line[:-1].removesuffix(b"\r").replace(b"\t", b" ")
            if not text.isascii() or not text.decode("ascii").isprintable():
                raise ValueError(f"'{path}', line {number} must be plain text (got {text[:20]!r})")
            yield number, text.decode("ascii")


def _parse_numbers(text: str, where: str, noun: str, num_numbers: int) -> np.ndarray:
    cells = text.split()
    need(len(cells) == num_numbers, f"{where} must hold {num_numbers} numbers, {noun}", len(cells))
    for cell in cells:
        if not is_number_cell(cell) or not abs(float(cell)) < float("inf"):
            raise ValueError(f"{where}: {noun} must be finite numbers (got {quoted(cell)})")
    return np.array([float(cell) for cell in cells])


def _check_range(numbers: np.ndarray, where: str, noun: str) -> None:
    if noun == "encoders":
        is_invalid, rule = np.abs(numbers) > 360.0, "between -360 and 360 degrees"
    else:
        is_integer = numbers == np.round(numbers)
        is_invalid = ~is_integer | (numbers < 0) | (numbers > _MAX_COUNT)
        rule = f"integers from 0 to {_MAX_COUNT:g}"
    if is_invalid.any():
        raise ValueError(f"{where}: {noun} must be {rule} (got {numbers[is_invalid][0]:g})")


def _check_maximum(reading: np.ndarray, maximum: float, where: str, noun: str) -> None:
    expected = _MAX_COUNT - reading.min()
    if abs(expected - maximum) > _MAXIMUM_TOLERANCE:
        raise ValueError(
            f"{where}: {noun} must agree with the maximum of their finger, {maximum:g}, within "
            f"{_MAXIMUM_TOLERANCE:g} (got a lowest reading of {reading.min():g}): are lines out of "
            "order?"
        )
