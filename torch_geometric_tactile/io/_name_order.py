r"""Orders of columns that the names of the columns contradict: sorted as texts where the names have
numbers, and one axis of all taxels after the other where each taxel should have all its axes.
"""

import re
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

from torch_geometric_tactile._texts import quoted, short_list

_NUMBER = re.compile(r"([0-9]{1,15})")
_WORD = re.compile(r"[^\W\d_]+")
_AXIS = re.compile(r"[a-z]?[xyz]")
_MAX_PERMUTED = 4  # numbers in a name, of which all orders are tried
_MAX_SHOWN = 8


def check_name_order(
    path: Path, argument: str, names: Sequence[str], num_channels: int = 1
) -> None:
    r"""Raises an error if columns in the order of a file are in another order than the numbers or
    axes in their names say. It is for columns that an expression, or nothing, chose; a list of
    names is a decision.

    Args:
        path (Path): The file, for the message.
        argument (str): The argument that chooses the columns, for the message.
        names (sequence of str): The names, in the order of the file.
        num_channels (int): How many columns in a row a taxel has.

    Raises:
        ValueError: If names that differ in their numbers are sorted as texts and not as numbers, or
            if all taxels of one axis follow each other although a taxel has several channels.

    Examples:
        >>> check_name_order(Path("a.csv"), "tactile", ["s1", "s2", "s10"])
        >>> try:
        ...     check_name_order(Path("a.csv"), "tactile", ["s1", "s10", "s2"])
        ... except ValueError as error:
        ...     print(str(error).partition("give ")[2].partition(", or")[0])
        tactile=['s1', 's2', 's10']
    """
    keys = [name.casefold() for name in names]
    by_number = _order_of_numbers(keys)
    if by_number is not None:
        order = [names[i] for i in by_number]
        raise _contradiction(path, argument, names, order, "of texts and not of the numbers in")
    if _is_axis_major(keys, num_channels):
        num_taxels = len(names) // num_channels
        order = [name for taxel in range(num_taxels) for name in names[taxel::num_taxels]]
        kind = f"of one axis after the other and not of taxels with {num_channels} channels, as in"
        raise _contradiction(path, argument, names, order, kind)


def _contradiction(
    path: Path, argument: str, names: Sequence[str], order: Sequence[str], kind: str
) -> ValueError:
    def listed(names: Sequence[str]) -> str:
        return short_list(names, _MAX_SHOWN, lambda name: quoted(name)[1:-1], ending=", ...")

    items = short_list(order, _MAX_SHOWN, quoted, ending=", ...")
    return ValueError(
        f"'{argument}' must list the columns of '{path}' in the order of the layout, since their "
        f"order in the file, {listed(names)}, is that {kind} the names, {listed(order)}: give "
        f"{argument}=[{items}], or the list in the order of the file if that is right"
    )


def _order_of_numbers(keys: Sequence[str]) -> list[int] | None:
    # The places in the order of the numbers, if the names of some columns contradict theirs.
    groups: dict[tuple[str, ...], list[int]] = {}
    for i, key in enumerate(keys):
        groups.setdefault(tuple(_NUMBER.split(key)[::2]), []).append(i)
    order = [*range(len(keys))]
    is_wrong = False
    for places in groups.values():
        if _is_sorted_as_text([keys[i] for i in places]):
            is_wrong = True
            numbers = {i: [int(n) for n in _NUMBER.findall(keys[i])] for i in places}
            for place, i in zip(places, sorted(places, key=numbers.__getitem__), strict=True):
                order[place] = i
    return order if is_wrong else None


def _is_sorted_as_text(keys: Sequence[str]) -> bool:
    texts = [_NUMBER.findall(key) for key in keys]
    num_numbers = len(texts[0])
    if len(keys) < 3 or not num_numbers:
        return False
    # Several numbers, as of rows and columns, may be sorted by any of them first.
    orders = [*permutations(range(min(num_numbers, _MAX_PERMUTED)))]
    as_texts = [[[text[k] for k in order] for text in texts] for order in orders]
    as_numbers = [[[int(n) for n in row] for row in rows] for rows in as_texts]
    if any(rows in (sorted(rows), sorted(rows)[::-1]) for rows in as_numbers):
        return False
    return [*keys] == sorted(keys) or any(rows == sorted(rows) for rows in as_texts)


def _is_axis_major(keys: Sequence[str], num_channels: int) -> bool:
    num_taxels = len(keys) // num_channels
    if num_channels < 2 or num_taxels < 2 or len(keys) % num_channels:
        return False
    axes = {tuple(_differing_parts(keys[i::num_taxels])) for i in range(num_taxels)}
    if len(axes) > 1:
        return False
    (parts,) = axes
    if len({*parts}) < num_channels or not all(part.isalpha() for part, _ in parts):
        return False
    if all(part in ("x", "y", "z") or _AXIS.fullmatch(word) for part, word in parts):
        return True
    # Other words are axes if the numbers of the taxels begin anew with each. Where a word has a
    # multiple of the channels, it may also be a part of the sensor with counted columns.
    rows = [keys[i : i + num_taxels] for i in range(0, len(keys), num_taxels)]
    is_running = all(_is_running(row) for row in rows)
    is_letter = all(len(word) == 1 for _, word in parts) and num_taxels != num_channels
    return is_running and (num_taxels % num_channels != 0 or is_letter)


def _differing_parts(keys: Sequence[str]) -> list[tuple[str, str]]:
    # Of each name, the text in which it differs from the others, and the word that has it.
    start = _num_common(keys)
    end = _num_common([key[start:][::-1] for key in keys])
    out = []
    for key in keys:
        stop = len(key) - end
        words = _WORD.finditer(key)
        word = next((m[0] for m in words if m.start() <= start and stop <= m.end()), "")
        out.append((key[start:stop], word))
    return out


def _num_common(keys: Sequence[str]) -> int:
    # How many letters all of them begin with.
    shortest = min(map(len, keys))
    return next((i for i in range(shortest) if len({key[i] for key in keys}) > 1), shortest)


def _is_running(keys: Sequence[str]) -> bool:
    texts = {tuple(_NUMBER.split(key)[::2]) for key in keys}
    numbers = [[int(n) for n in _NUMBER.findall(key)] for key in keys]
    return len(texts) == 1 and numbers == sorted(numbers)
