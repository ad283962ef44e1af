r"""Properties of frames: their rate, gaps, selection, unit and order of columns."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Self

import numpy as np

from torch_geometric_tactile.data._gaps import RATE_TOLERANCE, ROUNDING
from torch_geometric_tactile.data._gaps import part_numbers as time_part_numbers

_MAX_STRIDE = 10**7
_MAX_VALUE = 1e12  # frames per second, or seconds


@dataclass(frozen=True)
class FrameInfo:
    r"""The properties of frames: their rate, gaps, selection, unit and column names.

    Recordings, data sets, predictors and live streams can only be used together if these properties
    agree, as with :class:`mne.Info` in MNE. An unknown property is :obj:`None` and is not compared.

    Args:
        rate (float, optional): Frames per second of the recordings, before :obj:`stride` and
            :obj:`selected_rate`.
        tolerance (float): Accepted relative deviation from :obj:`rate`: 0.05, or the spread over
            the trials if it is larger.
        max_gap (float, optional): The largest time in seconds between two frames of a recording
            that is not a gap; infinite for event data.
        resampled (bool): Whether all recordings were resampled to :obj:`rate` by
            :meth:`Recording.resample <torch_geometric_tactile.data.Recording.resample>`.
        selected_rate (float, optional): Frames per second after selection. The selected frames are
            nearest to the ticks of a clock that starts with each recording.
        stride (int): Only every :obj:`stride`-th of these frames is used.
        unit (str, optional): Unit of the readings, such as :obj:`"count"`.
        columns (Mapping of str to sequence of str): Column names of :obj:`"tactile"`, where all
            channels of a taxel follow each other, and of :obj:`"joint"`.
        rest (float, optional): Duration of the rest at the start of each recording in seconds, if a
            transform measures the readings at rest.

    Raises:
        ValueError: If a number is not positive, or a value has the wrong type.

    Examples:
        >>> info = FrameInfo(rate=100.0, stride=2, unit="count")
        >>> info.frame_rate
        50.0
        >>> info.require(FrameInfo(rate=100.4, unit="count"), "grasp.h5")
    """

    rate: float | None = None
    tolerance: float = RATE_TOLERANCE
    max_gap: float | None = None
    resampled: bool = False
    selected_rate: float | None = None
    stride: int = 1
    unit: str | None = None
    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)
    rest: float | None = None

    def __post_init__(self) -> None:
        for name in ("rate", "tolerance", "max_gap", "selected_rate", "rest"):
            value = getattr(self, name)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is None and name != "tolerance":
                continue
            if not is_number or (
                not 0 < value < _MAX_VALUE and not (value == math.inf and name == "max_gap")
            ):
                raise ValueError(f"'{name}' must be a positive number (got {str(value)[:80]})")
        if type(self.stride) is not int or not 1 <= self.stride <= _MAX_STRIDE:
            raise ValueError(f"'stride' must be at least 1 (got {str(self.stride)[:80]})")
        if not isinstance(self.resampled, bool) or (self.resampled and self.rate is None):
            raise ValueError(
                f"'resampled' must be true or false, and requires a rate (got {self.resampled!r})"
            )
        if self.unit is not None and not isinstance(self.unit, str):
            raise ValueError(f"'unit' must be a text or None (got {str(self.unit)[:80]})")
        if not isinstance(self.columns, Mapping) or not all(
            key in ("tactile", "joint")
            and isinstance(names, list | tuple)
            and all(isinstance(name, str) for name in names)
            for key, names in self.columns.items()
        ):
            raise ValueError(
                f"'columns' must be names of 'tactile' and 'joint' (got {str(self.columns)[:80]})"
            )

    @property
    def frame_rate(self) -> float | None:
        r"""Frames per second after :obj:`selected_rate` and :obj:`stride`."""
        rate = self.rate if self.selected_rate is None else self.selected_rate
        return None if rate is None else rate / self.stride

    def changed(self, **changes: Any) -> Self:
        r"""Returns a copy in which some values are replaced.

        Args:
            **changes: The new values by name.
        """
        return replace(self, **changes)

    def rate_differs(self, rate: float | None, tolerance: float = 0.0) -> bool:
        r"""Returns whether frames at another rate cannot be used.

        Without :obj:`selected_rate`, the two rates must be equal within the tolerance. With it, the
        other rate must be at least :obj:`selected_rate`, since frames of faster recordings are
        selected.

        Args:
            rate (float, optional): Frames per second; :obj:`None` if unknown.
            tolerance (float): Accepted relative deviation, if it is larger than :obj:`tolerance` of
                this object.
        """
        if rate is None or self.rate is None or not math.isfinite(rate):
            return False
        tolerance = max(tolerance, self.tolerance)
        if self.selected_rate is not None:
            return rate < (1 - tolerance) * self.selected_rate
        return not abs(rate - self.rate) <= tolerance * self.rate

    def require(self, other: Self, where: str, *, with_rate: bool = True) -> None:
        r"""Checks that other frames have the same unit and rate. The order of their columns is not
        compared, since :func:`in_column_order` can change it.

        Args:
            other (FrameInfo): The properties of the other frames.
            where (str): Name of the other frames in messages, such as a file name.
            with_rate (bool): Whether to compare the rate, which matters for windows.

        Raises:
            ValueError: If the units or rates differ. The message states both values and a remedy.
        """
        if None not in (self.unit, other.unit) and self.unit != other.unit:
            raise ValueError(
                f"{where} must have readings in {self.unit}, the unit that the model was trained "
                f"on (got {other.unit}): convert them, or train on recordings in {other.unit}"
            )
        if with_rate and self.rate_differs(other.rate, other.tolerance):
            at_least = "" if self.selected_rate is None else "at least "
            rate = self.rate if self.selected_rate is None else self.selected_rate
            raise ValueError(
                f"{where} must have {at_least}{rate:.4g} frames per second, the rate that the "
                f"model was trained on (got {other.rate:.4g}): resample it with --resample, "
                f"resample=True or Recording.resample({rate:.4g})"
            )

    def selected_frames(self, time: np.ndarray | None, count: int) -> np.ndarray:
        r"""Returns the indices of the frames of a recording that :obj:`selected_rate` and
        :obj:`stride` select.

        Args:
            time (numpy.ndarray, optional): Times of the frames in seconds :math:`(T,)`.
            count (int): Number of frames :math:`T`.

        Returns:
            numpy.ndarray: Increasing indices :math:`(K,)`.

        Examples:
            >>> FrameInfo(stride=3).selected_frames(None, 8)
            array([0, 3, 6])
        """
        index = np.arange(count)
        if self.selected_rate is not None and time is not None and count:
            tick = self.ticks(time - time[0])
            index = index[np.concatenate([[True], np.diff(tick) > 0])]
        return index[:: self.stride]

    def ticks(self, elapsed: Any) -> Any:
        r"""Returns the number of the last tick before each frame, for a clock with
        :obj:`selected_rate` ticks per second. A frame may be early by half the time between frames.

        The first frame of each tick is selected. If the frames are regular, this frame is nearest
        to the tick, and a live stream can select it without waiting for the next frame.

        Args:
            elapsed (numpy.ndarray or float): Seconds since the first frame.
        """
        rate = self.selected_rate or 0.0
        half_frame = 0.5 if self.rate is None else min(0.5, 0.5 * rate / self.rate)  # in ticks
        return np.floor(elapsed * rate + half_frame + ROUNDING)

    def part_numbers(self, time: np.ndarray | None, count: int) -> np.ndarray:
        r"""Returns the number of the continuous part to which each frame of a recording belongs.

        Args:
            time (numpy.ndarray, optional): Times of the frames in seconds :math:`(T,)`.
            count (int): Number of frames :math:`T`.

        Returns:
            numpy.ndarray: Integers :math:`(T,)`.
        """
        if time is None or self.max_gap is None:
            return np.zeros(count, np.int64)
        return time_part_numbers(time, self.max_gap)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values. An infinite :obj:`max_gap` is :obj:`"inf"`."""
        content = asdict(self)
        content["columns"] = {key: list(names) for key, names in self.columns.items()}
        if self.max_gap is not None and math.isinf(self.max_gap):
            content["max_gap"] = "inf"
        return content

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Builds an object from the output of :meth:`to_dict`.

        Args:
            content (Mapping): The arguments.

        Raises:
            ValueError: If a key is not an argument, or an argument is invalid.
        """
        names = {item.name for item in fields(cls)}
        if not isinstance(content, Mapping) or not names.issuperset(content):
            raise ValueError(
                f"'frames' must have some of the keys {sorted(names)} (got {str(content)[:80]})"
            )
        arguments = dict(content)
        if arguments.get("max_gap") == "inf":
            arguments["max_gap"] = math.inf
        return cls(**arguments)
