r"""Braille letters that a fingertip slides over."""

import string
from pathlib import Path

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles
from torch_geometric_tactile.io import read_samples_npz
from torch_geometric_tactile.sensors import icub_fingertip

_FILE = "braille_letters.npz"
_RATE = 40.0  # frames per second
_LETTERS = ("Space", *string.ascii_uppercase)
_SCRIPT = """
import numpy as np, pandas as pd
table = pd.DataFrame(pd.read_pickle("data_braille_letters_raw"))
runs = [np.asarray(run, "float32").reshape(-1, 12, 1) for run in table["taxel_data"]]
count = [len(run) for run in runs]
y = np.repeat(table["letter"].to_numpy("str"), count)
trial = np.repeat(range(len(runs)), count)
np.savez_compressed("braille_letters.npz", x=np.concatenate(runs), y=y, trial=trial)
"""


class BrailleLetters(PlacedFiles):
    r"""The Braille letters (`Zenodo 7050094 <https://zenodo.org/record/7050094>`_) of the `"Braille
    letter reading: A benchmark for spatio-temporal pattern recognition on neuromorphic hardware"
    <https://www.frontiersin.org/articles/10.3389/fnins.2022.951164/full>`_ paper (Müller-Cleve et
    al., 2022): a fingertip of the iCub robot, moved by another robot, slides over 3-D printed
    letters.

    A sample is a frame: 12 taxels with one channel, in the counts and the order of the file; the
    layout is :func:`~torch_geometric_tactile.sensors.icub_fingertip`, whose order is taken for that
    of the file, which is not published. :obj:`y` is the letter, a space or A to Z; :obj:`trial`
    numbers the slides, :obj:`time` are seconds from their start, at the nominal 40 frames a second
    if the file has none. :class:`~torch_geometric_tactile.data.Trials` and
    :class:`~torch_geometric_tactile.data.Windows` make sequences of the frames.

    **The published files are pickles, which run whatever code they hold; this package opens none.**
    Convert the raw one once, in an environment of its own with pandas, to a file of plain arrays as
    :func:`~torch_geometric_tactile.io.read_samples_npz` reads them:

    .. code-block:: python

        import numpy as np, pandas as pd
        table = pd.DataFrame(pd.read_pickle("data_braille_letters_raw"))
        runs = [np.asarray(run, "float32").reshape(-1, 12, 1) for run in table["taxel_data"]]
        count = [len(run) for run in runs]
        y = np.repeat(table["letter"].to_numpy("str"), count)
        trial = np.repeat(range(len(runs)), count)
        np.savez_compressed("braille_letters.npz", x=np.concatenate(runs), y=y, trial=trial)

    .. warning::
        All slides over a letter are repetitions with **one printed letter on one set-up**, and the
        slides follow each other letter by letter in the file. A split by slide
        (``Protocol("trial", folds=5, stratify="y")``) shares print and placement between its parts,
        and nothing finer can be held out: a score is one of repetition, not of another print or
        finger. Frames of a slide belong on one side. A program of others takes four of the twelve
        taxels (1, 2, 6 and 10, counted from 0) for those that are not zero.

    .. list-table:: STATS, by the README and, for the frames, by a program of others
        :header-rows: 1

        * - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - 1,350
          - about 69,000
          - 12
          - 38
          - 1
          - 27

    The authors' README names 50 slides over each letter; two programs of others take 200 from the
    files (5,400 in all, of 51 frames). If these are versions of 50, versions of one slide are on
    both sides of any split: count the slides of a letter, and look for near copies.

    **What was read here**: no file of the record, and not its page; the README of the authors'
    program, their and others' programs that read the files, from which the names and keys are.
    Zenodo's page is said to name the licence CC-BY-4.0: look there.

    Args:
        root (str or PathLike, optional): Folder of the data set; the file
            :obj:`braille_letters.npz` is in its folder :obj:`raw` or in itself. If left out,
            :obj:`$TACTILE_DATA/BrailleLetters` or a folder in the user's cache.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw file anew.

    Raises:
        FileNotFoundError: If there is no file; the message has the lines that make it.
        ValueError: If the file cannot be read, lacks the letters or trials, has another letter, or
            a trial is in pieces or of several letters.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = BrailleLetters("braille")  # doctest: +SKIP
        >>> Protocol("trial", folds=5, stratify="y").split(dataset)  # doctest: +SKIP
    """

    _folder = "BrailleLetters"
    _processed_name = "braille_letters.pt"

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = icub_fingertip()
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    def _files_in(self, folder: Path) -> list[Path]:
        return [folder / _FILE] if (folder / _FILE).is_file() else []

    def _no_files(self) -> str:
        return (
            f"there is no '{_FILE}' in '{self.raw_dir}' or '{self.root}': download "
            "reading_braille_data.zip from https://zenodo.org/record/7050094, and make it from the "
            f"raw pickle in there, which this package does not open, by\n{_SCRIPT}"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads the file."""
        path = self.raw_paths[0]
        content = read_samples_npz(path)
        x = content["x"]
        num_taxels = self.layout.num_taxels
        if x[0].size != num_taxels or x.dtype.kind not in "iuf" or not np.isfinite(x).all():
            raise ValueError(
                f"'{path}' must hold finite readings 'x' of {num_taxels} taxels (got {x.dtype} of "
                f"shape {x.shape})"
            )
        need("trial" in content, f"'{path}' must hold an array 'trial' (got none)")
        letters = content["y"].reshape(-1)
        trial = content["trial"].reshape(-1)
        unknown = sorted({*map(str, np.unique(letters))} - {*_LETTERS})
        need(not unknown, f"'{path}' must hold the letters {_LETTERS[0]} and A to Z", unknown[:3])
        is_first = np.append(True, trial[1:] != trial[:-1])
        starts = np.flatnonzero(is_first)
        number = np.cumsum(is_first) - 1
        if len(np.unique(trial)) < len(starts) or (letters != letters[starts][number]).any():
            raise ValueError(f"'{path}' must have the frames of a trial in a row, of one letter")
        step = np.arange(len(x)) - starts[number]
        time = content.get("time", step / _RATE).reshape(-1).astype(np.float64)
        classes = [letter for letter in _LETTERS if (letters == letter).any()]
        code = {letter: i for i, letter in enumerate(classes)}
        data = StaticData(
            x=torch.from_numpy(x.reshape(len(x), num_taxels, 1).astype(np.float32)),
            edge_index=self.layout.edge_index("original"),
            pos=self.layout.pos,
            normal=self.layout.normal,
            y=torch.tensor([code[str(letter)] for letter in letters]),
            trial=torch.from_numpy(number),
            time=torch.from_numpy(time - time[starts][number]),
        )
        return data, {"class": classes}
