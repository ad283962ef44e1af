r"""The iCub Grasp data set."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, trials_to_frames
from torch_geometric_tactile.datasets._trial import check_unique_trials
from torch_geometric_tactile.io._icub_grasp_txt import read_icub_grasp_txt
from torch_geometric_tactile.sensors import icub_hand

_NAME = re.compile(r"(?P<object>.+)_(?P<trial>[0-9]{1,9})\.txt", re.ASCII)
_UNRELIABLE = "full_coke"
_MAX_COUNT = 255.0


class _TrialFile(NamedTuple):
    object_name: str
    number: int
    path: Path


class ICubGrasp(PlacedFiles):
    r"""The iCub Grasp data set from the "Online Spatio-Temporal Gaussian Process Experts with
    Application to Tactile Classification" paper (Soh, Su and Demiris, IROS 2012): real grasps of
    ten everyday objects with a hand of the iCub robot, and recordings of the empty hand.

    A sample is a frame of 60 taxels (thumb, index, middle, ring and little finger, twelve each)
    with one channel in raw counts. Untouched taxels read 239 to 249 of 255. Pressure lowers the
    reading, down to 142; with :obj:`contact`, :obj:`x` is 255 minus the reading. The files contain
    no times. The other attributes are:

    * :obj:`y`, :obj:`group`: the object;
    * :obj:`trial`: the file;
    * :obj:`step`: the index of the frame in its trial;
    * :obj:`joint`: nine joint angles in radians, iCub's joints 7 to 15: spread of the fingers,
      opposition of the thumb, two angles each of the thumb, the index and the middle finger, and
      one of the ring and little finger together.

    .. warning::
        Use this data set to test formats and pipelines; **it cannot rank models.** A random forest
        that sees only the *first* frame of a trial recognises the object in 100.0 % of the trials,
        in 99.2 % from the encoders alone, and in 99.3 % from the taxels alone (203 trials, 10
        classes, 5 folds by trial, stratified, 3 seeds; ``studies/split_traps.py``). The trials of
        an object are too similar: most joints start within a degree of each other, and some fingers
        already touch the object. All frames of a trial belong on the same side of a split, but even
        such a split is too easy.

    .. list-table:: STATS
        :header-rows: 1

        * - objects
          - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - without the unreliable object
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

    The files are neither downloaded nor part of this package. The author publishes them on
    `haroldsoh.com <http://www.haroldsoh.com>`_. They are free to use with the author's notice and a
    citation.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its files, named
            ``<object>_<number>.txt``, are in the subfolder :obj:`raw` or :obj:`iCubGraspDataset`,
            or directly in it. The default is :obj:`$TACTILE_DATA/ICubGrasp`, or a folder in the
            user's cache if that variable is not set.
        unreliable (bool): Whether to include the object ``full_coke``, whose data "should not be
            considered reliable" according to their author.
        contact (bool): Whether :obj:`x` is 255 minus the reading, so that it grows with pressure.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no files.
        ValueError: If a file cannot be read, two files hold the same trial, or all trials are with
            the unreliable object.

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
            unreliable_index = self._names["group"].index(_UNRELIABLE)
            is_reliable = self._data.group != unreliable_index
            if not is_reliable.any():
                raise ValueError(
                    f"'{self.root}' must hold trials of objects other than '{_UNRELIABLE}' (got "
                    "none): add some, or choose unreliable=True"
                )
            self._data = self._data.index_select(is_reliable)

    def _files_in(self, folder: Path) -> list[Path]:
        return [file.path for file in _trial_files(folder)]

    @property
    def processed_file_names(self) -> str:
        r"""The processed file of all objects. Readings with :obj:`contact` have a separate file."""
        return "icub_grasp_contact.pt" if self.contact else "icub_grasp.pt"

    @property
    def class_names(self) -> list[str]:
        r"""The names of the objects. The unreliable object is the last one."""
        return self.group_names

    @property
    def group_names(self) -> list[str]:
        r"""The names of the objects. The unreliable object is the last one."""
        return [name for name in super().group_names if self.unreliable or name != _UNRELIABLE]

    def _no_files(self) -> str:
        return (
            f"there are no trials in '{self.raw_dir}' or '{self.root}': put the files of the "
            "iCub Grasp data set there, <object>_<number>.txt (its author publishes them on "
            "http://www.haroldsoh.com)"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all files."""
        files = _trial_files(Path(self.raw_dir))
        check_unique_trials(
            (f[:2], f"trial {f.number} of '{f.object_name}'", f"'{f.path}'") for f in files
        )
        # The unreliable object is the last class, so that the classes have no gap without it.
        objects = sorted({file.object_name for file in files}, key=lambda n: (n == _UNRELIABLE, n))
        trials = [read_icub_grasp_txt(file.path) for file in files]
        num_frames = [len(trial.reading) for trial in trials]
        group = [objects.index(file.object_name) for file in files]
        reading = np.concatenate([trial.reading for trial in trials])[..., None]
        data = StaticData(
            x=torch.from_numpy(_MAX_COUNT - reading if self.contact else reading),
            edge_index=self.layout.edge_index("original"),
            joint=torch.from_numpy(np.concatenate([trial.encoder for trial in trials])),
            step=torch.cat([torch.arange(count) for count in num_frames]),
            **trials_to_frames(num_frames, y=group, group=group),
        )
        names = [file.path.stem for file in files]
        return data, {"class": objects, "group": objects, "trial": names}


def _trial_files(folder: Path) -> list[_TrialFile]:
    if not folder.is_dir():
        return []
    files = [
        _TrialFile(match["object"], int(match["trial"]), path)
        for path in folder.iterdir()
        if (match := _NAME.fullmatch(path.name)) and path.is_file()
    ]
    return sorted(files)
