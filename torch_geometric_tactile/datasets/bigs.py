r"""The BiGS data set of grasps with three BioTac fingertips."""

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import Recording, StaticData
from torch_geometric_tactile.data._sample_units import trial_units
from torch_geometric_tactile.datasets._frame_reader import (
    FrameFiles,
    UnreadRecording,
    raise_all,
)
from torch_geometric_tactile.datasets._trial import (
    DEFAULT_PATTERN,
    Trial,
    check_unique_trials,
    make_trial,
)
from torch_geometric_tactile.datasets._trial_frames import TrialFrames
from torch_geometric_tactile.io import BiGSFormat, read_bigs, read_recording
from torch_geometric_tactile.sensors import TaxelLayout, biotac

_SUFFIXES = (".h5", ".hdf5", ".npz")
_ROUNDING = 1e-6  # seconds
_JOINT_SIGNALS = ("finger_joint", "robot_joint", "wrench")  # possible parts of 'joint'
_OUTCOMES = ("failure", "success")
_FINGERS = ("left", "middle", "right")
# Names of the signals in the files, with the shape of a frame. None allows any size.
_SIGNALS: Mapping[str, tuple[int | None, ...]] = {
    "pressure": (len(_FINGERS),),
    "pac": (len(_FINGERS), None),
    "robot_joint": (None, None),
    "finger_joint": (None, None),
    "wrench": (6,),
    "object_pose": (7,),
}
_DEFAULT_JOINT = ("finger_joint",)


