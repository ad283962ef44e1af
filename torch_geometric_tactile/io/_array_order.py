r"""The order of the axes of an array, as stated in a format file."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_TOKEN = re.compile(r"\s*([()]|[a-z]+)")
_FIELD = re.compile(r"\s*(?P<names>[^\[\]]+?)\s*(?:\[(?P<order>[^\[\]]*)\])?\s*", re.DOTALL)


@dataclass(frozen=True)
class StoredArray:
    r"""The name of an array in a file (or its three names), and the order of its axes.

    Args:
        names (tuple of str): One name, or the names for the left, middle and right finger.
        order (str, optional): The order of the axes. :obj:`None` is the default order.
    """

    names: tuple[str, ...]
    order: str | None = None

    @classmethod
    def from_text(cls, key: str, text: str) -> "StoredArray":
        r"""Parses :obj:`"NAME"`, :obj:`"NAME [ORDER]"` or :obj:`"LEFT | MIDDLE | RIGHT [ORDER]"`.

        Examples:
            >>> StoredArray.from_text("electrodes", "biotac/elec [frame (finger electrode)]")
            StoredArray(names=('biotac/elec',), order='frame (finger electrode)')
        """
        match = _FIELD.fullmatch(text) if isinstance(text, str) else None
        names = () if match is None else tuple(n.strip() for n in match["names"].split("|"))
        if match is None or len(names) not in (1, 3) or not all(names):
            raise ValueError(
                f"field '{key}' must be 'NAME', 'NAME [ORDER]' or 'LEFT | MIDDLE | RIGHT [ORDER]' "
                f"(got {text!r})"
            )
        return cls(names, match["order"])


def parse_axis_order(key: str, order: str, axes: Sequence[str]) -> list[list[str]]:
    r"""Parses the order of the axes, and returns the axes in each dimension.

    Examples:
        >>> axes = ["frame", "electrode", "finger"]
        >>> parse_axis_order("electrodes", "frame (finger electrode)", axes)
        [['frame'], ['finger', 'electrode']]
    """
    tokens = _TOKEN.findall(order)
    groups: list[list[str]] = []
    in_group = False
    is_invalid = "".join(tokens) != re.sub(r"\s", "", order)
    for token in tokens:
        if token in "()":
            is_invalid |= in_group == (token == "(")
            in_group = token == "("
            if in_group:
                groups.append([])
        elif in_group:
            groups[-1].append(token)
        else:
            groups.append([token])
    ordered_axes = [axis for group in groups for axis in group]
    if is_invalid or in_group or sorted(ordered_axes) != sorted(axes) or not all(groups):
        raise ValueError(
            f"the order of '{key}' must name {', '.join(axes)}, each once, with the axes of one "
            f"dimension in parentheses, such as '{_example_order(axes)}' (got {order!r})"
        )
    return groups


def to_axes(
    where: str, array: np.ndarray, groups: Sequence[Sequence[str]], sizes: Mapping[str, int | None]
) -> np.ndarray:
    r"""Reshapes and transposes an array to one dimension for each axis, in the order of
    :obj:`sizes`.

    Args:
        where (str): Description of the array, for messages.
        array (numpy.ndarray): The array as stored.
        groups (sequence of sequence of str): The axes in each dimension of :obj:`array`.
        sizes (mapping): Maps each axis to its size, or to :obj:`None` if any size is valid.

    Raises:
        ValueError: If the shape of the array does not match.
    """
    order = " ".join(g[0] if len(g) == 1 else f"({' '.join(g)})" for g in groups)
    if array.ndim != len(groups):
        raise ValueError(
            f"{where} must have {len(groups)} dimensions, '{order}' (got shape {array.shape}): "
            "state the order of its axes after its name, as in "
            f"'NAME [{_example_order([*sizes])}]'"
        )
    axis_sizes = dict(sizes)
    for group, length in zip(groups, array.shape, strict=True):
        # An unknown size follows from the others. Only the number of frames may be zero.
        known_size = math.prod(axis_sizes[axis] or 1 for axis in group)
        unknown_axes = [axis for axis in group if axis_sizes[axis] is None]
        fits = (
            length == known_size
            if not unknown_axes
            else length % known_size == 0 and (length or "frame" in unknown_axes)
        )
        if not fits:
            expected = " x ".join(str(axis_sizes[axis] or "any number") for axis in group)
            total = f" = {known_size}" if not unknown_axes and len(group) > 1 else ""
            raise ValueError(
                f"{where} must have {expected}{total} rows of '{' '.join(group)}' in its shape, "
                f"'{order}' (got shape {array.shape})"
            )
        for axis in unknown_axes:
            axis_sizes[axis] = length // known_size
    stored_axes = [axis for group in groups for axis in group]
    unpacked_array = array.reshape([axis_sizes[axis] or 0 for axis in stored_axes])
    return unpacked_array.transpose([stored_axes.index(axis) for axis in sizes])


def _example_order(axes: Sequence[str]) -> str:
    return " ".join(axes) if len(axes) < 3 else f"{axes[0]} ({' '.join(axes[1:])})"
