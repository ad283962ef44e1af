r"""Real grasps with the hand of an iCub robot."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, frames_of_trials
from torch_geometric_tactile.datasets._trial import check_one_file_each
from torch_geometric_tactile.io import read_icub_grasp_txt
from torch_geometric_tactile.sensors import icub_hand

_NAME = re.compile(r"(?P<object>.+)_(?P<trial>[0-9]{1,9})\.txt", re.ASCII)
_UNRELIABLE = "full_coke"
_FULL = 255.0


class _TrialFile(NamedTuple):
    object_name: str
    number: int
    path: Path


class ICubGrasp(PlacedFiles):
    r"""The iCub Grasp data set of the "Online Spatio-Temporal Gaussian Process Experts with
    Application to Tactile Classification" paper (Soh, Su and Demiris, IROS 2012): real grasps with
    a hand of the iCub robot of ten everyday objects, and of none.

    A sample is a frame: 60 taxels (thumb, index, middle, ring and little finger, twelve each) with
    one channel, in raw counts, and nine joint angles :obj:`joint` in radians (iCub's joints 7 to
    15: spread of the fingers, opposition of the thumb, its two angles, two each of index and middle
    finger, ring and little finger together). :obj:`y` and :obj:`group` number the objects,
    :obj:`trial` the files, :obj:`step` the frames of a trial. The files hold no times. Untouched
    taxels read 239 to 249 of 255, pressed ones less, down to 142: with :obj:`contact`, 255 less the
    reading.

    .. warning::
        This data set tests formats and pipelines; **it does not rank models.** A random forest that
        sees nothing but the *first* frame of a trial tells the object in 100.0 % of the trials,
        from the encoders alone in 99.2 %, from the taxels alone in 99.3 % (203 trials, 10 classes,
        5 folds by trial, stratified, 3 seeds; ``studies/split_traps.py``). The trials of an
        object are too much alike: most joints start within a degree of each other, and some fingers
        touch already. Frames of a trial belong on one side of a split, and even that asks nothing.

    .. list-table:: STATS
        :header-rows: 1

        * - objects
          - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - without the unreliable one
          - 203
          - 2,520
          - 60
          - 190
          - 1
          - 10
        * - all
          - 230
          - 2,883
          - 60
          - 190
          - 1
          - 11

    The files are not downloaded and do not come with this package: the author gives them away on
    `haroldsoh.com <http://www.haroldsoh.com>`_, free to use with their notice and a citation.

    Args:
        root (str or PathLike, optional): Folder of the data set; its files, named
            ``<object>_<number>.txt``, are in its folder :obj:`raw` or :obj:`iCubGraspDataset` or in
            itself. If left out, :obj:`$TACTILE_DATA/ICubGrasp` or a folder in the user's cache.
        unreliable (bool): Whether to take the object ``full_coke`` as well, whose data "should not
            be considered reliable", as their author says.
        contact (bool): Whether :obj:`x` is 255 less the reading, so that it grows with pressure.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no files.
        ValueError: If a file cannot be read, two hold the same trial, or only unreliable ones are
            there.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = ICubGrasp("icub")  # doctest: +SKIP
        >>> Protocol("trial", folds=5, stratify="y").split(dataset)  # doctest: +SKIP
    """

    group_kind = "object"
    selection_args = ("unreliable",)
    _folder = "ICubGrasp"
    _folders = ("raw", "iCubGraspDataset", ".")

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        unreliable: bool = False,
        contact: bool = False,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = icub_hand()
        self.unreliable = unreliable
        self.contact = contact
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        if not unreliable and _UNRELIABLE in self._names["group"]:
            number = self._names["group"].index(_UNRELIABLE)
            kept = self._data.group != number
            if not kept.any():
                raise ValueError(
                    f"'{self.root}' must hold trials of other objects than '{_UNRELIABLE}' (got "
                    "none): add them, or choose unreliable=True"
                )
            self._data = self._data.index_select(kept)

    def _files_in(self, folder: Path) -> list[Path]:
        return [file.path for file in _trial_files(folder)]

    @property
    def processed_file_names(self) -> str:
        r"""One file for all objects."""
        return "icub_grasp_contact.pt" if self.contact else "icub_grasp.pt"

    @property
    def class_names(self) -> list[str]:
        r"""The names of the objects; an unreliable one is the last."""
        return self.group_names

    @property
    def group_names(self) -> list[str]:
        r"""The names of the objects; an unreliable one is the last."""
        return [name for name in super().group_names if self.unreliable or name != _UNRELIABLE]

    def _no_files(self) -> str:
        return (
            f"there are no trials in '{self.raw_dir}' or '{self.root}': put the files of the "
            "iCub Grasp data set there, <object>_<number>.txt (its author gives them away on "
            "http://www.haroldsoh.com)"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all files."""
        files = _trial_files(Path(self.raw_dir))
        check_one_file_each(
            (f[:2], f"trial {f.number} of '{f.object_name}'", f"'{f.path}'") for f in files
        )
        objects = sorted({file.object_name for file in files}, key=lambda n: (n == _UNRELIABLE, n))
        trials = [read_icub_grasp_txt(file.path) for file in files]
        num_frames = [len(trial.reading) for trial in trials]
        group = [objects.index(file.object_name) for file in files]
        reading = np.concatenate([trial.reading for trial in trials])[..., None]
        data = StaticData(
            x=torch.from_numpy(_FULL - reading if self.contact else reading),
            edge_index=self.layout.edge_index("original"),
            joint=torch.from_numpy(np.concatenate([trial.encoder for trial in trials])),
            step=torch.cat([torch.arange(count) for count in num_frames]),
            **frames_of_trials(num_frames, y=group, group=group),
        )
        names = [file.path.stem for file in files]
        return data, {"class": objects, "group": objects, "trial": names}


def _trial_files(folder: Path) -> list[_TrialFile]:
    if not folder.is_dir():
        return []
    found = [
        _TrialFile(match["object"], int(match["trial"]), path)
        for path in folder.iterdir()
        if (match := _NAME.fullmatch(path.name)) and path.is_file()
    ]
    return sorted(found)