class BiGS(TrialFrames):
    r"""The BiGS data set of the "Tactile Grasp Stability Classification Based on Graph
    Convolutional Networks" paper, or a data set of the same form. Three BioTac fingertips grasp an
    object, lift it and shake it; the grasp holds or fails.

    **No public copy, file format or reading code of the original could be found.** This class reads
    a neutral format of this package: HDF5 or npz files with one grasp per file, as described in
    ``docs/bigs.md``. If you have the original, convert it with ``tactile convert bigs``.

    A sample is a frame of 19 electrodes with three channels in raw counts. The channels are the
    left, middle and right finger. Each frame has these attributes:

    * :obj:`y`: 1 if the grasp succeeded (the positive class), 0 if it failed;
    * :obj:`trial` (the grasp), :obj:`group` (the object) and, if all files name one,
      :obj:`session`;
    * :obj:`time` and :obj:`pickup_time` (when lifting begins, NaN if unknown), in seconds from the
      start of the file;
    * :obj:`phase`, an index into :obj:`phase_names`, and :obj:`slip`, which is 1 from the onset of
      slip on; both are -1 where unknown.

    These signals are present if the files contain them:

    * :obj:`pressure`: counts;
    * :obj:`pac`: vibration, 22 counts per frame of 1 / 100 s;
    * :obj:`robot_joint`: radians, 3 samples per frame;
    * :obj:`joint`: joint angles of the fingers, 3 samples per frame, concatenated;
    * :obj:`wrench`: force and torque at the wrist in newtons and newton metres;
    * :obj:`object_pose`: position in metres and quaternion w, x, y, z.

    The layout has no edges. To add edges, use a :obj:`pre_transform` such as
    :class:`~torch_geometric_tactile.transforms.KNNGraph`.

    The shake after the lift decides the label :obj:`y`, so a model that predicts the label must not
    see the shake. Frames later than :obj:`until` seconds after the start of the pick-up are left
    out.

    .. list-table:: STATS of the original, as published
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
            :obj:`raw` or directly in it. They are named ``<object>_<number>.h5``, or name object
            and trial in their metadata. The default is :obj:`$TACTILE_DATA/BiGS`, or a folder in
            the user's cache if that variable is not set.
        fields (Mapping of str to str, optional): For files that are not in the neutral format, the
            name in the file of each field of :class:`~torch_geometric_tactile.io.BiGSFormat`. Units
            and rates must be the defaults of that class.
        signals (sequence of str, optional): The signals to read: some of :obj:`"pressure"`,
            :obj:`"pac"`, :obj:`"robot_joint"`, :obj:`"finger_joint"`, :obj:`"wrench"` and
            :obj:`"object_pose"`. All files must contain them. The default is the signals of the
            first file.
        joint_signals (sequence of str): The signals that are concatenated in :obj:`joint`, which
            models use as joint angles: some of :obj:`"finger_joint"`, :obj:`"robot_joint"` and
            :obj:`"wrench"`. All files must contain them, except for the default.
        until (float, optional): Time after the start of the pick-up, in seconds, at which the used
            frames end; the paper uses 2. With :obj:`None`, all frames are used, including the
            shake. Files without a pick-up time must state :obj:`ends_after_pickup` in their
            metadata, and it must be at most :obj:`until`.
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
    _content = "content=3"
    _folder = "BiGS"

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        fields: Mapping[str, str] | None = None,
        signals: Sequence[str] | None = None,
        joint_signals: Sequence[str] = _DEFAULT_JOINT,
        until: float | None = 2.0,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = biotac()
        self.fields = None if fields is None else dict(fields)
        self.signals = None if signals is None else _checked_names("signals", signals, _SIGNALS)
        self.joint_signals = _checked_joint(joint_signals, self.signals)
        self.until = _checked_until(until)
        self.pattern = DEFAULT_PATTERN
        self._format = None if fields is None else BiGSFormat(fields=fields)
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        if self.until is not None:
            self._select_until(self.until)

    @property
    def processed_file_names(self) -> str:
        r"""The processed file. Each choice of :obj:`joint_signals` has a separate file."""
        names = (
            ""
            if tuple(self.joint_signals) == _DEFAULT_JOINT
            else "_" + "_".join(self.joint_signals)
        )
        return f"bigs{names}.pt"

    def _no_files(self) -> str:
        return (
            f"there are no grasps in '{self.raw_dir}' or '{self.root}': put files there, "
            f"<object>_<number> with one of {', '.join(_SUFFIXES)}. No public copy of the original "
            "was found; if you have it, convert it with: tactile convert bigs IN... OUT_DIR"
        )

    def read_trial(self, path: PathLike) -> Recording:
        r"""Reads the grasp in a file.

        Args:
            path (str or PathLike): The file.
        """
        return read_recording(path) if self._format is None else read_bigs(path, self._format)

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all grasps."""
        reader = _GraspReader(self.layout, self.pattern, self.signals, self.joint_signals)
        columns, names = reader.read(self._trials_to_read(), Path(self.processed_dir))
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
                f"neither in '{late[0]}'): add it, or choose until=None, which lets a model see "
                "the shake that decides the outcome"
            )
        mask = unknown | (self._data.time <= pickup + until + _ROUNDING)
        if not mask.all():
            self._indices = mask.nonzero().view(-1).tolist()


