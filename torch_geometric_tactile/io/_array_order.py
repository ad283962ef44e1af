r"""The order of an array's axes, as its owner states it."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_TOKEN = re.compile(r"\s*([()]|[a-z]+)")
_FIELD = re.compile(r"\s*(?P<names>[^\[\]]+?)\s*(?:\[(?P<order>[^\[\]]*)\])?\s*", re.DOTALL)


@dataclass(frozen=True)
class StoredArray:
    r"""Under which name, or names, an array is stored, and in which order."""

    names: tuple[str, ...]
    order: str | None = None

    @classmethod
    def of(cls, key: str, text: str) -> "StoredArray":
        r"""Reads :obj:`"NAME"`, :obj:`"NAME [ORDER]"` or :obj:`"LEFT | MIDDLE | RIGHT [ORDER]"`.

        Examples:
            >>> StoredArray.of("electrodes", "biotac/elec [frame (finger electrode)]")
            StoredArray(names=('biotac/elec',), order='frame (finger electrode)')
        """
        found = _FIELD.fullmatch(text) if isinstance(text, str) else None
        names = () if found is None else tuple(n.strip() for n in found["names"].split("|"))
        if found is None or len(names) not in (1, 3) or not all(names):
            raise ValueError(
                f"field '{key}' must be 'NAME', 'NAME [ORDER]' or 'LEFT | MIDDLE | RIGHT [ORDER]' "
                f"(got {text!r})"
            )
        return cls(names, found["order"])


def parsed_order(key: str, order: str, axes: Sequence[str]) -> list[list[str]]:
    r"""Returns the axes in each dimension.

    Examples:
        >>> parsed_order("electrodes", "frame (finger electrode)", ["frame", "electrode", "finger"])
        [['frame'], ['finger', 'electrode']]
    """
    tokens = _TOKEN.findall(order)
    groups: list[list[str]] = []
    inside = False
    wrong = "".join(tokens) != re.sub(r"\s", "", order)
    for token in tokens:
        if token in "()":
            wrong |= inside == (token == "(")
            inside = token == "("
            if inside:
                groups.append([])
        elif inside:
            groups[-1].append(token)
        else:
            groups.append([token])
    named = [axis for group in groups for axis in group]
    if wrong or inside or sorted(named) != sorted(axes) or not all(groups):
        raise ValueError(
            f"the order of '{key}' must name {', '.join(axes)}, each once, and those of one "
            f"dimension in brackets, such as '{_example(axes)}' (got {order!r})"
        )
    return groups


def arranged(
    where: str, array: np.ndarray, groups: Sequence[Sequence[str]], sizes: Mapping[str, int | None]
) -> np.ndarray:
    r"""Returns an array with one dimension for each axis, in the order of :obj:`sizes`."""
    stated = " ".join(g[0] if len(g) == 1 else f"({' '.join(g)})" for g in groups)
    if array.ndim != len(groups):
        raise ValueError(
            f"{where} must have {len(groups)} dimensions, '{stated}' (got shape {array.shape}): "
            "state its order after its name, as in "
            f"'NAME [{_example([*sizes])}]'"
        )
    found = dict(sizes)
    for group, length in zip(groups, array.shape, strict=True):
        known = math.prod(found[axis] or 1 for axis in group)
        free = [axis for axis in group if found[axis] is None]
        fits = length == known if not free else length % known == 0 and (length or "frame" in free)
        if not fits:
            product = " x ".join(str(found[axis] or "any number") for axis in group)
            total = f" = {known}" if not free and len(group) > 1 else ""
            raise ValueError(
                f"{where} must have {product}{total} rows of '{' '.join(group)}' in its shape, "
                f"'{stated}' (got shape {array.shape})"
            )
        for axis in free:
            found[axis] = length // known
    flat = [axis for group in groups for axis in group]
    split = array.reshape([found[axis] or 0 for axis in flat])
    return split.transpose([flat.index(axis) for axis in sizes])


def _example(axes: Sequence[str]) -> str:
    return " ".join(axes) if len(axes) < 3 else f"{axes[0]} ({' '.join(axes[1:])})"
