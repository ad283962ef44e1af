r"""A data set of Braille letters read by an iCub fingertip."""

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
    r"""The Braille letters (`Zenodo 7050094 <https://zenodo.org/record/7050094>`_) from the
    `"Braille letter reading: A benchmark for spatio-temporal pattern recognition on neuromorphic
    hardware" <https://www.frontiersin.org/articles/10.3389/fnins.2022.951164/full>`_ paper
    (Müller-Cleve et al., 2022). A fingertip of the iCub robot, moved by another robot, slides over
    3-D printed letters.

    A sample is a frame of 12 taxels with one channel, in the counts and the order of the file. The
    layout is :func:`~torch_geometric_tactile.sensors.icub_fingertip`. The order of the taxels in
    the file is not published; this class assumes that it matches the layout. The other attributes
    are:

    * :obj:`y`: the letter, a space or A to Z;
    * :obj:`trial`: the slide;
    * :obj:`time`: seconds from the start of the slide, at the nominal 40 frames per second if the
      file has no times.

    Use :class:`~torch_geometric_tactile.data.Trials` or
    :class:`~torch_geometric_tactile.data.Windows` to build sequences from the frames.

    **The published files are pickles, which can run arbitrary code when opened; this package never
    opens them.** Convert the raw file once, in a separate environment with pandas, to a file of
    plain arrays for :func:`~torch_geometric_tactile.io.read_samples_npz`:

    .. code-block:: python

        import numpy as np, pandas as pd
        table = pd.DataFrame(pd.read_pickle("data_braille_letters_raw"))
        runs = [np.asarray(run, "float32").reshape(-1, 12, 1) for run in table["taxel_data"]]
        count = [len(run) for run in runs]
        y = np.repeat(table["letter"].to_numpy("str"), count)
        trial = np.repeat(range(len(runs)), count)
        np.savez_compressed("braille_letters.npz", x=np.concatenate(runs), y=y, trial=trial)

    .. warning::
        All slides over a letter repeat **one printed letter on one set-up**, and the file lists the
        slides letter by letter. Splits by slide (``Protocol("trial", folds=5, stratify="y")``)
        share prints and placements between training and test. Scores therefore show how well a
        model recognises repetitions, not other prints or fingers; the data set allows no stricter
        split. All frames of a slide belong on the same side of a split. A third-party program
        treats only four of the twelve taxels as nonzero (1, 2, 6 and 10, counted from 0).

    .. list-table:: STATS from the README; number of frames from a third-party program
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

    The authors' README states 50 slides over each letter, but two third-party programs read 200
    slides (5,400 in total, with 51 frames each). If these are variants of 50 slides, every split
    has variants of the same slide on both sides: count the slides of each letter, and search for
    near copies.

    **This class was written without access to the files and their Zenodo page.** Names and keys are
    taken from the README of the authors' program and from programs that read the files. The licence
    is reported to be CC-BY-4.0: check the Zenodo page.

    Args:
        root (str or PathLike, optional): Folder of the data set. The file
            :obj:`braille_letters.npz` is in its subfolder :obj:`raw` or directly in it. The default
            is :obj:`$TACTILE_DATA/BrailleLetters`, or a folder in the user's cache if that variable
            is not set.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw file again.

    Raises:
        FileNotFoundError: If there is no file. The message contains the code that converts it.
        ValueError: If the file cannot be read, lacks letters or trials, or has an unknown letter,
            or the frames of a trial are not consecutive or have several letters.

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
            "reading_braille_data.zip from https://zenodo.org/record/7050094, and convert the raw "
            f"pickle in it, which this package does not open, with\n{_SCRIPT}"
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
        trial_index = np.cumsum(is_first) - 1
        if len(np.unique(trial)) < len(starts) or (letters != letters[starts][trial_index]).any():
            raise ValueError(f"'{path}' must have consecutive frames of one letter in each trial")
        step = np.arange(len(x)) - starts[trial_index]
        time = content.get("time", step / _RATE).reshape(-1).astype(np.float64)
        classes = [letter for letter in _LETTERS if (letters == letter).any()]
        code = {letter: i for i, letter in enumerate(classes)}
        data = StaticData(
            x=torch.from_numpy(x.reshape(len(x), num_taxels, 1).astype(np.float32)),
            edge_index=self.layout.edge_index("original"),
            pos=self.layout.pos,
            normal=self.layout.normal,
            y=torch.tensor([code[str(letter)] for letter in letters]),
            trial=torch.from_numpy(trial_index),
            time=torch.from_numpy(time - time[starts][trial_index]),
        )
        return data, {"class": classes}