class _GraspReader:
    r"""Reads grasps and stores their frames on disk."""

    def __init__(
        self,
        layout: TaxelLayout,
        pattern: str,
        signals: Sequence[str] | None = None,
        joint_signals: Sequence[str] = _DEFAULT_JOINT,
    ) -> None:
        self.layout = layout
        self.joint_signals = joint_signals
        self.pattern = pattern
        self.signals = signals
        self.phase_names: list[str] = []

    def read(
        self, recordings: Sequence[UnreadRecording], folder: Path | None
    ) -> tuple[dict[str, Tensor], dict[str, list[str]]]:
        r"""Returns the attributes of all frames, mapped from temporary files, and the names of
        their classes.
        """
        with FrameFiles(folder) as files:
            grasps: list[Trial] = []
            errors: list[ValueError] = []
            for unread in recordings:
                try:
                    grasps.append(self._add_grasp(files, unread.where, unread.name, unread.read()))
                except ValueError as error:
                    errors.append(error)
            raise_all(errors, len(recordings))
            need(grasps, "there must be at least one grasp (got none)")
            check_unique_trials(
                (
                    (t.object_name, t.number, t.meta.get("session")),
                    f"trial {t.number} of '{t.object_name}'",
                    t.where,
                )
                for t in grasps
                if t.number is not None
            )
            names = self._names(grasps)
            columns = {
                "y": [_OUTCOMES.index(str(grasp.label)) for grasp in grasps],
                "trial": range(len(grasps)),
                "group": [names["group"].index(str(grasp.object_name)) for grasp in grasps],
            }
            if names["session"]:
                columns["session"] = [
                    names["session"].index(str(grasp.meta["session"])) for grasp in grasps
                ]
            names |= trial_units([grasp.meta for grasp in grasps], columns)
            for name, values in columns.items():
                for value, grasp in zip(values, grasps, strict=True):
                    files.add(name, np.full(grasp.num_frames, value))
            attributes = {name: files.tensor(name) for name in files}
        parts = [attributes[name].flatten(1) for name in self.joint_signals if name in attributes]
        need(
            tuple(self.joint_signals) == _DEFAULT_JOINT or len(parts) == len(self.joint_signals),
            "the files must hold all of 'joint_signals'",
            f"{[name for name in _SIGNALS if name in attributes]}, not {list(self.joint_signals)}",
        )
        if parts:
            # A single part stays memory-mapped.
            attributes["joint"] = parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
        attributes.pop("finger_joint", None)
        return attributes, names

    def _names(self, grasps: Sequence[Trial]) -> dict[str, list[str]]:
        sessions = {grasp.meta.get("session") for grasp in grasps}
        # Integers are sorted before texts, since the two cannot be compared.
        ordered = sorted(sessions - {None}, key=lambda s: (isinstance(s, str), s))
        ends = [_seconds(grasp.where, grasp.meta, "ends_after_pickup") for grasp in grasps]
        return {
            "class": list(_OUTCOMES),
            "group": sorted({str(grasp.object_name) for grasp in grasps}),
            "trial": [grasp.name for grasp in grasps],
            "session": [] if None in sessions else list(dict.fromkeys(map(str, ordered))),
            "phase": self.phase_names,
            "property": [],
            "synthetic": [grasp.name for grasp in grasps if grasp.meta.get("synthetic", False)],
            "ends_after_pickup": ["" if end is None else repr(end) for end in ends],
        }

    def _add_grasp(self, files: FrameFiles, where: str, name: str, recording: Recording) -> Trial:
        trial = self._trial(where, name, recording)
        if recording.num_channels != len(_FINGERS):
            raise ValueError(
                f"{where} must have {len(_FINGERS)} channels per taxel, the fingers "
                f"{', '.join(_FINGERS)} (got {recording.num_channels})"
            )
        if trial.label not in _OUTCOMES:
            raise ValueError(
                f"{where} must have the label 'success' or 'failure' (got {trial.label!r})"
            )
        if recording.meta.get("unit", "count") != "count":
            raise ValueError(f"{where} must have the unit 'count' (got {recording.meta['unit']!r})")
        time = recording.time - recording.time[0]
        pickup = _seconds(where, recording.meta, "pickup_time")
        if pickup is not None and not recording.time[0] <= pickup <= recording.time[-1]:
            raise ValueError(
                f"{where} must have a 'pickup_time' on the clock of 'time' in its metadata, "
                f"{float(recording.time[0])} to {float(recording.time[-1])} s (got {pickup})"
            )
        relative_pickup = math.nan if pickup is None else pickup - float(recording.time[0])
        files.add("x", recording.tactile)
        files.add("time", time)
        files.add("pickup_time", np.full(len(time), relative_pickup))
        files.add("phase", self._phase(trial))
        files.add("slip", _slip(where, recording))
        self._add_signals(files, where, recording)
        # Checked here so that the error comes before the remaining files are read.
        _seconds(where, recording.meta, "ends_after_pickup")
        return trial

    def _trial(self, where: str, name: str, recording: Recording) -> Trial:
        phase = {k: v for k, v in recording.privileged.items() if k == "phase"}
        # A trial holds its arrays in memory, so the signals are removed first.
        reduced = dataclasses.replace(recording, joint=None, privileged=phase, extra={})
        return make_trial(
            reduced, self.layout, where=where, name=name, pattern=self.pattern, needs=("object",)
        )

    def _phase(self, trial: Trial) -> np.ndarray:
        self.phase_names += [n for n in trial.phase_names if n not in self.phase_names]
        return trial.numbered_phase(self.phase_names).numpy()

    def _add_signals(self, files: FrameFiles, where: str, recording: Recording) -> None:
        signals = {**recording.privileged, **recording.extra}
        if self.signals is None:
            self.signals = [name for name in _SIGNALS if name in signals]
        for name in self.signals:
            if name not in signals:
                raise ValueError(
                    f"{where} must hold '{name}', like the other files (got "
                    f"{sorted(signals) or 'none'}): add it, or name the signals that all files "
                    "have, as in signals=['pressure']"
                )
            signal, shape = signals[name], _SIGNALS[name]
            stored_shape = files.shape(name)
            expected = shape if stored_shape is None else stored_shape[1:]
            fits = len(expected) == signal.ndim - 1 and all(
                size in (None, actual) and actual
                for size, actual in zip(expected, signal.shape[1:], strict=True)
            )
            if signal.dtype.kind not in "iuf" or not fits:
                sizes = ", ".join("any" if size is None else str(size) for size in expected)
                raise ValueError(
                    f"{where} must hold numbers of shape ({sizes}) per frame in '{name}' (got "
                    f"{signal.dtype} of shape {signal.shape[1:]})"
                )
            with np.errstate(over="ignore"):
                signal = signal.astype(np.float32)
            if np.isinf(signal).any():
                raise ValueError(f"{where} must hold finite numbers, or NaN, in '{name}' (got inf)")
            files.add(name, signal)


