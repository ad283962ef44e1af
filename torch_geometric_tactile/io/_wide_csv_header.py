r"""Names of the columns of CSV files with one frame a row: which column is what, in which unit."""

import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.io._csv_header import time_unit

_Key = TypeVar("_Key", bound=Hashable)
_AXES = ("x", "y", "z")
_TAXEL = re.compile(r"taxel_([0-9]{1,9})_([xyz]|[0-9]{1,9})(?:_([a-z]+))?")
_JOINT = re.compile(r"joint_([0-9]{1,9})(?:_(rad|deg))?")
# The unit of the metadata, and how many of the column's unit make one of it.
_UNITS = {
    "n": ("newton", 1.0),
    "newton": ("newton", 1.0),
    "mn": ("newton", 1000.0),
    "count": ("count", 1.0),
    "counts": ("count", 1.0),
}


class WideColumns(NamedTuple):
    r"""What the columns of a file are.

    :obj:`tactile` and :obj:`joint` are columns in the order of the recording, :obj:`sizes` the
    numbers of taxels, channels and joints, :obj:`degrees` the joints whose angles are in degrees.
    The readings are divided by :obj:`per_unit` to be in :obj:`unit`.
    """

    names: list[str]
    sizes: tuple[int, int, int]
    time: int | None
    time_unit: str
    tactile: list[int]
    joint: list[int]
    degrees: list[int]
    unit: str | None
    per_unit: float


def wide_csv_header(num_taxels: int, num_channels: int, num_joints: int) -> list[str]:
    r"""Returns the names of the columns: :obj:`time`, :obj:`taxel_0_x`, ..., :obj:`joint_0`, ...

    Examples:
        >>> wide_csv_header(1, 2, 1)
        ['time', 'taxel_0_x', 'taxel_0_y', 'joint_0']

    Shapes:
        - **num_taxels:** Number of taxels :math:`N`.
        - **num_channels:** Number of channels of a taxel :math:`C`; up to three are axes.
        - **num_joints:** Number of joints :math:`J`.
    """
    return [
        "time",
        *(f"taxel_{taxel}_{axis}" for taxel in range(num_taxels) for axis in _axes(num_channels)),
        *(f"joint_{joint}" for joint in range(num_joints)),
    ]


def columns_by_place(sizes: tuple[int, int, int], time: bool) -> WideColumns:
    r"""Returns the columns of a file without names: those of :func:`wide_csv_header`."""
    num_readings, first = sizes[0] * sizes[1], int(time)
    return WideColumns(
        names=wide_csv_header(*sizes)[1 - first :],
        sizes=sizes,
        time=0 if time else None,
        time_unit="s",
        tactile=list(range(first, first + num_readings)),
        joint=list(range(first + num_readings, first + num_readings + sizes[2])),
        degrees=[],
        unit=None,
        per_unit=1.0,
    )


def columns_by_name(path: Path, header: Sequence[str]) -> WideColumns:
    r"""Returns the columns that a header names, which may be in any order."""
    names = [cell.strip() for cell in header]
    keys = [name.lower() for name in names]
    times = [i for i, key in enumerate(keys) if time_unit(key)]
    taxels = {i: match for i, key in enumerate(keys) if (match := _TAXEL.fullmatch(key))}
    joints = {i: match for i, key in enumerate(keys) if (match := _JOINT.fullmatch(key))}
    known = {*times, *taxels, *joints}
    unknown = [name for i, name in enumerate(names) if i not in known]
    units = {match[3] for match in taxels.values()}
    if unknown or not taxels or not units <= {None, *_UNITS}:
        wrong = next((names[i] for i, m in taxels.items() if m[3] not in (None, *_UNITS)), names[0])
        raise not_understood(path, unknown[0] if unknown else wrong)
    if len(units) > 1:
        raise ValueError(
            f"'{path}', line 1 must have all readings in one unit (got "
            f"{sorted(str(unit) for unit in units)})"
        )
    if len(times) > 1:
        raise ValueError(
            f"'{path}', line 1 must have one column of the time (got "
            f"{', '.join(names[i] for i in times)})"
        )
    place = _placed(path, names, {i: (int(m[1]), m[2]) for i, m in taxels.items()})
    angle = _placed(path, names, {i: int(m[1]) for i, m in joints.items()})
    num_taxels, num_joints = len({taxel for taxel, _ in place}), len(angle)
    found_axes = {axis for _, axis in place}
    axes = _axes(len(found_axes))
    if found_axes != set(axes):
        raise ValueError(
            f"'{path}', line 1 must have the axes {', '.join(axes)} for taxels of {len(axes)} "
            f"channels (got {', '.join(sorted(found_axes)[:6])})"
        )
    # Not as a list, which a header of wrong numbers would make too large.
    wanted = ((taxel, axis) for taxel in range(num_taxels) for axis in axes)
    _refuse_gap(path, (f"taxel_{t}_{axis}" for t, axis in wanted if (t, axis) not in place))
    _refuse_gap(path, (f"joint_{joint}" for joint in range(num_joints) if joint not in angle))
    unit, per_unit = _UNITS.get(units.pop(), (None, 1.0))
    joint = [angle[i] for i in range(num_joints)]
    return WideColumns(
        names=names,
        sizes=(num_taxels, len(axes), num_joints),
        time=times[0] if times else None,
        time_unit=(time_unit(keys[times[0]]) if times else None) or "s",
        tactile=[place[taxel, axis] for taxel in range(num_taxels) for axis in axes],
        joint=joint,
        degrees=[i for i, column in enumerate(joint) if joints[column][2] == "deg"],
        unit=unit,
        per_unit=per_unit,
    )


def is_wide_name(name: str) -> bool:
    r"""Tells whether a name is meant as one of a taxel, with whatever behind it."""
    return re.match(r"taxel_[0-9]", name.strip().lower()) is not None


def not_understood(path: Path, name: str) -> ValueError:
    r"""Returns the error for a header with a name that is not known."""
    return ValueError(
        f"'{path}', line 1 must name the columns 'time', 'taxel_0_x', 'taxel_0_y', 'taxel_0_z', "
        "'taxel_1_x', ..., 'joint_0', ... in any order, with units 'time_ms', 'time_us', "
        "'time_ns', 'joint_0_deg', 'taxel_0_x_n', 'taxel_0_x_mn' or 'taxel_0_x_count' if they are "
        f"not s, rad and as the sensor gives them (got {quoted(name)}): rename the columns, or say "
        "what they are with read_named_csv(path, tactile=..., num_channels=..., joint=..., "
        "time=...) or the same options of tactile convert"
    )


def _axes(num_channels: int) -> list[str]:
    if num_channels <= len(_AXES):
        return list(_AXES[:num_channels])
    return [str(channel) for channel in range(num_channels)]


def _placed(path: Path, names: Sequence[str], keys: Mapping[int, _Key]) -> dict[_Key, int]:
    place: dict[_Key, int] = {}
    for column, key in keys.items():
        if key in place:
            raise ValueError(
                f"'{path}', line 1 must name each column once (got {quoted(names[place[key]])} and "
                f"{quoted(names[column])})"
            )
        place[key] = column
    return place


def _refuse_gap(path: Path, missing: Iterable[str]) -> None:
    name = next(iter(missing), None)
    if name is not None:
        raise ValueError(
            f"'{path}', line 1 must have the column '{name}': taxels and joints count from 0, "
            "without gaps, and each taxel has all axes"
        )
