r"""Grasps with three BioTac fingertips, from closing to shaking."""

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
_OF_JOINT = ("finger_joint", "robot_joint", "wrench")


class BiGS(TrialFrames):
    r"""The BiGS data set of the "Tactile Grasp Stability Classification Based on Graph
    Convolutional Networks" paper, or one of the same form: grasps with three BioTac fingertips that
    close, lift and shake an object, which holds or falls.

    **No public copy, file format or reading code of the original could be found.** The files of
    this class are of a neutral form of this package's own, one grasp a file, HDF5 or npz, described
    in ``docs/bigs.md``: a holder of the original makes them with ``tactile convert bigs``.

    A sample is a frame: 19 electrodes with three channels, the left, middle and right finger, in
    raw counts. :obj:`y` is 1 where the grasp succeeded, the positive class, and 0 where it failed;
    :obj:`trial` numbers the grasps, :obj:`group` the objects and, if all files name one,
    :obj:`session` the sessions; :obj:`time` and :obj:`pickup_time` (when lifting begins, NaN if
    unknown) are seconds from the start of the file; :obj:`phase` (of :obj:`phase_names`) is -1
    where unknown, and so is :obj:`slip`, which is 1 from the onset of slip on. What the files have
    of the following is there as well: :obj:`pressure` (counts), :obj:`pac` (vibration, 22 counts a
    frame of 1 / 100 s), :obj:`robot_joint` (radians, 3 a frame), :obj:`joint` (those of the
    fingers, 3 a frame one after the other), :obj:`wrench` (force and torque of the wrist, newtons
    and newton metres) and :obj:`object_pose` (position in metres, quaternion w, x, y, z). Without a
    :obj:`pre_transform` such as :class:`~torch_geometric_tactile.transforms.KNNGraph` there are no
    edges.

    The shake after the lift decides what :obj:`y` is. A model that is to predict it must not see
    it: frames later than :obj:`until` seconds after pick-up begins are left out.

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
    frames are never in memory all at once, unless a :obj:`pre_transform` or :obj:`pre_filter` takes
    them there.

    Shapes:
        - **x:** counts :math:`(S, 19, 3)`, NaN where missing
        - **pressure:** counts :math:`(S, 3)`
        - **pac:** counts :math:`(S, 3, 22)`
        - **robot_joint:** radians :math:`(S, 3, J)`
        - **joint:** radians :math:`(S, 3 J)`, or what :obj:`joint_signals` names
        - **wrench:** newtons and newton metres :math:`(S, 6)`
        - **object_pose:** metres and a unit quaternion :math:`(S, 7)`

    Args:
        root (str or PathLike, optional): Folder of the data set; its files, named
            ``<object>_<number>.h5`` or with object and trial in their metadata, are in its folder
            :obj:`raw` or in itself. If left out, :obj:`$TACTILE_DATA/BiGS` or a folder in the
            user's cache.
        fields (Mapping of str to str, optional): For files that are not in the neutral form, the
            names of their fields by ours, see :class:`~torch_geometric_tactile.io.BiGSFormat`; of
            the units and rates that are the default there.
        signals (sequence of str, optional): Which of :obj:`"pressure"`, :obj:`"pac"`,
            :obj:`"robot_joint"`, :obj:`"finger_joint"`, :obj:`"wrench"` and :obj:`"object_pose"` to
            read, which all files must have; those of the first file if left out.
        joint_signals (sequence of str): What stands side by side in :obj:`joint`, which models take
            as joint angles: some of :obj:`"finger_joint"`, :obj:`"robot_joint"` and
            :obj:`"wrench"`. More than the default must be in all files.
        until (float, optional): Seconds after pick-up begins at which the frames end, 2 in the
            paper; all frames with :obj:`None`, the shake as well. A file that knows no time of
            pick-up must say in its metadata, as :obj:`ends_after_pickup`, that it ends by then.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no files.
        ValueError: If a file cannot be read, is no grasp of three fingers with 19 electrodes, lacks
            a signal that others have, holds a trial that another one holds, or does not tell when
            pick-up begins.

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
        r"""One file for each choice of :obj:`joint_signals`."""
        names = "" if tuple(self.joint_signals) == JOINT else "_" + "_".join(self.joint_signals)
        return f"bigs{names}.pt"

    def _no_files(self) -> str:
        return (
            f"there are no grasps in '{self.raw_dir}' or '{self.root}': put files there, "
            f"<object>_<number> with one of {', '.join(_SUFFIXES)}. We found no copy of the "
            "original; whoever has it makes such files with: tactile convert bigs IN... OUT_DIR"
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
        columns, names = reader.read(self._opened(), Path(self.processed_dir))
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
                f"{len(late)} grasps in '{self.root}' must tell when pick-up begins, as "
                f"'pickup_time' in their metadata, or that they end by {until:g} s after it, as "
                f"'ends_after_pickup' (got neither in '{late[0]}'): add it, or choose until=None, "
                "with which a model may see the shake that decides the outcome"
            )
        kept = unknown | (self._data.time <= pickup + until + _ROUNDING)
        if not kept.all():
            self._indices = kept.nonzero().view(-1).tolist()


def _checked_until(until: float | None) -> float | None:
    is_number = isinstance(until, int | float) and not isinstance(until, bool)
    if until is not None and not (is_number and math.isfinite(until) and until >= 0):
        raise ValueError(f"'until' must be seconds, at least 0, or None (got {until!r})")
    return None if until is None else float(until)


def _checked_names(argument: str, names: Sequence[str], known: Collection[str]) -> list[str]:
    listed = [] if isinstance(names, str) else list(names)
    if isinstance(names, str) or not set(listed) <= set(known) or len(set(listed)) < len(listed):
        raise ValueError(f"'{argument}' must be some of {[*known]} (got {names!r})")
    return listed


def _checked_joint(joint_signals: Sequence[str], signals: list[str] | None) -> list[str]:
    listed = _checked_names("joint_signals", joint_signals, _OF_JOINT)
    need(listed, f"'joint_signals' must be some of {[*_OF_JOINT]}", repr(joint_signals))
    missing = [name for name in listed if signals is not None and name not in signals]
    if missing and tuple(listed) != JOINT:
        raise ValueError(f"'signals' must have {missing[0]!r} of 'joint_signals' (got {signals!r})")
    return listed