def _seconds(where: str, meta: Mapping[str, Any], key: str) -> float | None:
    value = meta.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
        raise ValueError(f"{where} must have seconds in '{key}' in its metadata (got {value!r})")
    return float(value)


def _slip(where: str, recording: Recording) -> np.ndarray:
    slip = recording.privileged.get("slip")
    if slip is None:
        return np.full(recording.num_frames, -1)
    if slip.ndim != 1 or slip.dtype.kind not in "biuf" or not np.isin(slip, (-1, 0, 1)).all():
        raise ValueError(
            f"{where} must hold 0, 1 or, where unknown, -1 for each frame in 'slip' (got "
            f"{slip.dtype} of shape {slip.shape})"
        )
    # Some files only mark frames in which the object moves; here, slip continues after its onset.
    return np.maximum.accumulate(slip.astype(np.int64))


def _checked_until(until: float | None) -> float | None:
    is_number = isinstance(until, int | float) and not isinstance(until, bool)
    if until is not None and not (is_number and math.isfinite(until) and until >= 0):
        raise ValueError(f"'until' must be a number of seconds from 0 on, or None (got {until!r})")
    return None if until is None else float(until)


def _checked_names(argument: str, names: Sequence[str], options: Collection[str]) -> list[str]:
    # A single text would be read as a list of its letters, so it raises an error.
    items = [] if isinstance(names, str) else list(names)
    if isinstance(names, str) or not set(items) <= set(options) or len(set(items)) < len(items):
        raise ValueError(f"'{argument}' must be some of {[*options]} (got {names!r})")
    return items


def _checked_joint(joint_signals: Sequence[str], signals: list[str] | None) -> list[str]:
    names = _checked_names("joint_signals", joint_signals, _JOINT_SIGNALS)
    need(names, f"'joint_signals' must be some of {[*_JOINT_SIGNALS]}", repr(joint_signals))
    missing = [name for name in names if signals is not None and name not in signals]
    if missing and tuple(names) != _DEFAULT_JOINT:
        raise ValueError(f"'signals' must have {missing[0]!r} of 'joint_signals' (got {signals!r})")
    return names
