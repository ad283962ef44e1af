r"""Recordings of simulated presses of letters on a pressure array, with one folder per letter."""

import io
import json
import math
from collections.abc import Generator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import read_json
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, letter_array
from torch_geometric_tactile.sim._trial_files import (
    SUMMARY,
    SimulatedTrial,
    check_run,
    run_trials,
    write_summary,
)
from torch_geometric_tactile.sim.letter_outlines import LETTERS, letter_strokes
from torch_geometric_tactile.sim.letter_press import LetterPress

#: Default number of presses of each letter of :func:`simulate_letters`.
LETTER_PRESSES = 500
_BLOCK_SIZE = 100  # number of presses per file
_GENERATOR = "letters"
_VERSION = 1  # version of the generator; presses of different versions differ
_LAYOUT_FILE = "layout.json"
_NOTE = "Simulated. Letters, spread, tilt and crosstalk are plausible, not measured."


class LetterReport(NamedTuple):
    r"""A finished file with presses: the letter, the index of the first press and the number of
    presses. :obj:`kept` is :obj:`True` if the file already existed.

    Examples:
        >>> report = LetterReport("A", 100, presses=50, path=Path("A/A_0100.npy"), kept=False)
        >>> report.letter, report.first
        ('A', 100)
    """

    letter: str
    first: int
    presses: int
    path: Path
    kept: bool


@dataclass(frozen=True)
class _Block(SimulatedTrial[LetterReport]):
    out: str
    letter: str
    first: int
    presses: int
    seed: int
    press: LetterPress
    layout: TaxelLayout | None

    @property
    def path(self) -> Path:
        return Path(self.out) / self.letter / f"{self.letter}_{self.first:04d}.npy"

    @property
    def shape(self) -> tuple[int, ...]:
        return (32, 32) if self.layout is None else (self.layout.num_taxels,)

    def is_finished(self) -> bool:
        return super().is_finished() and _num_presses(self) >= self.presses

    def finished_report(self) -> LetterReport:
        return LetterReport(self.letter, self.first, _num_presses(self), self.path, kept=True)

    def simulate(self) -> LetterReport:
        letter_index = LETTERS.index(self.letter)
        readings = []
        for i in range(self.first, self.first + self.presses):
            rng = np.random.default_rng([self.seed, letter_index, i])
            readings.append(self.press.press(self.letter, 1, rng, self.layout).readings)
        _write_block(np.concatenate(readings).reshape(-1, *self.shape), self.path)
        return LetterReport(self.letter, self.first, self.presses, self.path, kept=False)


def simulate_letters(
    out: PathLike,
    presses: int = LETTER_PRESSES,
    seed: int = 0,
    jobs: int = 1,
    *,
    press: LetterPress | None = None,
    letters: Sequence[str] = LETTERS,
    layout: TaxelLayout | None = None,
) -> Generator[LetterReport, None, None]:
    r"""Simulates presses of letters and writes them to one folder per letter, which
    :class:`~torch_geometric_tactile.datasets.LetterShape` reads. Yields a report for each file when
    it is finished.

    A file, such as :obj:`A/A_0100.npy`, contains up to 100 presses in kPa as 32-bit floats
    :math:`(P, 32, 32)`. With a :obj:`layout` other than :func:`letter_array`, the shape is
    :math:`(P, N)`, and the layout is written to :obj:`layout.json` beside the folders.
    :obj:`simulation.json` contains the arguments.

    The seed, the letter and the number of a press determine it bit for bit, for any :obj:`jobs` and
    :obj:`presses`; other processors or releases of NumPy may round differently. Finished files are
    not simulated again, so that the same call resumes an interrupted run. A larger number of
    presses extends an earlier run.

    Args:
        out (str or PathLike): Folder of the letters.
        presses (int): Number of presses of each letter.
        seed (int): Seed, which must not be negative.
        jobs (int): Number of processes.
        press (LetterPress, optional): The model of a press.
        letters (sequence of str): The letters (default: all).
        layout (TaxelLayout, optional): The pixels (default: :func:`letter_array`).

    Raises:
        ValueError: If a number is too small, if a letter is unknown, if the letters do not fit on
            the layout, or if the folder contains presses that were simulated with other arguments.

    Examples:
        >>> from tempfile import TemporaryDirectory
        >>> from torch_geometric_tactile.sim import simulate_letters
        >>> with TemporaryDirectory() as out:
        ...     [(r.letter, r.presses) for r in simulate_letters(out, presses=2, letters="AB")]
        [('A', 2), ('B', 2)]
    """
    check_run(seed, presses=presses, jobs=jobs)
    press = LetterPress() if press is None else press
    need(isinstance(press, LetterPress), "'press' must be a LetterPress", repr(press))
    need(
        0 < len(letters) == len(set(letters)),
        "'letters' must be one or more different letters",
        repr(letters),
    )
    for letter in letters:
        letter_strokes(letter)
    press.check_layout(letter_array() if layout is None else layout)
    if layout is not None and _have_same_taxels(layout, letter_array()):
        layout = None
    blocks = [
        _Block(str(out), letter, first, min(_BLOCK_SIZE, presses - first), seed, press, layout)
        for letter in letters
        for first in range(0, presses, _BLOCK_SIZE)
    ]
    return _run_blocks(blocks, Path(out), jobs)


