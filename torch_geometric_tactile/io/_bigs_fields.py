r"""The fields of a file of the BiGS data set, found and brought into one order."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.io._array_order import arranged, parsed_order
from torch_geometric_tactile.io._field_file import read_fields
from torch_geometric_tactile.io.bigs_format import (
    ARRAYS,
    FINGERS,
    NUM_ELECTRODES,
    VALUES,
    BiGSFormat,
)


class BiGSFields:
    r"""The fields of one file."""

    def __init__(self, path: Path, layout: BiGSFormat) -> None:
        self.path = path
        self.layout = layout
        stored = {key: layout.stored(key) for key in (*ARRAYS, *VALUES) if key not in layout.values}
        self.stored = stored
        self.arrays, self.names = read_fields(
            path, [name for s in stored.values() for name in s.names]
        )
        name = re.fullmatch(layout.pattern, path.stem)
        said = {} if name is None else name.groupdict()
        self.said = {key: value for key, value in said.items() if value is not None}

    def where(self, key: str) -> str:
        r"""Returns file and field for messages."""
        names = " | ".join(self.stored[key].names) if key in self.stored else key
        return f"'{self.path}': '{key}'" + (f" (in {quoted(names)})" if names != key else "")

    def missing(self, key: str) -> ValueError:
        r"""Returns the error for a field that is not there."""
        if key == "electrodes" and {"format", "@format"} & {*self.names}:
            return ValueError(
                f"{self.where(key)} must be there (got a recording): a file that is in the neutral "
                "form already needs no conversion and no 'fields'"
            )
        return ValueError(
            f"{self.where(key)} must be there (got a file with "
            f"{', '.join(map(quoted, self.names)) or 'nothing'}): state its name, as in "
            f"fields={{'{key}': 'NAME'}} or --field {key}=NAME"
        )

    def array(self, key: str, sizes: dict[str, int | None]) -> np.ndarray | None:
        r"""Returns an array in our order, or nothing if it is not there."""
        stored = self.stored[key]
        there = [self.arrays[name] for name in stored.names if name in self.arrays]
        if len(there) < len(stored.names):
            if key in self.layout.fields:
                raise self.missing(key)
            return None
        axes = self.layout.axes(key, stored)
        groups = (
            [[axis] for axis in axes]
            if stored.order is None
            else parsed_order(key, stored.order, axes)
        )
        known: dict[str, int | None] = {
            "electrode": NUM_ELECTRODES,
            "finger": len(FINGERS),
            "step": self.layout.steps(key) if "step" in axes else None,
            "joint": None,
            "value": 7,
            **sizes,
        }
        wanted = {axis: known[axis] for axis in axes}
        parts = []
        for array in there:
            part = arranged(self.where(key), self._numbers(key, array), groups, wanted)
            parts.append(part)
            wanted = dict(zip(axes, part.shape, strict=True))
        if len(parts) == 1:
            return np.ascontiguousarray(self._in_order(axes, parts[0]))
        return np.stack(parts, axis=ARRAYS[key].index("finger"))

    def _in_order(self, axes: tuple[str, ...], array: np.ndarray) -> np.ndarray:
        given = self.layout.fingers.split()
        if "finger" not in axes or given == [*FINGERS]:
            return array
        places = [given.index(finger) for finger in FINGERS]
        return array.take(places, axis=axes.index("finger"))

    def _numbers(self, key: str, array: np.ndarray) -> np.ndarray:
        if array.dtype.kind not in ("biuf" if key == "slip" else "iuf"):
            raise ValueError(f"{self.where(key)} must hold numbers (got {array.dtype})")
        if array.dtype.kind != "f":
            return array
        with np.errstate(over="ignore"):
            numbers = array.astype(np.float64 if key == "time" else np.float32, copy=False)
        if np.isinf(numbers).any():
            raise ValueError(
                f"{self.where(key)} must hold finite numbers, or NaN where one is missing (got "
                "infinity)"
            )
        return numbers

    def value(self, key: str) -> Any:
        r"""Returns a single value: what is stated for all files, then what the file holds, then
        what its name tells; nothing if none of them does.
        """
        if key in self.layout.values:
            return self.layout.values[key]
        (name,) = self.stored[key].names
        if name not in self.arrays:
            if key in self.layout.fields:
                raise self.missing(key)
            return self.said.get(key)
        array = self.arrays[name]
        if array.size != 1:
            raise ValueError(f"{self.where(key)} must be one value (got shape {array.shape})")
        return array.reshape(-1)[0].item()
