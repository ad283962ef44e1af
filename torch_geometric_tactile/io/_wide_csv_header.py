r"""Names of the columns of CSV files with one frame a row: which column is what, in which unit."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.io._csv_frames import FrameColumns, time_unit_of
from torch_geometric_tactile.io._csv_table import placed

_HAND = {"num_taxels": 384, "num_channels": 3, "num_joints": 16}
HAND_COLUMNS = 384 * 3 + 16
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


def wide_csv_header(num_taxels: int, num_channels: int, num_joints: int = 0) -> list[str]:
    r"""Returns the names of the columns: :obj:`time`, :obj:`taxel_0_x`, ..., :obj:`joint_0`, ...

    Examples:
        >>> wide_csv_header(1, 2, 1)
        ['time', 'taxel_0_x', 'taxel_0_y', 'joint_0']

    Shapes:
        - **num_taxels:** Number of taxels :math:`N`.
        - **num_channels:** Number of channels of a taxel :math:`C`; up to three are axes.
        - **num_joints:** Number of joints :math:`J`.
    """
    return ["time", *_names(num_taxels, num_channels, num_joints)]


def _names(num_taxels: int, num_channels: int, num_joints: int) -> Iterator[str]:
    axes = _axes(num_channels)
    yield from (f"taxel_{taxel}_{axis}" for taxel in range(num_taxels) for axis in axes)
    yield from (f"joint_{joint}" for joint in range(num_joints))


def columns_by_place(path: Path, width: int, sizes: Mapping[str, int | None]) -> FrameColumns:
    r"""Returns the columns of a file without names: those of :func:`wide_csv_header`."""
    taxels, channels, joints = (
        _HAND[name] if size is None else size for name, size in sizes.items()
    )
    num_readings = taxels * channels
    first = width - num_readings - joints
    if first not in (0, 1):
        raise ValueError(
            f"'{path}', line 1 must have {num_readings + joints} cells for {taxels} taxels of "
            f"{channels} channels and {joints} joints, or {num_readings + joints + 1} with the "
            f"time (got {width}): name the columns as write_wide_csv does, or give num_taxels, "
            "num_channels and num_joints (tactile convert: --num-taxels, --num-channels, "
            "--num-joints)"
        )
    return FrameColumns(
        names=wide_csv_header(taxels, channels, joints)[1 - first :],
        tactile=[*range(first, first + num_readings)],
        num_channels=channels,
        joint=[*range(first + num_readings, width)],
        degrees=[],
        time=0 if first else None,
        time_unit="s",
    )


def columns_by_name(path: Path, names: list[str], sizes: Mapping[str, int | None]) -> FrameColumns:
    r"""Returns the columns that a header names, which may be in any order; :obj:`sizes` are those
    that are given, and must be its own.
    """
    keys = [name.lower() for name in names]
    times = [i for i, key in enumerate(keys) if time_unit_of(key)]
    taxels = {i: match for i, key in enumerate(keys) if (match := _TAXEL.fullmatch(key))}
    joints = {i: match for i, key in enumerate(keys) if (match := _JOINT.fullmatch(key))}
    known = {*times, *taxels, *joints}
    unknown = [name for i, name in enumerate(names) if i not in known]
    units = {match[3] for match in taxels.values()}
    if unknown or not taxels or not units <= {None, *_UNITS}:
        wrong = next((names[i] for i, m in taxels.items() if m[3] not in (None, *_UNITS)), names[0])
        raise _not_understood(path, unknown[0] if unknown else wrong)
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
    meant = {i: f"taxel_{int(m[1])}_{m[2]}" for i, m in taxels.items()}
    place = placed(path, names, meant | {i: f"joint_{int(m[1])}" for i, m in joints.items()})
    found_axes = {match[2] for match in taxels.values()}
    axes = _axes(len(found_axes))
    if found_axes != set(axes):
        raise ValueError(
            f"'{path}', line 1 must have the axes {', '.join(axes)} for taxels of {len(axes)} "
            f"channels (got {', '.join(sorted(found_axes)[:6])})"
        )
    own = (len({int(match[1]) for match in taxels.values()}), len(axes), len(joints))
    # Not as a list, which a header of wrong numbers would make too large.
    missing = next((name for name in _names(*own) if name not in place), None)
    if missing is not None:
        raise ValueError(
            f"'{path}', line 1 must have the column '{missing}': taxels and joints count from 0, "
            "without gaps, and each taxel has all axes"
        )
    for (name, size), found in zip(sizes.items(), own, strict=True):
        if size not in (None, found):
            raise ValueError(f"'{name}' must be {found}, as '{path}' has (got {size})")
    columns = [place[name] for name in _names(*own)]
    joint = columns[len(taxels) :]
    unit, per_unit = _UNITS.get(units.pop(), (None, 1.0))
    return FrameColumns(
        names=names,
        tactile=columns[: len(taxels)],
        num_channels=len(axes),
        joint=joint,
        degrees=[i for i, column in enumerate(joint) if joints[column][2] == "deg"],
        time=times[0] if times else None,
        time_unit=(time_unit_of(keys[times[0]]) if times else None) or "s",
        unit=unit,
        per_unit=per_unit,
    )


def is_wide_name(name: str) -> bool:
    r"""Tells whether a name is meant as one of a taxel, with whatever behind it."""
    return re.match(r"taxel_[0-9]", name.strip().lower()) is not None


def _not_understood(path: Path, name: str) -> ValueError:
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