def num_letter_files(presses: int, letters: Sequence[str] = LETTERS) -> int:
    r"""Returns the number of files that :func:`simulate_letters` writes.

    Args:
        presses (int): Number of presses of each letter.
        letters (sequence of str): The letters.

    Examples:
        >>> num_letter_files(500)
        130
    """
    return len(letters) * math.ceil(presses / _BLOCK_SIZE)


def _have_same_taxels(first: TaxelLayout, second: TaxelLayout) -> bool:
    a, b = first.image_map, second.image_map
    same_map = a is b if a is None or b is None else torch.equal(a, b)
    return same_map and torch.equal(first.pos, second.pos)


def _run_blocks(blocks: list[_Block], out: Path, jobs: int) -> Generator[LetterReport, None, None]:
    # The settings are written before the first press, because an .npy file does not contain them.
    settings = _run_settings(blocks[0])
    if (out / SUMMARY).exists():
        _check_settings(out / SUMMARY, settings)
    else:
        unknown_files = sorted(path for block in blocks if (path := block.path).exists())
        if unknown_files:
            raise ValueError(
                f"'{unknown_files[0]}' lies in a folder without '{SUMMARY}', which has its "
                "settings; choose another folder"
            )
    _prepare_layout(out / _LAYOUT_FILE, blocks[0].layout)
    _check_blocks(blocks)
    write_summary(out, settings)
    yield from run_trials(blocks, out, jobs)


def _prepare_layout(path: Path, layout: TaxelLayout | None) -> None:
    if path.exists():
        folder_layout = TaxelLayout.load(path)
        if layout is None or not _have_same_taxels(folder_layout, layout):
            raise ValueError(
                f"'{path}', the layout of the presses in this folder, must have the same taxels as "
                f"'layout' (got {folder_layout!r}); choose another folder"
            )
    elif layout is not None:
        layout.save(path)


def _check_blocks(blocks: list[_Block]) -> None:
    block_by_path = {block.path: block for block in blocks}
    for folder in dict.fromkeys(path.parent for path in block_by_path):
        for path in sorted(folder.glob("*.npy")):
            block = block_by_path.get(path)
            if block is None or _num_presses(block) > block.presses:
                raise ValueError(
                    f"'{path}' holds more presses than 'presses' requests; use at least the "
                    "number of the earlier run, or choose another folder"
                )


def _run_settings(block: _Block) -> dict[str, Any]:
    return {
        "synthetic": True,
        "note": _NOTE,
        "generator": _GENERATOR,
        "generator_version": _VERSION,
        "unit": "kPa",
        "seed": block.seed,
        "layout": (block.layout or letter_array()).name,
        "num_taxels": (block.layout or letter_array()).num_taxels,
        "press": json.loads(json.dumps(asdict(block.press))),
    }


def _check_settings(path: Path, settings: dict[str, Any]) -> None:
    try:
        content = read_json(path)
    except ValueError as error:
        raise ValueError(f"'{path}' is damaged ({error}); choose another folder") from error
    for key, expected in settings.items():
        value = content.get(key) if isinstance(content, dict) else None
        if value != expected and key != "note":
            if key == "press" and isinstance(value, dict):
                key = next(name for name in expected if value.get(name) != expected[name])
                value, expected = value.get(key), expected[key]
            raise ValueError(
                f"'{path}': the presses were simulated with another '{key}' ({value}, not "
                f"{expected}); "
                "choose another folder"
            )


def _num_presses(block: _Block) -> int:
    try:
        readings = np.load(block.path, mmap_mode="r", allow_pickle=False)
        shape, dtype = readings.shape, readings.dtype
    except (ValueError, EOFError) as error:
        raise ValueError(
            f"'{block.path}' is damaged ({error}); delete it to simulate it again"
        ) from error
    if dtype != np.float32 or shape[1:] != block.shape or not 0 < shape[0] <= _BLOCK_SIZE:
        raise ValueError(
            f"'{block.path}' must hold float32 of shape {('P', *block.shape)} (got {dtype} of "
            f"shape {shape}); delete it to simulate it again"
        )
    return int(shape[0])


def _write_block(readings: np.ndarray, path: Path) -> None:
    r"""Writes a file of presses, either completely or not at all."""
    # On a full disk, np.save raises an OSError without errno, so the bytes are written separately.
    content = io.BytesIO()
    np.save(content, readings)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content.getbuffer())
