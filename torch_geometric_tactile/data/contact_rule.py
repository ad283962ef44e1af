r"""A rule that decides whether anything touches a sensor."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np

from torch_geometric_tactile.data._rest_noise import (
    NUM_BLOCKS,
    mean_reading,
    movement_and_noise,
    trusted_noise,
)

#: The label of a frame or window without contact.
NO_CONTACT = "no contact"
#: The standard deviation of the rounding error of whole numbers.
_ROUNDING_NOISE = 1 / math.sqrt(12)
_MAX_TAXELS = 10**7
_MAX_VALUE = 1e30  # of numbers in a file, so that their squares are finite


@dataclass(frozen=True)
class ContactRule:
    r"""A rule that decides whether anything touches the sensor. Frames without contact are labelled
    :obj:`"no contact"`; a model that was trained on contacts does not classify them.

    A taxel is touched if one of its channels differs from its reading at rest by more than the
    threshold. There is contact if enough taxels are touched. The threshold is a number in the unit
    of the readings, or is derived from the noise of each taxel and channel at rest:

    .. math::
        |x - x_\text{rest}| > k \, \max(\sigma, \sigma_\text{channel}, \sigma_\text{rounding})

    * :math:`\sigma` is the standard deviation of the signal of one taxel and channel.
    * :math:`\sigma_\text{channel}` is the root mean square of :math:`\sigma` over all signals of
      the channel. It sets a lower limit, since one second of frames is too short to measure a quiet
      signal.
    * :math:`\sigma_\text{rounding} = 1/\sqrt{12}` applies to readings that are whole numbers.

    Normal noise exceeds :math:`6 \sigma` once in 500 million readings, which is once an hour for a
    hand with 1152 signals at 100 Hz. A touch is usually a hundred times the noise. Requiring a
    second taxel excludes a single taxel that jumps or drifts. Readings at rest that drift for
    minutes exceed the threshold sooner or later: measure them again, or use a larger threshold.

    A taxel is not touched if its reading is missing (NaN) or it has no reading at rest. A frame
    without any reading neither has nor lacks contact: :meth:`is_contact` and :meth:`lacks_contact`
    both return :obj:`False`, and the label of the frame is empty.

    Args:
        threshold (float, optional): The largest difference from the reading at rest that is not a
            touch, in the unit of the readings. If left out, it is derived from the noise at rest.
        min_taxels (int): The number of touched taxels that count as contact. For a sensor with
            fewer taxels, all of them must be touched.
        num_deviations (float): The factor :math:`k` of a derived threshold.
        rest (numpy.ndarray, optional): Readings at rest :math:`(N, C)`; see :meth:`measured`.
        noise (numpy.ndarray, optional): Standard deviations at rest :math:`(N, C)`.

    Raises:
        ValueError: If an argument is out of range or has the wrong shape. The methods raise it if
            the readings at rest are unknown, or if the threshold is derived from an unknown noise.

    Examples:
        >>> rng = np.random.default_rng(0)
        >>> rule = ContactRule().measured(rng.normal(100.0, 1.0, (50, 4, 3)))
        >>> frame = np.full((4, 3), 100.0)
        >>> bool(rule.is_contact(frame))
        False
        >>> frame[:2, 2] = 150.0
        >>> bool(rule.is_contact(frame))
        True
    """

    threshold: float | None = None
    min_taxels: int = 2
    num_deviations: float = 6.0
    rest: np.ndarray | None = field(default=None, repr=False, compare=False)
    noise: np.ndarray | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("threshold", "num_deviations"):
            value = getattr(self, name)
            if name == "threshold" and value is None:
                continue
            is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not is_number or not 0 < value <= _MAX_VALUE:
                raise ValueError(
                    f"'{name}' must be a positive number up to {_MAX_VALUE:g} (got "
                    f"{str(value)[:80]})"
                )
            object.__setattr__(self, name, float(value))
        if type(self.min_taxels) is not int or not 1 <= self.min_taxels <= _MAX_TAXELS:
            raise ValueError(f"'min_taxels' must be at least 1 (got {str(self.min_taxels)[:80]})")
        for name in ("rest", "noise"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _checked_array(name, getattr(self, name)))
        if self.noise is not None and (self.rest is None or self.rest.shape != self.noise.shape):
            raise ValueError(
                f"'noise' must have the shape of 'rest', "
                f"{None if self.rest is None else self.rest.shape} (got {self.noise.shape})"
            )

    @property
    def is_measured(self) -> bool:
        r"""Whether the readings at rest are known, and also the noise if the threshold needs it."""
        return self.rest is not None and (self.threshold is not None or self.noise is not None)

    def measured(self, tactile: np.ndarray) -> Self:
        r"""Returns the rule with the mean and the noise of frames at rest.

        Args:
            tactile (numpy.ndarray): Readings while nothing touches the sensor :math:`(T, N, C)`.

        Raises:
            ValueError: If there are too few frames, or the threshold is derived from the noise and
                the readings never change.
        """
        frames = _infinite_to_nan(tactile)
        if frames.ndim != 3 or len(frames) == 0:
            raise ValueError(
                "frames at rest must have shape (num_frames, num_taxels, num_channels), with at "
                f"least one frame (got {frames.shape})"
            )
        rest = mean_reading(frames)
        if self.threshold is not None:
            return replace(self, rest=rest, noise=None)
        if len(frames) < 2 * NUM_BLOCKS:
            raise ValueError(
                f"the noise at rest must be measured on at least {2 * NUM_BLOCKS} frames (got "
                f"{len(frames)}): record more, or set a 'threshold' in the unit of the readings"
            )
        noise = trusted_noise(movement_and_noise(frames)[1])
        # Whole numbers that never change may be forces, which are zero at rest and not rounded.
        is_changing = (np.abs(frames - rest) > 0).any()
        if is_changing and (np.isnan(frames) | (frames == np.round(frames))).all():
            noise = np.maximum(noise, _ROUNDING_NOISE)
        if not np.nanmax(noise, initial=0.0) > 0:
            raise ValueError(
                "the readings at rest must be noisy to derive a threshold from their noise (got "
                f"{len(frames)} frames without noise): set a 'threshold' in the unit of the "
                "readings"
            )
        return replace(self, rest=rest, noise=noise)

    def with_rest(self, rest: np.ndarray) -> Self:
        r"""Returns the rule with other readings at rest and the same noise.

        Args:
            rest (numpy.ndarray): Readings at rest :math:`(N, C)`.
        """
        return replace(self, rest=rest)

    def touched(self, tactile: np.ndarray) -> np.ndarray:
        r"""Returns which taxels are touched.

        Args:
            tactile (numpy.ndarray): Readings of one frame :math:`(N, C)` or of several frames
                :math:`(\ldots, N, C)`.

        Shapes:
            - **output:** booleans :math:`(\ldots, N)`
        """
        return self._is_touched(self._difference(tactile))

    def is_contact(self, tactile: np.ndarray) -> np.ndarray:
        r"""Returns whether enough taxels are touched.

        Args:
            tactile (numpy.ndarray): Readings of one frame :math:`(N, C)` or of several frames
                :math:`(\ldots, N, C)`.

        Shapes:
            - **output:** booleans :math:`(\ldots)`
        """
        return self._is_contact(self._difference(tactile))

    def lacks_contact(self, tactile: np.ndarray) -> np.ndarray:
        r"""Returns whether a frame has readings, but too few taxels are touched. Such a frame is
        labelled :obj:`"no contact"`; a frame without any reading is not.

        Args:
            tactile (numpy.ndarray): Readings of one frame :math:`(N, C)` or of several frames
                :math:`(\ldots, N, C)`.

        Shapes:
            - **output:** booleans :math:`(\ldots)`
        """
        difference = self._difference(tactile)
        has_readings = ~np.isnan(difference).all(axis=(-2, -1))
        return np.asarray(has_readings & ~self._is_contact(difference))

    def _difference(self, tactile: np.ndarray) -> np.ndarray:
        if self.rest is None:
            raise ValueError(
                "the contact rule must have the readings at rest (got none): call "
                "'adapt_recording' with rest=SECONDS, or the method 'measured' of the rule with "
                "frames in which nothing touches the sensor"
            )
        values = _infinite_to_nan(tactile)
        if values.shape[-2:] != self.rest.shape:
            raise ValueError(
                f"a frame must have the shape of the readings at rest of the contact rule, "
                f"{self.rest.shape} (got {values.shape[-2:]})"
            )
        return np.asarray(np.abs(values - self.rest))

    def _is_touched(self, difference: np.ndarray) -> np.ndarray:
        limit: float | np.ndarray
        if self.threshold is not None:
            limit = self.threshold
        elif self.noise is not None:
            limit = self.num_deviations * self.noise
        else:
            raise ValueError(
                "'threshold' of the contact rule must be set, since its readings at rest have no "
                "noise (got None)"
            )
        return np.asarray((difference > limit).any(axis=-1))  # NaN exceeds no limit

    def _is_contact(self, difference: np.ndarray) -> np.ndarray:
        min_taxels = min(self.min_taxels, difference.shape[-2])
        return np.asarray(self._is_touched(difference).sum(axis=-1) >= min_taxels)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values, with :obj:`None` for missing readings."""
        content: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        for name in ("rest", "noise"):
            value = content[name]
            if value is not None:
                rows = value.tolist()
                content[name] = [[None if x != x else x for x in row] for row in rows]
        return content

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Builds a rule from the output of :meth:`to_dict`.

        Args:
            content (Mapping): The arguments.

        Raises:
            ValueError: If an argument is missing, unknown or out of range.
        """
        names = {item.name for item in fields(cls)}
        if not isinstance(content, Mapping) or set(content) != names:
            raise ValueError(f"'contact' must have {sorted(names)} (got {str(content)[:80]})")
        arrays = {
            name: None if content[name] is None else _rows_to_array(name, content[name])
            for name in ("rest", "noise")
        }
        return cls(**{**content, **arrays})


def _infinite_to_nan(tactile: np.ndarray) -> np.ndarray:
    # Rounded to single precision first, the precision of recordings and live frames, so that the
    # same readings always give the same decision.
    values = np.asarray(tactile, np.float32).astype(np.float64)
    return np.where(np.isfinite(values), values, np.nan)


def _checked_array(name: str, value: Any) -> np.ndarray:
    array = np.array(value, np.float64)
    min_value = -_MAX_VALUE if name == "rest" else 0.0
    is_valid = np.isnan(array) | ((array >= min_value) & (array <= _MAX_VALUE))
    if array.ndim != 2 or 0 in array.shape or not is_valid.all():
        numbers = "numbers" if name == "rest" else "numbers that are not negative"
        raise ValueError(
            f"'{name}' must be {numbers} or NaN, of shape (num_taxels, num_channels) (got "
            f"{array.shape}, {' '.join(str(array).split())[:60]})"
        )
    array.setflags(write=False)
    return array


def _rows_to_array(name: str, rows: Any) -> np.ndarray:
    # Converts lists from a file, in which None stands for NaN, to an array.
    is_valid = isinstance(rows, list) and all(
        isinstance(row, list)
        and len(row) == len(rows[0])
        and all(x is None or (type(x) in (int, float) and abs(x) <= _MAX_VALUE) for x in row)
        for row in rows
    )
    if not is_valid:
        raise ValueError(
            f"'{name}' must be lists of numbers or null, one for each taxel (got {str(rows)[:80]})"
        )
    return np.array([[math.nan if x is None else x for x in row] for row in rows], np.float64)
