r"""Names, axis orders, units and rates in the files of a BiGS data set."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from torch_geometric_tactile.io._array_order import StoredArray, parse_axis_order

NUM_ELECTRODES = 19
FINGERS = ("left", "middle", "right")
_FRAME_RATE = 100.0  # frames per second
_DEFAULT_RATES = {"pac": 2200.0, "robot_joint": 300.0, "finger_joint": 300.0}
#: The arrays and their axes in the neutral order.
ARRAYS: Mapping[str, tuple[str, ...]] = {
    "electrodes": ("frame", "electrode", "finger"),
    "time": ("frame",),
    "pressure": ("frame", "finger"),
    "pac": ("frame", "finger", "step"),
    "robot_joint": ("frame", "step", "joint"),
    "finger_joint": ("frame", "step", "joint"),
    "wrench": ("frame", "value"),
    "object_pose": ("frame", "value"),
    "phase": ("frame",),
    "slip": ("frame",),
}
#: The fields with a single value per file.
VALUES = ("success", "object", "trial", "session", "pickup_time")
_PATTERN_GROUPS = ("object", "trial", "session", "success")  # that a file name may give
_UNITS_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_UNITS_PER_METRE = {"m": 1.0, "mm": 1e3}
_PATTERN = r"(?P<object>.+)_(?P<trial>\d+)"


@dataclass(frozen=True)
class BiGSFormat:
    r"""Describes the names, axis orders and units of files with one grasp each, for
    :func:`~torch_geometric_tactile.io.read_bigs`.

    Args:
        fields (Mapping of str to str): Maps the name of a field to its name in the files. The
            arrays are :obj:`electrodes`, :obj:`time`, :obj:`pressure`, :obj:`pac`,
            :obj:`robot_joint`, :obj:`finger_joint`, :obj:`wrench`, :obj:`object_pose`,
            :obj:`phase` and :obj:`slip`; the single values are :obj:`success`, :obj:`object`,
            :obj:`trial`, :obj:`session` and :obj:`pickup_time`. A field that is left out has the
            same name in the files. The order of the axes may follow the name in brackets, as in
            :obj:`"biotac/elec [frame (finger electrode)]"`. Axes in parentheses share one
            dimension, and the last of them changes fastest. Three names separated by :obj:`"|"`
            are arrays of the left, middle and right finger. :obj:`"group@name"` is an attribute in
            an HDF5 file.
        values (Mapping): Values that are the same for all files, such as
            :obj:`{"session": "may"}`.
        pattern (str): Regular expression for the full name of a file without its suffix. Its
            named groups may be :obj:`object`, :obj:`trial`, :obj:`session` and :obj:`success`.
        rate (float): Frames per second. A frame has the readings of all electrodes.
        rates (Mapping of str to float): Values per second of :obj:`pac`, :obj:`robot_joint` and
            :obj:`finger_joint`, which must be multiples of :obj:`rate`. Defaults are 2200, 300 and
            300.
        time_unit (str, optional): Unit of the times, including the pick-up time: :obj:`"s"`,
            :obj:`"ms"`, :obj:`"us"` or :obj:`"ns"`. By default, times are in seconds and must not
            be integers.
        angle_unit (str): :obj:`"rad"` or :obj:`"deg"`.
        length_unit (str): Unit of the object's position, :obj:`"m"` or :obj:`"mm"`.
        quaternion (str): Order of the object's quaternion, :obj:`"wxyz"` or :obj:`"xyzw"`.
        fingers (str): Order of the fingers in arrays with all three fingers, such as
            :obj:`"middle left right"`.
        ends_after_pickup (float, optional): Seconds from the start of the pick-up to the end of
            each file, for files without a pick-up time.

    Raises:
        ValueError: If a name, an order, a unit or a rate is unknown or impossible.

    Examples:
        >>> layout = BiGSFormat(
        ...     {"electrodes": "biotac/elec [frame (finger electrode)]", "time": "stamp"},
        ...     pattern=r"(?P<object>\w+)_(?P<trial>\d+)",
        ...     time_unit="ms",
        ... )
        >>> layout.fields["time"]
        'stamp'
    """

    fields: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    pattern: str = _PATTERN
    rate: float = _FRAME_RATE
    rates: Mapping[str, float] = field(default_factory=dict)
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    angle_unit: Literal["rad", "deg"] = "rad"
    length_unit: Literal["m", "mm"] = "m"
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    fingers: str = "left middle right"
    ends_after_pickup: float | None = None

    def __post_init__(self) -> None:
        for name, mapping, valid_keys in (
            ("fields", self.fields, (*ARRAYS, *VALUES)),
            ("values", self.values, VALUES),
            ("rates", self.rates, _DEFAULT_RATES),
        ):
            if not isinstance(mapping, Mapping):
                raise ValueError(f"'{name}' must be a mapping (got {type(mapping).__name__})")
            for key in mapping:
                if key not in valid_keys:
                    raise ValueError(f"'{name}' must have keys among {[*valid_keys]} (got {key!r})")
        for key in self.values:
            if key in self.fields:
                raise ValueError(f"'{key}' must be in 'fields' or in 'values' (got both)")
        for key, text in self.fields.items():
            self._check_field(key, text)
        self._check_numbers()
        for key, field_value in self.values.items():
            if not isinstance(field_value, str | int | float):
                raise ValueError(
                    f"'{key}' in 'values' must be a string or a number (got {field_value!r})"
                )
        units: tuple[tuple[str, Any, tuple[str | None, ...]], ...] = (
            ("time_unit", self.time_unit, (None, *_UNITS_PER_SECOND)),
            ("angle_unit", self.angle_unit, ("rad", "deg")),
            ("length_unit", self.length_unit, (*_UNITS_PER_METRE,)),
            ("quaternion", self.quaternion, ("wxyz", "xyzw")),
        )
        for name, value, choices in units:
            if value not in choices:
                raise ValueError(f"'{name}' must be one of {choices} (got {value!r})")
        if not isinstance(self.fingers, str) or sorted(self.fingers.split()) != [*FINGERS]:
            raise ValueError(
                f"'fingers' must be an order of 'left', 'middle' and 'right' (got {self.fingers!r})"
            )
        try:
            groups = re.compile(self.pattern).groupindex
        except (re.error, RecursionError, TypeError) as error:
            raise ValueError(f"'pattern' must be a regular expression ({error})") from error
        for name in groups:
            if name not in _PATTERN_GROUPS:
                raise ValueError(
                    f"'pattern' must have groups among {[*_PATTERN_GROUPS]} (got '{name}')"
                )

    def _check_field(self, key: str, text: str) -> None:
        stored = StoredArray.from_text(key, text)
        axes = ARRAYS.get(key, ())
        if len(stored.names) > 1 and "finger" not in axes:
            raise ValueError(
                f"field '{key}' must have one name, since it has no finger axis (got {text})"
            )
        if stored.order is not None:
            parse_axis_order(key, stored.order, self.axes(key, stored))

    def _check_numbers(self) -> None:
        for key, rate in (("rate", self.rate), *self.rates.items()):
            if not _is_number(rate) or not 0 < rate < 1e6:
                raise ValueError(f"'{key}' must be a positive rate per second (got {rate!r})")
        for key in self.rates:
            self.steps(key)
        end = self.ends_after_pickup
        if end is not None and (not _is_number(end) or end < 0):
            raise ValueError(f"'ends_after_pickup' must be at least 0 seconds (got {end!r})")

    def stored(self, key: str) -> StoredArray:
        r"""Returns the name and the axis order of a field in the files.

        Args:
            key (str): The name of the field in :obj:`fields`.
        """
        return StoredArray.from_text(key, self.fields.get(key, key))

    def axes(self, key: str, stored: StoredArray) -> tuple[str, ...]:
        r"""Returns the axes of a stored array in the neutral order.

        Args:
            key (str): The name of the array in :obj:`fields`.
            stored (StoredArray): The names and the order of the array in the files.
        """
        axes = ARRAYS.get(key, ())
        return axes if len(stored.names) == 1 else tuple(a for a in axes if a != "finger")

    def rate_of(self, key: str) -> float:
        r"""Returns the values per second of an array.

        Args:
            key (str): The name of the array in :obj:`fields`.
        """
        return float(self.rates.get(key, _DEFAULT_RATES.get(key, self.rate)))

    def steps(self, key: str) -> int:
        r"""Returns the number of values of an array per frame.

        Args:
            key (str): The name of the array in :obj:`fields`.

        Raises:
            ValueError: If the rate is not a multiple of the frame rate.
        """
        steps = self.rate_of(key) / self.rate
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
            hint = "" if key in self.rates else ": state it in 'rates'"
            raise ValueError(
                f"the rate of '{key}' must be a multiple of 'rate', {self.rate:g} (got "
                f"{self.rate_of(key):g}){hint}"
            )
        return round(steps)

    @property
    def per_second(self) -> float:
        r"""Number of time units per second."""
        return _UNITS_PER_SECOND[self.time_unit or "s"]

    @property
    def per_metre(self) -> float:
        r"""Number of length units per metre."""
        return _UNITS_PER_METRE[self.length_unit]


def _is_number(value: Any) -> bool:
    is_real = isinstance(value, int | float) and not isinstance(value, bool)
    return is_real and math.isfinite(value)
