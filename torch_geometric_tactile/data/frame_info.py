r"""How frames were made: their rate, gaps, thinning, unit and order of columns."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Self

import numpy as np

from torch_geometric_tactile.data._gaps import RATE_TOLERANCE, ROUNDING
from torch_geometric_tactile.data._gaps import part_numbers as numbers_of_parts

_MAX_STRIDE = 10**7
_MAX_NUMBER = 1e12  # frames per second, or seconds


@dataclass(frozen=True)
class FrameInfo:
    r"""How frames were made: what a recording, a data set, a predictor and a live stream must
    agree on, as MNE's :class:`mne.Info`. A value that is not known is :obj:`None`, and is not
    compared.

    Args:
        rate (float, optional): Frames per second of the recordings, before :obj:`stride` and
            :obj:`selected_rate`.
        tolerance (float): Relative deviation from :obj:`rate` that is accepted: 0.05, or the spread
            over the trials if that is larger.
        max_gap (float, optional): The largest distance of two frames of a recording, in seconds,
            that is no gap; infinite for data of events.
        resampled (bool): Whether all recordings were resampled to :obj:`rate` first, see
            :meth:`Recording.resample <torch_geometric_tactile.data.Recording.resample>`.
        selected_rate (float, optional): Frames per second that were selected: those next to the
            ticks of a clock that starts with each recording.
        stride (int): Only every :obj:`stride`-th of these frames was used.
        unit (str, optional): Unit of the readings, such as :obj:`"count"`.
        columns (Mapping of str to sequence of str): Names of the columns of :obj:`"tactile"`,
            taxel by taxel each with its channels, and of :obj:`"joint"`.
        rest (float, optional): How long each recording is at rest before anything is touched, in
            seconds, where a transform measures it.

    Raises:
        ValueError: If a number is not positive, or a value is of another type.

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
                not 0 < value < _MAX_NUMBER and not (value == math.inf and name == "max_gap")
            ):
                raise ValueError(f"'{name}' must be a positive number (got {str(value)[:80]})")
        if type(self.stride) is not int or not 1 <= self.stride <= _MAX_STRIDE:
            raise ValueError(f"'stride' must be at least 1 (got {str(self.stride)[:80]})")
        if not isinstance(self.resampled, bool) or (self.resampled and self.rate is None):
            raise ValueError(
                f"'resampled' must be true or false, and come with a rate (got {self.resampled!r})"
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
        r"""Frames per second that are used, after :obj:`selected_rate` and :obj:`stride`."""
        rate = self.rate if self.selected_rate is None else self.selected_rate
        return None if rate is None else rate / self.stride

    def changed(self, **changes: Any) -> Self:
        r"""Returns a copy with other values.

        Args:
            **changes: The values by name.
        """
        return replace(self, **changes)

    def rate_differs(self, rate: float | None, tolerance: float = 0.0) -> bool:
        r"""Returns whether frames at another rate cannot be used: it is not :obj:`rate`, or it is
        below :obj:`selected_rate`, at which frames of any faster recording are selected.

        Args:
            rate (float, optional): Frames per second; :obj:`None` if it is not known.
            tolerance (float): Relative deviation that is accepted, if it is above the own one.
        """
        if rate is None or self.rate is None or not math.isfinite(rate):
            return False
        tolerance = max(tolerance, self.tolerance)
        if self.selected_rate is not None:
            return rate < (1 - tolerance) * self.selected_rate
        return not abs(rate - self.rate) <= tolerance * self.rate

    def require(self, other: Self, where: str, *, with_rate: bool = True) -> None:
        r"""Checks that other frames were made as these were. Their columns may be in another order,
        which can be mended (:func:`in_column_order`).

        Args:
            other (FrameInfo): How the other frames were made.
            where (str): What to call them in a message, such as the name of a file.
            with_rate (bool): Whether the rate matters, as it does for windows.

        Raises:
            ValueError: If they were not; the message has both values, and what to do.
        """
        if None not in (self.unit, other.unit) and self.unit != other.unit:
            raise ValueError(
                f"{where} must have readings in {self.unit}, as the model was trained on (got "
                f"{other.unit}): convert them, or train on recordings in {other.unit}"
            )
        if with_rate and self.rate_differs(other.rate, other.tolerance):
            least = "" if self.selected_rate is None else "at least "
            rate = self.rate if self.selected_rate is None else self.selected_rate
            raise ValueError(
                f"{where} must have {least}{rate:.4g} frames per second, as the model was trained "
                f"on (got {other.rate:.4g}): resample it, with --resample, resample=True or "
                f"Recording.resample({rate:.4g})"
            )

    def selected_frames(self, time: np.ndarray | None, count: int) -> np.ndarray:
        r"""Returns the frames of a recording that are used, after :obj:`selected_rate` and
        :obj:`stride`.

        Args:
            time (numpy.ndarray, optional): Times of the frames in seconds :math:`(T,)`.
            count (int): Number of frames :math:`T`.

        Returns:
            numpy.ndarray: Their indices, increasing :math:`(K,)`.

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
        r"""Returns the number of the last tick of a clock of :obj:`selected_rate` that a frame is
        not earlier than, half a frame apart. The first frame of each tick is the one selected: with
        a regular clock the nearest one, and known as soon as it comes.

        Args:
            elapsed (numpy.ndarray or float): Seconds since the first frame.
        """
        rate = self.selected_rate or 0.0
        half = 0.5 if self.rate is None else min(0.5, 0.5 * rate / self.rate)
        return np.floor(elapsed * rate + half + ROUNDING)

    def part_numbers(self, time: np.ndarray | None, count: int) -> np.ndarray:
        r"""Returns the number of the continuous part of each frame of a recording.

        Args:
            time (numpy.ndarray, optional): Times of the frames in seconds :math:`(T,)`.
            count (int): Number of frames :math:`T`.

        Returns:
            numpy.ndarray: Integers :math:`(T,)`.
        """
        if time is None or self.max_gap is None:
            return np.zeros(count, np.int64)
        return numbers_of_parts(time, self.max_gap)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values; an infinite :obj:`max_gap` as :obj:`"inf"`."""
        content = asdict(self)
        content["columns"] = {key: list(names) for key, names in self.columns.items()}
        if self.max_gap is not None and math.isinf(self.max_gap):
            content["max_gap"] = "inf"
        return content

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Builds it from what :meth:`to_dict` returns.

        Args:
            content (Mapping): The arguments.
        """
        names = {each.name for each in fields(cls)}
        if not isinstance(content, Mapping) or not names.issuperset(content):
            raise ValueError(f"'frames' must be some of {sorted(names)} (got {str(content)[:80]})")
        arguments = dict(content)
        if arguments.get("max_gap") == "inf":
            arguments["max_gap"] = math.inf
        return cls(**arguments)
