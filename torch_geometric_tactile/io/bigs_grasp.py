r"""Reader of the grasps of the BiGS data set, with one HDF5 or npz file per grasp."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._array_order import parse_axis_order, to_axes
from torch_geometric_tactile.io._field_file import read_fields
from torch_geometric_tactile.io.bigs_format import (
    ARRAYS,
    FINGERS,
    NUM_ELECTRODES,
    VALUES,
    BiGSFormat,
)

_OUTCOMES = ("failure", "success")
_FULL_TURN = 2 * math.pi * (1 + 1e-6)  # with the rounding of float32
_RATE_TOLERANCE = 0.1  # relative, between the stated rate and the rate of the times
_EXTRA = ("pressure", "pac", "robot_joint", "finger_joint", "wrench")
_NUM_VALUES = {"wrench": 6, "object_pose": 7}


def read_bigs(path: PathLike, layout: BiGSFormat | None = None) -> Recording:
    r"""Reads a grasp of the BiGS data set from an HDF5 or npz file. A :class:`BiGSFormat` describes
    the names, axis orders and units in the file.

    Args:
        path (str or PathLike): An HDF5 or npz file with one grasp.
        layout (BiGSFormat, optional): Names, axis orders, units and rates of the file. Defaults to
            the values of :class:`BiGSFormat`.

    Returns:
        Recording: The recording that :class:`~torch_geometric_tactile.datasets.BiGS` reads from
        files of :func:`~torch_geometric_tactile.io.write_recording`.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If h5py is missing for an HDF5 file.
        ValueError: If the file is truncated or damaged, a field is missing, an array does not have
            the stated shape or length, times do not increase or do not match the rate, or the
            outcome is not a truth value. The message names file and field.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> time, electrodes = np.arange(60) / 100, np.full((60, 19, 3), 2000, np.int16)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "ball_003.npz"
        ...     single = {"success": 1, "object": "ball", "trial": 3, "pickup_time": 0.3}
        ...     np.savez(path, time=time, electrodes=electrodes, **single)
        ...     recording = read_bigs(path)
        >>> recording.tactile.shape, recording.label
        ((60, 19, 3), 'success')
    """
    path = Path(path)
    return _Grasp(path, layout or BiGSFormat()).recording()


class _Fields:
    r"""The fields of one file, in the neutral order."""

    def __init__(self, path: Path, layout: BiGSFormat) -> None:
        self.path = path
        self.layout = layout
        stored = {key: layout.stored(key) for key in (*ARRAYS, *VALUES) if key not in layout.values}
        self.stored = stored
        self.arrays, self.names = read_fields(
            path, [name for s in stored.values() for name in s.names]
        )
        match = re.fullmatch(layout.pattern, path.stem)
        groups = {} if match is None else match.groupdict()
        self.name_values = {key: value for key, value in groups.items() if value is not None}

    def where(self, key: str) -> str:
        r"""Returns a description of file and field for messages."""
        names = " | ".join(self.stored[key].names) if key in self.stored else key
        return f"'{self.path}': '{key}'" + (f" (in {quoted(names)})" if names != key else "")

    def missing(self, key: str) -> ValueError:
        r"""Returns the error for a missing field."""
        if key == "electrodes" and {"format", "@format"} & {*self.names}:
            return ValueError(
                f"{self.where(key)} must be in the file (got a recording): this file needs no "
                "conversion and no 'fields'"
            )
        return ValueError(
            f"{self.where(key)} must be in the file (got only "
            f"{', '.join(map(quoted, self.names)) or 'nothing'}): state its name, as in "
            f"fields={{'{key}': 'NAME'}} or --field {key}=NAME"
        )

    def array(self, key: str, sizes: dict[str, int | None]) -> np.ndarray | None:
        r"""Returns an array in the neutral order, or :obj:`None` if it is missing."""
        stored = self.stored[key]
        arrays = [self.arrays[name] for name in stored.names if name in self.arrays]
        if len(arrays) < len(stored.names):
            if key in self.layout.fields:
                raise self.missing(key)
            return None
        axes = self.layout.axes(key, stored)
        groups = [[axis] for axis in axes]
        if stored.order is not None:
            groups = parse_axis_order(key, stored.order, axes)
        size_of_axis: dict[str, int | None] = {
            "electrode": NUM_ELECTRODES,
            "finger": len(FINGERS),
            "step": self.layout.steps(key) if "step" in axes else None,
            "joint": None,
            "value": _NUM_VALUES.get(key),
            **sizes,
        }
        expected_sizes = {axis: size_of_axis[axis] for axis in axes}
        parts = []
        for array in arrays:
            part = to_axes(self.where(key), self._to_numbers(key, array), groups, expected_sizes)
            parts.append(part)
            expected_sizes = dict(zip(axes, part.shape, strict=True))
        if len(parts) == 1:
            return np.ascontiguousarray(self._reorder_fingers(axes, parts[0]))
        return np.stack(parts, axis=ARRAYS[key].index("finger"))

    def _reorder_fingers(self, axes: tuple[str, ...], array: np.ndarray) -> np.ndarray:
        stored_order = self.layout.fingers.split()
        if "finger" not in axes or stored_order == [*FINGERS]:
            return array
        finger_indices = [stored_order.index(finger) for finger in FINGERS]
        return array.take(finger_indices, axis=axes.index("finger"))

    def _to_numbers(self, key: str, array: np.ndarray) -> np.ndarray:
        if array.dtype.kind not in ("biuf" if key == "slip" else "iuf"):
            raise ValueError(f"{self.where(key)} must hold numbers (got {array.dtype})")
        if array.dtype.kind != "f":
            return array
        with np.errstate(over="ignore"):
            numbers = array.astype(np.float64 if key == "time" else np.float32, copy=False)
        if np.isinf(numbers).any():
            raise ValueError(
                f"{self.where(key)} must hold finite numbers, or NaN for missing ones (got "
                "infinity)"
            )
        return numbers

    def value(self, key: str) -> Any:
        r"""Returns a single value from the format, the file or the name of the file, in this order,
        or :obj:`None` if none of them has it.
        """
        if key in self.layout.values:
            return self.layout.values[key]
        (name,) = self.stored[key].names
        if name not in self.arrays:
            if key in self.layout.fields:
                raise self.missing(key)
            return self.name_values.get(key)
        array = self.arrays[name]
        if array.size != 1:
            raise ValueError(f"{self.where(key)} must be one value (got shape {array.shape})")
        return array.reshape(-1)[0].item()


class _Grasp(_Fields):
    def recording(self) -> Recording:
        tactile = self.array("electrodes", {"frame": None})
        if tactile is None:
            raise self.missing("electrodes")
        num_frames = len(tactile)
        if num_frames == 0:
            raise ValueError(f"{self.where('electrodes')} must hold at least one frame (got none)")
        time = self.time(num_frames)
        extra, privileged = {}, {}
        for key in _EXTRA:
            array = self.array(key, {"frame": num_frames})
            if array is not None:
                extra[key] = self.angles(key, array) if key.endswith("joint") else array
        pose = self.array("object_pose", {"frame": num_frames})
        if pose is not None:
            privileged["object_pose"] = self.pose(pose)
        slip = self.array("slip", {"frame": num_frames})
        if slip is not None:
            privileged["slip"] = self.slip(slip)
        meta = self.meta(time)
        phase = self.phase(num_frames)
        if phase is not None:
            privileged["phase"], meta["phase_names"] = phase
        try:
            return Recording(
                time=time,
                tactile=tactile,
                label=_OUTCOMES[self.success()],
                meta=meta,
                privileged=privileged,
                extra=extra,
            )
        except ValueError as error:
            message = str(error) if f"'{self.path}'" in str(error) else f"'{self.path}': {error}"
            raise ValueError(message) from error

    def time(self, num_frames: int) -> np.ndarray:
        time = self.array("time", {"frame": num_frames})
        if time is None:
            return np.arange(num_frames) / self.layout.rate
        if time.dtype.kind != "f" and self.layout.time_unit is None:
            raise ValueError(
                f"{self.where('time')} must be seconds as floats, or have its unit stated as "
                f"'time_unit' (got {time.dtype})"
            )
        time = time / self.layout.per_second
        if np.isnan(time).any():
            raise ValueError(f"{self.where('time')} must be finite (got NaN)")
        backward = np.flatnonzero(np.diff(time) <= 0)
        if len(backward):
            previous, frame = backward[0], backward[0] + 1
            raise ValueError(
                f"{self.where('time')} must increase (got {float(time[frame])} s in frame {frame} "
                f"after {float(time[previous])} s in frame {previous})"
            )
        if num_frames > 1:
            measured_rate = 1 / float(np.median(np.diff(time)))
            if abs(measured_rate / self.layout.rate - 1) > _RATE_TOLERANCE:
                raise ValueError(
                    f"{self.where('time')} must agree with the rate of {self.layout.rate:g} frames "
                    f"per second (got {measured_rate:.4g}): state 'rate', or the 'time_unit'"
                )
        return np.asarray(time)

    def angles(self, key: str, array: np.ndarray) -> np.ndarray:
        if self.layout.angle_unit == "deg":
            return np.deg2rad(array).astype(np.float32)
        largest = float(np.nanmax(np.abs(array), initial=0.0))
        if largest > _FULL_TURN:
            raise ValueError(
                f"{self.where(key)} must be in radians (got {largest:.4g}, more than a full turn): "
                "if these are degrees, state angle_unit='deg'"
            )
        return array.astype(np.float32)

    def pose(self, pose: np.ndarray) -> np.ndarray:
        pose = pose.astype(np.float32)
        position, quaternion = pose[:, :3] / self.layout.per_metre, pose[:, 3:]
        # Recordings have quaternions in the order w, x, y, z.
        if self.layout.quaternion == "xyzw":
            quaternion = quaternion[:, [3, 0, 1, 2]]
        length = np.linalg.norm(quaternion, axis=1)
        invalid = np.flatnonzero(np.abs(length - 1) > 0.01)
        if len(invalid):
            raise ValueError(
                f"{self.where('object_pose')} must hold a position and a quaternion of length 1 "
                f"(got {length[invalid[0]]:.4g} in frame {invalid[0]})"
            )
        return np.concatenate([position, quaternion], axis=1)

    def slip(self, slip: np.ndarray) -> np.ndarray:
        invalid = slip[~np.isin(slip, (-1, 0, 1))]
        if len(invalid):
            raise ValueError(
                f"{self.where('slip')} must be 0, 1, or -1 if unknown (got {invalid[0]:g})"
            )
        return slip.astype(np.int8)

    def phase(self, num_frames: int) -> tuple[np.ndarray, list[str]] | None:
        (name,) = self.stored["phase"].names
        if name not in self.arrays:
            if "phase" in self.layout.fields:
                raise self.missing("phase")
            return None
        phase = self.arrays[name]
        if phase.dtype.kind != "U" or phase.shape != (num_frames,):
            raise ValueError(
                f"{self.where('phase')} must hold the name of a phase for each of {num_frames} "
                f"frames (got {phase.dtype} of shape {phase.shape})"
            )
        names = [*dict.fromkeys(phase.tolist())]
        index_of_name = {text: i for i, text in enumerate(names)}
        return np.array([index_of_name[text] for text in phase.tolist()], dtype=np.int16), names

    def success(self) -> int:
        value = self.value("success")
        if value is None:
            raise self.missing("success")
        key = value.strip().lower() if isinstance(value, str) else value
        index_of_outcome: dict[Any, int] = {"failure": 0, "success": 1, "0": 0, "1": 1, 0: 0, 1: 1}
        if key not in index_of_outcome:  # 'in' and the lookup also accept True and 1.0
            raise ValueError(
                f"{self.where('success')} must be a truth value (0, 1, 'failure' or 'success') "
                f"(got {value!r})"
            )
        return index_of_outcome[key]

    def meta(self, time: np.ndarray) -> dict[str, Any]:
        metadata: dict[str, Any] = {
            "sensor": "biotac",
            "unit": "count",
            "rate": self.layout.rate,
            "source": self.path.name,
        }
        for key, types in (("object", str), ("trial", int), ("session", str | int)):
            value = self.value(key)
            if key == "trial" and isinstance(value, str) and re.fullmatch("[0-9]{1,9}", value):
                value = int(value)
            if value is not None and (not isinstance(value, types) or isinstance(value, bool)):
                expected = "an integer" if types is int else "a string"
                raise ValueError(f"{self.where(key)} must be {expected} (got {value!r})")
            if key == "object" and value is None:
                raise self.missing("object")
            if key == "object" and not value:
                raise ValueError(f"{self.where('object')} must not be empty (got '')")
            if value in (None, ""):
                continue
            metadata[key] = value
        pickup = self.value("pickup_time")
        if pickup is not None:
            metadata["pickup_time"] = self.pickup(pickup, time)
        elif self.layout.ends_after_pickup is not None:
            metadata["ends_after_pickup"] = self.layout.ends_after_pickup
        return metadata

    def pickup(self, value: Any, time: np.ndarray) -> float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        seconds = value / self.layout.per_second if is_number else math.nan
        if not time[0] <= seconds <= time[-1]:
            raise ValueError(
                f"{self.where('pickup_time')} must be a time during the grasp, on the clock of its "
                f"frames: {float(time[0])} to {float(time[-1])} s (got {value!r})"
            )
        return float(seconds)
