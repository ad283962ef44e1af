r"""Simulated presses of letters on a pressure array, as a folder for each letter."""

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

#: Number of presses of each letter that :func:`simulate_letters` writes if none is given.
LETTER_PRESSES = 500
_BLOCK = 100  # presses in a file
_GENERATOR = "letters"
_VERSION = 1  # of the generator: another one makes other bits
_LAYOUT = "layout.json"
_NOTE = "Simulated. Letters, spread, tilt and crosstalk are plausible, not measured."


class LetterReport(NamedTuple):
    r"""A finished file of presses: the letter, the index of the first press and the number of
    presses. :obj:`kept` tells whether the file existed already.

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
        return super().is_finished() and _presses_in(self) >= self.presses

    def kept(self) -> LetterReport:
        return LetterReport(self.letter, self.first, _presses_in(self), self.path, kept=True)

    def simulate(self) -> LetterReport:
        number = LETTERS.index(self.letter)
        readings = []
        for i in range(self.first, self.first + self.presses):
            rng = np.random.default_rng([self.seed, number, i])
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
    r"""Simulates presses of letters and writes them to a folder for each letter, which
    :class:`~torch_geometric_tactile.datasets.LetterShape` reads. Yields a report for each file when
    it is finished.

    A file, such as :obj:`A/A_0100.npy`, holds up to 100 presses in kPa, 32-bit floats
    :math:`(P, 32, 32)`. Of a :obj:`layout` other than :func:`letter_array` they are
    :math:`(P, N)`, and :obj:`layout.json` lies beside the folders. :obj:`simulation.json` tells how
    they were made.

    A press is a function of seed, letter and number, bit for bit whatever :obj:`jobs` and
    :obj:`presses` are (another processor or release of NumPy may round another way). Finished files
    are kept, so that a run that was stopped or killed goes on where it was, and a larger one adds
    to a smaller.

    Args:
        out (str or PathLike): Folder of the letters.
        presses (int): Number of presses of each letter.
        seed (int): Seed, not negative.
        jobs (int): Processes.
        press (LetterPress, optional): The model.
        letters (sequence of str): The letters, all by default.
        layout (TaxelLayout, optional): The pixels.

    Raises:
        ValueError: If a number is too small, there is no such letter, the letters do not fit on the
            layout, or the folder holds presses that were made with other arguments.

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
        "'letters' must be one or more, each once",
        repr(letters),
    )
    for letter in letters:
        letter_strokes(letter)
    press.check_layout(letter_array() if layout is None else layout)
    if layout is not None and _same_taxels(layout, letter_array()):
        layout = None
    blocks = [
        _Block(str(out), letter, first, min(_BLOCK, presses - first), seed, press, layout)
        for letter in letters
        for first in range(0, presses, _BLOCK)
    ]
    return _run(blocks, Path(out), jobs)


def num_letter_files(presses: int, letters: Sequence[str] = LETTERS) -> int:
    r"""Returns how many files :func:`simulate_letters` writes.

    Args:
        presses (int): Number of presses of each letter.
        letters (sequence of str): The letters.

    Examples:
        >>> num_letter_files(500)
        130
    """
    return len(letters) * math.ceil(presses / _BLOCK)


def _same_taxels(first: TaxelLayout, second: TaxelLayout) -> bool:
    a, b = first.image_map, second.image_map
    same_map = a is b if a is None or b is None else torch.equal(a, b)
    return same_map and torch.equal(first.pos, second.pos)


def _run(blocks: list[_Block], out: Path, jobs: int) -> Generator[LetterReport, None, None]:
    # Before the first press, such that no file is ever without what tells how it was made.
    settings = _settings(blocks[0])
    if (out / SUMMARY).exists():
        _check_settings(out / SUMMARY, settings)
    else:
        strays = sorted(path for block in blocks if (path := block.path).exists())
        if strays:
            raise ValueError(
                f"'{strays[0]}' lies in a folder without '{SUMMARY}', which tells how it was made; "
                "choose another folder"
            )
    _prepare_layout(out / _LAYOUT, blocks[0].layout)
    _check_blocks(blocks)
    write_summary(out, settings)
    yield from run_trials(blocks, out, jobs)


def _prepare_layout(path: Path, layout: TaxelLayout | None) -> None:
    if path.exists():
        found = TaxelLayout.load(path)
        if layout is None or not _same_taxels(found, layout):
            raise ValueError(
                f"'{path}' must have the taxels of 'layout', as the presses beside it (got "
                f"{found!r}); choose another folder"
            )
    elif layout is not None:
        layout.save(path)


def _check_blocks(blocks: list[_Block]) -> None:
    wanted = {block.path: block for block in blocks}
    for folder in dict.fromkeys(path.parent for path in wanted):
        for path in sorted(folder.glob("*.npy")):
            if path not in wanted or _presses_in(wanted[path]) > wanted[path].presses:
                raise ValueError(
                    f"'{path}' holds presses beyond the number that 'presses' asks for; ask for as "
                    "many as before or more, or choose another folder"
                )


def _settings(task: _Block) -> dict[str, Any]:
    return {
        "synthetic": True,
        "note": _NOTE,
        "generator": _GENERATOR,
        "generator_version": _VERSION,
        "unit": "kPa",
        "seed": task.seed,
        "layout": (task.layout or letter_array()).name,
        "num_taxels": (task.layout or letter_array()).num_taxels,
        "press": json.loads(json.dumps(asdict(task.press))),
    }


def _check_settings(path: Path, settings: dict[str, Any]) -> None:
    try:
        found = read_json(path)
    except ValueError as error:
        raise ValueError(f"'{path}' is damaged ({error}); choose another folder") from error
    for key, wanted in settings.items():
        got = found.get(key) if isinstance(found, dict) else None
        if got != wanted and key != "note":
            if key == "press" and isinstance(got, dict):
                key = next(name for name in wanted if got.get(name) != wanted[name])
                got, wanted = got.get(key), wanted[key]
            raise ValueError(
                f"'{path}': its presses were made with another '{key}' ({got}, not {wanted}); "
                "choose another folder"
            )


def _presses_in(task: _Block) -> int:
    try:
        block = np.load(task.path, mmap_mode="r", allow_pickle=False)
        shape, kind = block.shape, block.dtype
    except (ValueError, EOFError) as error:
        raise ValueError(
            f"'{task.path}' is damaged ({error}); delete it to simulate it again"
        ) from error
    if kind != np.float32 or shape[1:] != task.shape or not 0 < shape[0] <= _BLOCK:
        raise ValueError(
            f"'{task.path}' must hold float32 of shape {('P', *task.shape)} (got {kind} of shape "
            f"{shape}); delete it to simulate it again"
        )
    return int(shape[0])


def _write_block(block: np.ndarray, path: Path) -> None:
    r"""Writes a file of presses as a whole."""
    content = io.BytesIO()  # NumPy's own errors of a full disk have no number
    np.save(content, block)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content.getbuffer())
