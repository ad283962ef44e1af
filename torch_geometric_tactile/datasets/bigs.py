r"""The BiGS data set of grasps with three BioTac fingertips."""

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import Recording, StaticData
from torch_geometric_tactile.datasets._grasp_reader import JOINT, SIGNALS, GraspReader
from torch_geometric_tactile.datasets._trial_frames import TrialFrames
from torch_geometric_tactile.io import BiGSFormat, read_bigs, read_recording
from torch_geometric_tactile.sensors import biotac

_SUFFIXES = (".h5", ".hdf5", ".npz")
_PATTERN = r"(?P<object>.+)_(?P<trial>\d+)"
_ROUNDING = 1e-6  # seconds
_JOINT_SIGNALS = ("finger_joint", "robot_joint", "wrench")  # possible parts of 'joint'


class BiGS(TrialFrames):
    r"""The BiGS data set of the "Tactile Grasp Stability Classification Based on Graph
    Convolutional Networks" paper, or a data set of the same form. Three BioTac fingertips grasp an
    object, lift it and shake it; the grasp holds or fails.

    **No public copy, file format or reading code of the original could be found.** This class reads
    a neutral format of this package, HDF5 or npz with one grasp per file, which ``docs/bigs.md``
    describes. Whoever has the original converts it with ``tactile convert bigs``.

    A sample is a frame of 19 electrodes with three channels, the left, middle and right finger, in
    raw counts. Each frame has these attributes:

    * :obj:`y`: 1 if the grasp succeeded (the positive class), 0 if it failed;
    * :obj:`trial` (the grasp), :obj:`group` (the object) and, if all files name one,
      :obj:`session`;
    * :obj:`time` and :obj:`pickup_time` (when lifting begins, NaN if unknown), in seconds from the
      start of the file;
    * :obj:`phase`, an index into :obj:`phase_names`, and :obj:`slip`, which is 1 from the onset of
      slip on; both are -1 where unknown.

    These signals are present if the files have them: :obj:`pressure` (counts), :obj:`pac`
    (vibration, 22 counts per frame of 1 / 100 s), :obj:`robot_joint` (radians, 3 samples per
    frame), :obj:`joint` (of the fingers, 3 samples per frame, concatenated), :obj:`wrench` (force
    and torque of the wrist, newtons and newton metres) and :obj:`object_pose` (position in metres,
    quaternion w, x, y, z). There are no edges without a :obj:`pre_transform` such as
    :class:`~torch_geometric_tactile.transforms.KNNGraph`.

    The shake after the lift decides the label :obj:`y`, so a model that predicts it must not see
    the shake. Frames later than :obj:`until` seconds after the start of the pick-up are left out.

    .. list-table:: STATS, of the original as published
        :header-rows: 1

        * - object
          - #trials
          - success
          - #nodes
          - #features
          - #classes
        * - cylinder
          - 1,000
          - 54 %
          - 19
          - 3
          - 2
        * - box
          - 500
          - 31 %
          - 19
          - 3
          - 2
        * - ball
          - 500
          - 52.6 %
          - 19
          - 3
          - 2

    All files are processed once; :obj:`until` selects from the memory-mapped processed file. The
    data set may be larger than memory, unless a :obj:`pre_transform` or :obj:`pre_filter` is used.

    Shapes:
        - **x:** counts :math:`(S, 19, 3)`, NaN where missing
        - **pressure:** counts :math:`(S, 3)`
        - **pac:** counts :math:`(S, 3, 22)`
        - **robot_joint:** radians :math:`(S, 3, J)`
        - **joint:** radians :math:`(S, 3 J)`, or the signals in :obj:`joint_signals`
        - **wrench:** newtons and newton metres :math:`(S, 6)`
        - **object_pose:** metres and a unit quaternion :math:`(S, 7)`

    Args:
        root (str or PathLike, optional): Folder of the data set. Its files are in the subfolder
            :obj:`raw` or directly in it. They are named ``<object>_<number>.h5``, or have object
            and trial in their metadata. By default :obj:`$TACTILE_DATA/BiGS`, or a folder in the
            user's cache if that variable is not set.
        fields (Mapping of str to str, optional): For files that are not in the neutral format: the
            names of their fields for each field of
            :class:`~torch_geometric_tactile.io.BiGSFormat`. Units and rates must be the defaults of
            that class.
        signals (sequence of str, optional): Which of :obj:`"pressure"`, :obj:`"pac"`,
            :obj:`"robot_joint"`, :obj:`"finger_joint"`, :obj:`"wrench"` and :obj:`"object_pose"` to
            read. All files must have them. By default the signals of the first file.
        joint_signals (sequence of str): The signals that are concatenated in :obj:`joint`, which
            models use as joint angles: some of :obj:`"finger_joint"`, :obj:`"robot_joint"` and
            :obj:`"wrench"`. All files must have them, except for the default.
        until (float, optional): End of the used frames in seconds after the start of the pick-up;
            2 in the paper. With :obj:`None` all frames are used, including the shake. Files without
            a pick-up time must have :obj:`ends_after_pickup` in their metadata, at most
            :obj:`until`.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no files.
        ValueError: If a file cannot be read, is not a grasp of three fingers with 19 electrodes,
            lacks a signal of the other files, holds the same trial as another file, or has no
            pick-up time.

    Examples:
        >>> dataset = BiGS("bigs")  # doctest: +SKIP
        >>> dataset.class_names  # doctest: +SKIP
        ['failure', 'success']
    """

    suffixes = _SUFFIXES
    selection_args = ("until",)
    _content = "content=2"
    _folder = "BiGS"

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        fields: Mapping[str, str] | None = None,
        signals: Sequence[str] | None = None,
        joint_signals: Sequence[str] = JOINT,
        until: float | None = 2.0,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = biotac()
        self.fields = None if fields is None else dict(fields)
        self.signals = None if signals is None else _checked_names("signals", signals, SIGNALS)
        self.joint_signals = _checked_joint(joint_signals, self.signals)
        self.until = _checked_until(until)
        self.pattern = _PATTERN
        self._format = None if fields is None else BiGSFormat(fields=fields)
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        if self.until is not None:
            self._select_until(self.until)

    @property
    def processed_file_names(self) -> str:
        r"""The processed file; each choice of :obj:`joint_signals` has a separate one."""
        names = "" if tuple(self.joint_signals) == JOINT else "_" + "_".join(self.joint_signals)
        return f"bigs{names}.pt"

    def _no_files(self) -> str:
        return (
            f"there are no grasps in '{self.raw_dir}' or '{self.root}': put files there, "
            f"<object>_<number> with one of {', '.join(_SUFFIXES)}. No public copy of the original "
            "was found; whoever has it makes such files with: tactile convert bigs IN... OUT_DIR"
        )

    def read_trial(self, path: PathLike) -> Recording:
        r"""Reads the grasp in a file.

        Args:
            path (str or PathLike): The file.
        """
        return read_recording(path) if self._format is None else read_bigs(path, self._format)

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all grasps."""
        reader = GraspReader(self.layout, self.pattern, self.signals, self.joint_signals)
        columns, names = reader.read(self._read_trials(), Path(self.processed_dir))
        data = StaticData(**columns, pos=self.layout.pos, normal=self.layout.normal)
        return data, names

    def _select_until(self, until: float) -> None:
        pickup = self._data.pickup_time
        unknown = pickup.isnan()
        ends = self._names["ends_after_pickup"]
        late = [
            self.trial_names[i]
            for i in self._data.trial[unknown].unique().tolist()
            if not ends[i] or float(ends[i]) > until + _ROUNDING
        ]
        if late:
            raise ValueError(
                f"{len(late)} grasps in '{self.root}' must have 'pickup_time' in their metadata, "
                f"the start of the pick-up, or 'ends_after_pickup' of at most {until:g} s (got "
                f"neither in '{late[0]}'): add it, or choose until=None, with which a model may "
                "see the shake that decides the outcome"
            )
        mask = unknown | (self._data.time <= pickup + until + _ROUNDING)
        if not mask.all():
            self._indices = mask.nonzero().view(-1).tolist()


def _checked_until(until: float | None) -> float | None:
    is_number = isinstance(until, int | float) and not isinstance(until, bool)
    if until is not None and not (is_number and math.isfinite(until) and until >= 0):
        raise ValueError(f"'until' must be seconds, at least 0, or None (got {until!r})")
    return None if until is None else float(until)


def _checked_names(argument: str, names: Sequence[str], options: Collection[str]) -> list[str]:
    # A single text is an iterable of its letters, so it is an error.
    items = [] if isinstance(names, str) else list(names)
    if isinstance(names, str) or not set(items) <= set(options) or len(set(items)) < len(items):
        raise ValueError(f"'{argument}' must be some of {[*options]} (got {names!r})")
    return items


def _checked_joint(joint_signals: Sequence[str], signals: list[str] | None) -> list[str]:
    names = _checked_names("joint_signals", joint_signals, _JOINT_SIGNALS)
    need(names, f"'joint_signals' must be some of {[*_JOINT_SIGNALS]}", repr(joint_signals))
    missing = [name for name in names if signals is not None and name not in signals]
    if missing and tuple(names) != JOINT:
        raise ValueError(f"'signals' must have {missing[0]!r} of 'joint_signals' (got {signals!r})")
    return names
