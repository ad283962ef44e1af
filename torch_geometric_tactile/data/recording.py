r"""The readings of one trial."""

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from torch_geometric_tactile.data._annotations import annotations_within, checked_annotations
from torch_geometric_tactile.data._gaps import RATE_TOLERANCE, gaps_of
from torch_geometric_tactile.data._recording_arrays import (
    check_frames,
    check_utf8,
    checked_numbers,
    checked_rows,
    checked_time,
)
from torch_geometric_tactile.data._resampled import resampled_values
from torch_geometric_tactile.data.annotation import Annotation
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.frame_rate import measure_rate

if TYPE_CHECKING:  # a live robot has recordings without torch
    from torch_geometric_tactile.sensors import TaxelLayout

#: Units of readings, and their labels in figures and reports.
UNITS = {"count": "counts", "newton": "N", "microtesla": "µT"}
_FULL_TURN = 2 * math.pi * (1 + 1e-6)  # with the rounding of float32


@dataclass(frozen=True, eq=False)
class Recording:
    r"""The readings of one trial on one sensor, with their times, labels and metadata.

    A recording is frozen and is checked when it is constructed. Missing readings and the readings
    of dead taxels are NaN, never made-up numbers. Masked values of masked arrays become NaN as
    well. Arrays of the right type are not copied.

    Args:
        time (numpy.ndarray): Time of each frame in seconds :math:`(T,)`, increasing, counted from
            the start of the trial or from the year 1970. :class:`numpy.datetime64` and
            :class:`numpy.timedelta64` are converted to floating-point numbers.
        tactile (numpy.ndarray): Readings :math:`(T, N, C)`, in the unit that :obj:`meta` names.
        joint (numpy.ndarray, optional): Joint angles in radians :math:`(T, J)`.
        label (str or int, optional): The class of the trial.
        meta (Mapping): Properties of the trial as JSON values. Any key is allowed. These keys have
            a meaning:

            * :obj:`"unit"`: the unit of the readings, :obj:`"count"`, :obj:`"newton"` or
              :obj:`"microtesla"`,
            * :obj:`"object"`, :obj:`"trial"`, :obj:`"sensor"`: the object, the trial and the
              sensor,
            * :obj:`"rate"`: the nominal rate in frames per second,
            * :obj:`"tare"`, :obj:`"calibration"`: the corrections applied to the readings,
            * :obj:`"synthetic"`: whether the readings are simulated,
            * :obj:`"seed"`: the seed of the simulation,
            * :obj:`"joint_names"`, :obj:`"action_names"`: the names of the joints and of the values
              of a command,
            * :obj:`"phase_names"`: the names of the integers in the privileged :obj:`"phase"`,
            * :obj:`"column_names"`: the columns of :obj:`"tactile"` and :obj:`"joint"` in the order
              of their file, see :obj:`read_named_csv`.
        privileged (Mapping of str to numpy.ndarray): Signals that only a simulator has, such as
            forces without noise, the pose of the object and the phase. Each is an array of numbers,
            truth values or texts with :math:`T` rows and at least one value in a row. Names have 1
            to 255 characters, without :obj:`"/"` and NUL.
        extra (Mapping of str to numpy.ndarray): Further signals of a robot, such as the fluid
            pressure or the vibration of a fingertip, with the same rules as :obj:`privileged`. A
            sensor that is faster than the frames stores its values of a frame in further
            dimensions.
        annotations (sequence of Annotation): Labelled spans on the clock of :obj:`time`, as
            :class:`Annotation` or as tuples of start, end and label; at most 10,000. They are
            sorted by their starts and may overlap.
        action (numpy.ndarray, optional): Commands :math:`(T, A)` of a demonstration, in any unit.
            Each row is the last command at or before its frame.

    Raises:
        ValueError: If the dimensions or the number of frames of an array do not fit, the time does
            not increase or holds integers (whose unit is unknown), a time, reading, angle or
            command is infinite, :obj:`meta` holds values that are not JSON values, an annotation
            ends before it starts, or a name, text or shape cannot be stored in HDF5, npz and MCAP
            files.

    Examples:
        >>> Recording(time=[0.0, 0.01, 0.02], tactile=np.zeros((3, 4, 3)), label="cup")
        Recording(num_frames=3, num_taxels=4, num_channels=3, rate=100, label='cup')
    """

    time: np.ndarray
    tactile: np.ndarray
    joint: np.ndarray | None = None
    label: str | int | None = None
    meta: Mapping[str, Any] = field(default_factory=dict)
    privileged: Mapping[str, np.ndarray] = field(default_factory=dict)
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    annotations: Sequence[Annotation] = ()
    action: np.ndarray | None = None

    def __post_init__(self) -> None:
        self._set("time", checked_time(self.time))
        tactile = checked_numbers("tactile", self.tactile, np.float32)
        if tactile.ndim != 3 or 0 in tactile.shape[1:]:
            raise ValueError(
                "'tactile' must have shape (num_frames, num_taxels, num_channels) "
                f"(got {tactile.shape})"
            )
        check_frames("tactile", tactile, self.num_frames)
        infinite = np.argwhere(np.isinf(tactile))
        if len(infinite):
            frame, taxel, channel = infinite[0].tolist()
            raise ValueError(
                "'tactile' must hold finite readings, or NaN where one is missing (got "
                f"{tactile[frame, taxel, channel]} in frame {frame}, taxel {taxel}, "
                f"channel {channel})"
            )
        self._set("tactile", tactile)
        if self.joint is not None:
            joint = self._checked_vectors("joint", "joints", "angles", "joint")
            self._warn_of_degrees(joint)
            self._set("joint", joint)
        self._set("label", _checked_label(self.label))
        self._set("meta", _checked_meta(self.meta))
        for kind in ("privileged", "extra"):
            self._set(kind, checked_rows(kind, getattr(self, kind), self.num_frames))
        self._set("annotations", checked_annotations(self.annotations))
        if self.action is not None:
            self._set("action", self._checked_vectors("action", "commands", "commands", "number"))

    def _set(self, key: str, value: Any) -> None:
        object.__setattr__(self, key, value)

    def _checked_vectors(self, key: str, source: str, contents: str, item: str) -> np.ndarray:
        # Returns a vector for each frame, such as joint angles.
        values = checked_numbers(key, getattr(self, key), np.float32)
        if values.ndim != 2 or values.shape[1] == 0:
            raise ValueError(
                f"'{key}' must have shape (num_frames, num_{key}s), or be None without {source} "
                f"(got {values.shape})"
            )
        check_frames(key, values, self.num_frames)
        infinite = np.argwhere(np.isinf(values))
        if len(infinite):
            frame, index = infinite[0].tolist()
            raise ValueError(
                f"'{key}' must hold finite {contents}, or NaN where one is missing (got "
                f"{values[frame, index]} in frame {frame}, {item} {index})"
            )
        return values

    def _warn_of_degrees(self, joint: np.ndarray) -> None:
        present = np.abs(joint[~np.isnan(joint)])
        if present.size and present.max() > _FULL_TURN:
            warnings.warn(
                f"'joint' must be in radians (got an angle of {present.max():.4g}, more than a "
                "full turn): if these are degrees, convert them with numpy.deg2rad(joint)",
                UserWarning,
                stacklevel=4,
            )

    @property
    def num_frames(self) -> int:
        r"""The number of frames :math:`T`."""
        return len(self.time)

    @property
    def num_taxels(self) -> int:
        r"""The number of taxels :math:`N`."""
        return int(self.tactile.shape[1])

    @property
    def num_channels(self) -> int:
        r"""The number of channels of a taxel :math:`C`."""
        return int(self.tactile.shape[2])

    @property
    def num_joints(self) -> int:
        r"""The number of joints :math:`J`; 0 without joint angles."""
        return 0 if self.joint is None else int(self.joint.shape[1])

    @property
    def num_actions(self) -> int:
        r"""The number of values in a command :math:`A`; 0 without commands."""
        return 0 if self.action is None else int(self.action.shape[1])

    @property
    def duration(self) -> float:
        r"""The time from the first to the last frame, in seconds."""
        return float(self.time[-1] - self.time[0]) if self.num_frames else 0.0

    @property
    def rate(self) -> float:
        r"""Frames per second in the parts without gaps; NaN with fewer than two frames. See
        :func:`~torch_geometric_tactile.data.measure_rate`.
        """
        return measure_rate(self.time).rate

    @property
    def gaps(self) -> np.ndarray:
        r"""The start and the end of each gap in seconds :math:`(G, 2)`: the time of the last frame
        before the gap and the time of the first frame after it. A gap is longer than five times the
        typical time between two arrivals.
        """
        last = gaps_of(self.time, measure_rate(self.time).max_gap)
        return np.stack([self.time[last], self.time[last + 1]], axis=1)

    @property
    def info(self) -> FrameInfo:
        r"""The properties of the frames: their rate, largest gap, unit and column names.

        Raises:
            ValueError: If :obj:`meta["column_names"]` does not name each column once.
        """
        # Imported here, since that module imports this one.
        from torch_geometric_tactile.data._column_order import column_names

        measured = measure_rate(self.time)
        is_measured = math.isfinite(measured.rate)
        return FrameInfo(
            rate=measured.rate if is_measured else None,
            # With few frames, jitter makes the rate less certain.
            tolerance=max(RATE_TOLERANCE, 0.5 / max(self.num_frames - 1, 1)),
            max_gap=measured.max_gap if is_measured else None,
            unit=self.meta.get("unit"),
            columns=column_names(self),
        )

    @property
    def missing(self) -> np.ndarray:
        r"""Whether a taxel lacks a reading in at least one channel :math:`(T, N)`."""
        missing: np.ndarray = np.isnan(self.tactile).any(axis=2)
        return missing

    @property
    def dead_taxels(self) -> np.ndarray:
        r"""The indices of the taxels whose readings are missing in all frames; empty if there are
        no frames.
        """
        if self.num_frames == 0:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(self.missing.all(axis=0))

    def select(self, frames: slice) -> Self:
        r"""Returns a selection of the frames without a copy. Annotations are cut to the time from
        the first to the last selected frame.

        Args:
            frames (slice): The frames; the step must be positive.

        Raises:
            ValueError: If :obj:`frames` is not a slice, or its step is not positive.
        """
        if not isinstance(frames, slice):
            raise ValueError(f"'frames' must be a slice (got {type(frames).__name__})")
        if frames.step is not None and frames.step < 1:
            raise ValueError(f"'frames' must have a positive step (got {frames.step})")
        return type(self)(
            time=self.time[frames],
            tactile=self.tactile[frames],
            joint=None if self.joint is None else self.joint[frames],
            label=self.label,
            meta=self.meta,
            privileged={name: value[frames] for name, value in self.privileged.items()},
            extra={name: value[frames] for name, value in self.extra.items()},
            annotations=annotations_within(self.annotations, self.time[frames]),
            action=None if self.action is None else self.action[frames],
        )

    def resample(self, rate: float) -> Self:
        r"""Returns the recording at another rate. Each part between gaps is resampled separately,
        from its first frame on.

        * At a lower rate, readings, angles and other floating-point values are averaged over each
          new frame, which avoids aliasing. At a higher rate, they are interpolated linearly.
        * Integers, truth values and texts are copied from the nearest frame.
        * A reading is missing (NaN) if the reading of the nearest frame is missing.
        * Actions are copied from the last frame at or before the new frame, since a command stays
          in force until the next one.

        Args:
            rate (float): Frames per second.

        Raises:
            ValueError: If the rate is not positive, or would give more than 100 million frames.
        """
        time, signals = resampled_values(
            self.time,
            {
                "tactile": self.tactile,
                **({} if self.joint is None else {"joint": self.joint}),
                **({} if self.action is None else {"action": self.action}),
                **{f"privileged/{name}": value for name, value in self.privileged.items()},
                **{f"extra/{name}": value for name, value in self.extra.items()},
            },
            rate,
            zero_order_hold=("action",),
        )
        return replace(
            self,
            time=time,
            tactile=signals["tactile"],
            joint=signals.get("joint"),
            action=signals.get("action"),
            meta={**self.meta, "rate": rate},
            privileged={name: signals[f"privileged/{name}"] for name in self.privileged},
            extra={name: signals[f"extra/{name}"] for name in self.extra},
        )

    def check(self, layout: "TaxelLayout") -> None:
        r"""Checks that the recording has one reading for each taxel of a layout.

        Args:
            layout (TaxelLayout): The layout.

        Raises:
            ValueError: If the numbers of taxels differ.
        """
        if self.num_taxels != layout.num_taxels:
            channels, remainder = divmod(self.num_taxels, layout.num_taxels)
            is_flat = self.num_channels == 1 and channels and not remainder
            hint = f": if each taxel has {channels} channels, pass num_channels={channels}"
            raise ValueError(
                f"a recording on layout '{layout.name}' must have {layout.num_taxels} taxels "
                f"(got {self.num_taxels}){hint if is_flat else ''}"
            )

    def __repr__(self) -> str:
        parts = [
            f"num_frames={self.num_frames}",
            f"num_taxels={self.num_taxels}",
            f"num_channels={self.num_channels}",
        ]
        if self.joint is not None:
            parts.append(f"num_joints={self.num_joints}")
        if self.action is not None:
            parts.append(f"num_actions={self.num_actions}")
        if self.extra:
            parts.append(f"extra={sorted(self.extra)}")
        if self.num_frames > 1:
            parts.append(f"rate={self.rate:.4g}")
        if self.label is not None:
            parts.append(f"label={self.label!r}")
        if self.annotations:
            parts.append(f"annotations={len(self.annotations)}")
        return f"{type(self).__name__}({', '.join(parts)})"


def _checked_label(label: Any) -> str | int | None:
    if isinstance(label, np.integer):
        return int(label)
    if isinstance(label, bool) or not isinstance(label, str | int | None):
        raise ValueError(f"'label' must be a text, an integer or None (got {type(label).__name__})")
    if isinstance(label, str):
        check_utf8("'label'", label)
    return label


def _checked_meta(meta: Any) -> dict[str, Any]:
    if not isinstance(meta, Mapping):
        raise ValueError(f"'meta' must be a mapping (got {type(meta).__name__})")
    out: dict[str, Any] = {}
    for key, value in meta.items():
        if not isinstance(key, str):
            raise ValueError(f"'meta' must have texts as keys (got {key!r})")
        try:
            # Tuples become lists, as they do in files, so that a recording is equal to its copy.
            text = json.dumps({key: value}, allow_nan=False, ensure_ascii=False)
            out |= json.loads(text.encode())
        except (RecursionError, TypeError, ValueError) as error:
            raise ValueError(f"'meta' must hold JSON values ({error}, for {key!r})") from error
    if "unit" in out and out["unit"] not in UNITS:
        raise ValueError(f"'unit' in 'meta' must be one of {[*UNITS]} (got {out['unit']!r})")
    return out
