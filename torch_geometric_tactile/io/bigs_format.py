r"""How the holder of a BiGS data set keeps it: names, orders, units and rates."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from torch_geometric_tactile.io._array_order import StoredArray, parse_axis_order

NUM_ELECTRODES = 19
FINGERS = ("left", "middle", "right")
_RATE = 100.0  # frames per second
_RATES = {"pac": 2200.0, "robot_joint": 300.0, "finger_joint": 300.0}
#: The arrays and, in their neutral order, their axes.
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
#: What has one value in a file.
VALUES = ("success", "object", "trial", "session", "pickup_time")
_TOLD = ("object", "trial", "session", "success")  # by the name of a file
_TIME = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_LENGTH = {"m": 1.0, "mm": 1e3}
_PATTERN = r"(?P<object>.+)_(?P<trial>\d+)"


@dataclass(frozen=True)
class BiGSFormat:
    r"""Describes the names, orders and units in files of one grasp each, for
    :func:`~torch_geometric_tactile.io.read_bigs`.

    Args:
        fields (Mapping of str to str): The names in the files by ours: :obj:`electrodes`,
            :obj:`time`, :obj:`pressure`, :obj:`pac`, :obj:`robot_joint`, :obj:`finger_joint`,
            :obj:`wrench`, :obj:`object_pose`, :obj:`phase`, :obj:`slip`, and of single values
            :obj:`success`, :obj:`object`, :obj:`trial`, :obj:`session`, :obj:`pickup_time`. A name
            that is not given is ours. An array in another order than ours has it behind its name,
            in brackets: :obj:`"biotac/elec [frame (finger electrode)]"`; axes of one dimension
            stand in brackets, of which the last changes fastest. Three names with :obj:`"|"`
            between them are arrays of one finger each, left, middle and right. :obj:`"group@name"`
            is an attribute in an HDF5 file.
        values (Mapping): Values that are the same for all files, such as
            :obj:`{"session": "may"}`.
        pattern (str): Regular expression for the whole name of a file without its suffix, whose
            named groups are what the name tells: :obj:`object`, :obj:`trial`, :obj:`session` or
            :obj:`success`.
        rate (float): Frames, with readings of all electrodes, per second.
        rates (Mapping of str to float): Values per second of :obj:`pac`, :obj:`robot_joint` and
            :obj:`finger_joint`, multiples of :obj:`rate`; 2200, 300 and 300 if left out.
        time_unit (str, optional): :obj:`"s"`, :obj:`"ms"`, :obj:`"us"` or :obj:`"ns"`, also of the
            pick-up time. Without it, seconds, which integers are refused for.
        angle_unit (str): :obj:`"rad"` or :obj:`"deg"`.
        length_unit (str): Of the object's position, :obj:`"m"` or :obj:`"mm"`.
        quaternion (str): Order of the object's quaternion, :obj:`"wxyz"` or :obj:`"xyzw"`.
        fingers (str): Order of the fingers in arrays that have all three, such as
            :obj:`"middle left right"`.
        ends_after_pickup (float, optional): How many seconds after pick-up begins all files end,
            where no pick-up time is known.

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
    rate: float = _RATE
    rates: Mapping[str, float] = field(default_factory=dict)
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    angle_unit: Literal["rad", "deg"] = "rad"
    length_unit: Literal["m", "mm"] = "m"
    quaternion: Literal["wxyz", "xyzw"] = "wxyz"
    fingers: str = "left middle right"
    ends_after_pickup: float | None = None

    def __post_init__(self) -> None:
        for name, given, known in (
            ("fields", self.fields, (*ARRAYS, *VALUES)),
            ("values", self.values, VALUES),
            ("rates", self.rates, _RATES),
        ):
            if not isinstance(given, Mapping):
                raise ValueError(f"'{name}' must be a mapping (got {type(given).__name__})")
            for key in given:
                if key not in known:
                    raise ValueError(f"'{name}' must have keys of {[*known]} (got {key!r})")
        for key in self.values:
            if key in self.fields:
                raise ValueError(f"'{key}' must be in 'fields' or in 'values' (got both)")
        for key, text in self.fields.items():
            self._check_field(key, text)
        self._check_numbers()
        for key, stated in self.values.items():
            if not isinstance(stated, str | int | float):
                raise ValueError(f"'{key}' in 'values' must be a text or a number (got {stated!r})")
        units: tuple[tuple[str, Any, tuple[str | None, ...]], ...] = (
            ("time_unit", self.time_unit, (None, *_TIME)),
            ("angle_unit", self.angle_unit, ("rad", "deg")),
            ("length_unit", self.length_unit, (*_LENGTH,)),
            ("quaternion", self.quaternion, ("wxyz", "xyzw")),
        )
        for name, value, choices in units:
            if value not in choices:
                raise ValueError(f"'{name}' must be one of {choices} (got {value!r})")
        if not isinstance(self.fingers, str) or sorted(self.fingers.split()) != [*FINGERS]:
            raise ValueError(
                f"'fingers' must be 'left', 'middle' and 'right' in their order (got "
                f"{self.fingers!r})"
            )
        try:
            told = re.compile(self.pattern).groupindex
        except (re.error, RecursionError, TypeError) as error:
            raise ValueError(f"'pattern' must be a regular expression ({error})") from error
        for name in told:
            if name not in _TOLD:
                raise ValueError(f"'pattern' must have groups of {[*_TOLD]} (got '{name}')")

    def _check_field(self, key: str, text: str) -> None:
        stored = StoredArray.from_text(key, text)
        axes = ARRAYS.get(key, ())
        if len(stored.names) > 1 and "finger" not in axes:
            raise ValueError(f"field '{key}' must have one name, as it has no fingers (got {text})")
        if stored.order is not None:
            parse_axis_order(key, stored.order, self.axes(key, stored))

    def _check_numbers(self) -> None:
        for key, rate in (("rate", self.rate), *self.rates.items()):
            if not _is_number(rate) or not 0 < rate < 1e6:
                raise ValueError(f"'{key}' must be a rate above 0, per second (got {rate!r})")
        for key in self.rates:
            self.steps(key)
        end = self.ends_after_pickup
        if end is not None and (not _is_number(end) or end < 0):
            raise ValueError(f"'ends_after_pickup' must be seconds, at least 0 (got {end!r})")

    def stored(self, key: str) -> StoredArray:
        r"""Returns under which name, and in which order, a field is stored.

        Args:
            key (str): Our name of the field.
        """
        return StoredArray.from_text(key, self.fields.get(key, key))

    def axes(self, key: str, stored: StoredArray) -> tuple[str, ...]:
        r"""Returns the axes of an array as it is stored, in our order.

        Args:
            key (str): Our name of the array.
            stored (StoredArray): How it is stored.
        """
        axes = ARRAYS.get(key, ())
        return axes if len(stored.names) == 1 else tuple(a for a in axes if a != "finger")

    def rate_of(self, key: str) -> float:
        r"""Returns the values per second of an array.

        Args:
            key (str): Our name of the array.
        """
        return float(self.rates.get(key, _RATES.get(key, self.rate)))

    def steps(self, key: str) -> int:
        r"""Returns how many values an array has a frame.

        Args:
            key (str): Our name of the array.

        Raises:
            ValueError: If its rate is no multiple of that of the frames.
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
        r"""How many units of the time a second has."""
        return _TIME[self.time_unit or "s"]

    @property
    def per_metre(self) -> float:
        r"""How many units of length a metre has."""
        return _LENGTH[self.length_unit]


def _is_number(value: Any) -> bool:
    is_real = isinstance(value, int | float) and not isinstance(value, bool)
    return is_real and math.isfinite(value)
