r"""A data set of boxes moved by a gripper with uSkin."""

from pathlib import Path
from typing import Literal

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, trials_to_frames
from torch_geometric_tactile.io import read_uskin_pick
from torch_geometric_tactile.sensors import select_taxels, uskin_gripper

_URL = "https://github.com/imanlab/tactile_prediction_flat_dataset"
_COMMIT = "ed8c1a002e3e33f8ebd61a1b4dd21ae0098f9867"
_PARTS = {"train": 0, "test": 2}
_FILES = ("meta_data.csv", "robot_state.csv", "xela_sensor1.csv", "xela_sensor2.csv")
_TARGETS = ("dropped", "object")
_TAXELS_PER_FINGER = 16


class USkinPick(PlacedFiles):
    r"""The pick-and-move trials of the Intelligent Manipulation Lab
    (`tactile_prediction_flat_dataset
    <https://github.com/imanlab/tactile_prediction_flat_dataset>`_). A Panda arm, guided by hand,
    lifts and moves boxes between two fingers with one uSkin patch each, and holds or drops them.

    A sample is a frame of 32 taxels (two patches of 4 x 4, see
    :func:`~torch_geometric_tactile.sensors.uskin_gripper`) with three channels in raw counts. The
    other attributes are:

    * :obj:`joint`: the seven joint angles in radians;
    * :obj:`end_effector`: position in metres and quaternion x, y, z, w;
    * :obj:`finger`: the gripper opening, as published;
    * :obj:`trial`: the folder;
    * :obj:`group`: the object;
    * :obj:`time`: seconds from the start, at the rate of the trial;
    * :obj:`fell`: 1 in all frames of a trial in which the object fell;
    * :obj:`seen`: 1 if the authors list the object as seen in training;
    * :obj:`part`: the authors' folder, ``train`` or ``test``, used by ``Protocol("given")``.

    .. warning::
        **Rows repeat.** The log has about 40 rows per second and is faster than the sensors: 75 %
        of the rows repeat the readings of the previous row, up to six times. A random split of
        frames therefore has the same readings in training and test. :obj:`repeats=False` leaves
        12,964 frames, about 10 per second. Hold out trials (``Protocol("trial", stratify="y")``) or
        objects (``Protocol("group", ...)``).

        **The published test part mixes two questions.** It was recorded a day later, with trials of
        one object from the training part (object 7, where :obj:`seen` is 1) and of two new objects
        (9 and 11). Report both scores.

        :obj:`fell` is a label of the complete trial: in the first frames, the fall is still in the
        future.

    .. list-table:: STATS, as published
        :header-rows: 1

        * - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
          - #objects
        * - 75 (52 train, 23 test)
          - 52,645
          - 32
          - 96
          - 3
          - 2
          - 11

    These numbers refer to commit ``ed8c1a0``. The trials have 132 to 3,785 rows, and the object
    fell in 24 of them. The test part has nine trials with object 11, seven with object 7 and seven
    with object 9; the object fell in ten of them.

    The repository names no licence. The files are therefore neither downloaded nor part of this
    package: get them with ``git clone``, and check whether you may use them.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its folders ``train`` and ``test``
            are in the subfolder :obj:`raw` or :obj:`tactile_prediction_flat_dataset`, or directly
            in it. The default is :obj:`$TACTILE_DATA/USkinPick`, or a folder in the user's cache if
            that variable is not set.
        target (str): The label :obj:`y`: :obj:`"dropped"`, or the class index of the
            :obj:`"object"`.
        repeats (bool): Whether to keep frames that repeat the readings of the previous frame.
        stacked (bool): Whether to stack the channels of the two patches. A sample then has 16
            taxels with six channels, starting with the three of the first finger. Use it for models
            of several equal fingers, such as
            :class:`~torch_geometric_tactile.nn.models.GraspGCN`.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no trials, or a trial lacks a file.
        ValueError: If :obj:`target` is unknown, or a file cannot be read.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = USkinPick("tactile_prediction_flat_dataset")  # doctest: +SKIP
        >>> Protocol("given").split(dataset)  # doctest: +SKIP
    """

    group_kind = "object"
    _folder = "USkinPick"
    _folders = ("raw", "tactile_prediction_flat_dataset", ".")

    def __init__(
        self,
        root: PathLike | None = None,
        target: Literal["dropped", "object"] = "dropped",
        *,
        repeats: bool = True,
        stacked: bool = False,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        need(target in _TARGETS, f"'target' must be one of {list(_TARGETS)} (got '{target}')")
        gripper = uskin_gripper()
        self.layout = select_taxels(gripper, range(_TAXELS_PER_FINGER)) if stacked else gripper
        self.target = target
        self.repeats = repeats
        self.stacked = stacked
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def processed_file_names(self) -> str:
        r"""The processed file. Each choice of :obj:`target`, :obj:`repeats` and :obj:`stacked` has
        a separate file.
        """
        suffix = f"{'' if self.repeats else '_changes'}{'_stacked' if self.stacked else ''}"
        return f"uskin_pick_{self.target}{suffix}.pt"

    def _files_in(self, folder: Path) -> list[Path]:
        return [trial / name for trial in _trials(folder) for name in _FILES]

    def _no_files(self) -> str:
        return (
            f"there are no trials in '{self.raw_dir}' or '{self.root}': put the folders 'train' "
            f"and 'test' of {_URL} there (git clone; this class was written for commit {_COMMIT})"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all trials."""
        trials = _trials(Path(self.raw_dir))
        recordings = [read_uskin_pick(trial, repeats=self.repeats) for trial in trials]
        object_names = [recording.meta["object"] for recording in recordings]
        objects = sorted(set(object_names), key=lambda name: (len(name), name))  # 4, 5, ..., 10
        group = [objects.index(name) for name in object_names]
        fell = [recording.meta["dropped"] for recording in recordings]
        is_object = self.target == "object"
        columns = {
            "x": [self._stack_fingers(recording.tactile) for recording in recordings],
            "joint": [np.asarray(recording.joint) for recording in recordings],
            "time": [recording.time for recording in recordings],
            "finger": [recording.extra["finger"] for recording in recordings],
            "end_effector": [recording.extra["end_effector"] for recording in recordings],
        }
        data = StaticData(
            edge_index=self.layout.edge_index("original"),
            pos=self.layout.pos,
            normal=self.layout.normal,
            **{key: torch.from_numpy(np.concatenate(rows)) for key, rows in columns.items()},
            **trials_to_frames(
                [recording.num_frames for recording in recordings],
                y=group if is_object else fell,
                group=group,
                fell=fell,
                seen=[recording.meta["seen"] for recording in recordings],
                part=[_PARTS[trial.parent.name] for trial in trials],
            ),
        )
        classes = objects if is_object else ["held", "dropped"]
        names = [f"{trial.parent.name}/{trial.name}" for trial in trials]
        return data, {"class": classes, "group": objects, "trial": names}

    def _stack_fingers(self, tactile: np.ndarray) -> np.ndarray:
        if not self.stacked:
            return tactile
        fingers = tactile.reshape(len(tactile), -1, _TAXELS_PER_FINGER, tactile.shape[-1])
        return fingers.swapaxes(1, 2).reshape(len(tactile), _TAXELS_PER_FINGER, -1)


def _trials(folder: Path) -> list[Path]:
    trials = []
    for part in _PARTS:
        trials += sorted(path for path in (folder / part).glob("data_sample_*") if path.is_dir())
    return trials
