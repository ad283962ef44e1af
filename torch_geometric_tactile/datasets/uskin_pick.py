r"""The data set of boxes that are moved by a gripper with uSkin."""

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
    :func:`~torch_geometric_tactile.sensors.uskin_gripper`) with three channels in raw counts. It
    has the seven joint angles :obj:`joint` in radians, :obj:`end_effector` (position in metres and
    quaternion x, y, z, w) and the gripper opening :obj:`finger` as published. :obj:`trial` is the
    folder, :obj:`group` the object, and :obj:`time` is in seconds from the start, at the rate of
    the trial. :obj:`fell` is 1 in all frames of a trial whose object fell. :obj:`seen` is 1 if the
    authors list its object as seen in training. ``Protocol("given")`` uses the attribute
    :obj:`part`, the authors' folders ``train`` and ``test``.

    .. warning::
        **Rows repeat.** The log, at about 40 rows per second, is faster than the sensors: 75 % of
        the rows repeat the readings of the previous row, up to six times, so that a random split
        of frames has the same readings in training and test. :obj:`repeats=False` leaves 12,964
        frames, about 10 per second. Hold out trials (``Protocol("trial", stratify="y")``) or
        objects (``Protocol("group", ...)``). **The published test part mixes two questions**: it
        was recorded a day later, with trials of one object of the training part (7, :obj:`seen` is
        1) and of two objects that training lacks (9 and 11); report both scores. :obj:`fell` is a
        label of the complete trial: in the first frames the fall is in the future.

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

    These numbers are those of commit ``ed8c1a0``, with trials of 132 to 3,785 rows. The object fell
    in 24 trials. The test part has nine trials of object 11 and seven each of 7 and 9; ten fell.

    The repository names no licence. The files are therefore neither downloaded nor part of this
    package: get them with ``git clone``, and check whether you may use them.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its folders ``train`` and ``test``
            are in the subfolder :obj:`raw` or :obj:`tactile_prediction_flat_dataset`, or directly
            in it. By default :obj:`$TACTILE_DATA/USkinPick`, or a folder in the user's cache if
            that variable is not set.
        target (str): Label :obj:`y`: :obj:`"dropped"`, or the class index of the :obj:`"object"`.
        repeats (bool): Whether to keep frames that repeat the readings of the previous frame.
        stacked (bool): Whether to stack the channels of the two patches, for models of several
            equal fingers such as :class:`~torch_geometric_tactile.nn.models.GraspGCN`: 16 taxels
            with six channels, first those of the first finger.
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
        a separate one.
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
