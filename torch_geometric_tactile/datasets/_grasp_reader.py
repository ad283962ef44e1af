r"""Conversion of a sequence of recordings, one grasp each, to frames on disk."""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets._frame_reader import FrameFiles
from torch_geometric_tactile.datasets._trial import Trial, check_unique_trials, make_trial
from torch_geometric_tactile.sensors import TaxelLayout

OUTCOMES = ("failure", "success")
FINGERS = ("left", "middle", "right")
#: Names of the signals in the files, with the shape of a frame. :obj:`None` is any size.
SIGNALS: Mapping[str, tuple[int | None, ...]] = {
    "pressure": (len(FINGERS),),
    "pac": (len(FINGERS), None),
    "robot_joint": (None, None),
    "finger_joint": (None, None),
    "wrench": (6,),
    "object_pose": (7,),
}
#: The default signals in :obj:`joint`.
JOINT = ("finger_joint",)


class GraspReader:
    r"""Reads grasps and stores their frames on disk."""

    def __init__(
        self,
        layout: TaxelLayout,
        pattern: str,
        signals: Sequence[str] | None = None,
        joint_signals: Sequence[str] = JOINT,
    ) -> None:
        self.layout = layout
        self.joint_signals = joint_signals
        self.pattern = pattern
        self.signals = signals
        self.phase_names: list[str] = []

    def read(
        self, recordings: Iterable[tuple[str, str, Recording]], folder: Path | None
    ) -> tuple[dict[str, Tensor], dict[str, list[str]]]:
        r"""Returns the attributes of all frames, mapped from temporary files, and the names of
        their classes.
        """
        with FrameFiles(folder) as files:
            grasps = [self._add_grasp(files, *recording) for recording in recordings]
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
                "y": [OUTCOMES.index(str(grasp.label)) for grasp in grasps],
                "trial": range(len(grasps)),
                "group": [names["group"].index(str(grasp.object_name)) for grasp in grasps],
            }
            if names["session"]:
                columns["session"] = [
                    names["session"].index(str(grasp.meta["session"])) for grasp in grasps
                ]
            for name, values in columns.items():
                for value, grasp in zip(values, grasps, strict=True):
                    files.add(name, np.full(grasp.num_frames, value))
            attributes = {name: files.tensor(name) for name in files}
        parts = [attributes[name].flatten(1) for name in self.joint_signals if name in attributes]
        need(
            tuple(self.joint_signals) == JOINT or len(parts) == len(self.joint_signals),
            "the files must hold all of 'joint_signals'",
            f"{[name for name in SIGNALS if name in attributes]}, not {list(self.joint_signals)}",
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
            "class": list(OUTCOMES),
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
        if recording.num_channels != len(FINGERS):
            raise ValueError(
                f"{where} must have {len(FINGERS)} channels per taxel, the fingers "
                f"{', '.join(FINGERS)} (got {recording.num_channels})"
            )
        if trial.label not in OUTCOMES:
            raise ValueError(
                f"{where} must have the label 'success' or 'failure' (got {trial.label!r})"
            )
        if recording.meta.get("unit", "count") != "count":
            raise ValueError(f"{where} must have the unit 'count' (got {recording.meta['unit']!r})")
        time = recording.time - recording.time[0]
        pickup = _seconds(where, recording.meta, "pickup_time")
        if pickup is not None and not recording.time[0] <= pickup <= recording.time[-1]:
            raise ValueError(
                f"{where} must have in its metadata a 'pickup_time' on the clock of 'time', "
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
            self.signals = [name for name in SIGNALS if name in signals]
        for name in self.signals:
            if name not in signals:
                raise ValueError(
                    f"{where} must hold '{name}', as the other files do (got "
                    f"{sorted(signals) or 'none'}): add it, or name the signals that all files "
                    "have, as in signals=['pressure']"
                )
            signal, shape = signals[name], SIGNALS[name]
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
    # Some files mark only the frames in which the object moves; slip lasts from its onset on.
    return np.maximum.accumulate(slip.astype(np.int64))
