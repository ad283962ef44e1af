r"""Detection of columns in an unexpected order: sorted as text although their names have numbers,
or by axis although each taxel should have its axes in consecutive columns.
"""

import re
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

from torch_geometric_tactile._texts import quoted, short_list

_NUMBER = re.compile(r"([0-9]{1,15})")
_WORD = re.compile(r"[^\W\d_]+")
_AXIS = re.compile(r"[a-z]?[xyz]")
_MAX_PERMUTED = 4  # numbers in a name for which all orders are tried
_MAX_LISTED = 8


def check_name_order(
    path: Path, argument: str, names: Sequence[str], num_channels: int = 1
) -> None:
    r"""Raises an error if the order of columns in a file contradicts the numbers or axes in their
    names. Use it for columns that are selected by an expression or by default. The order of an
    explicit list of names needs no check.

    Args:
        path (Path): The file, for the message.
        argument (str): The argument that selects the columns, for the message.
        names (sequence of str): The names, in the order of the file.
        num_channels (int): Number of consecutive columns of a taxel.

    Raises:
        ValueError: If names with numbers are sorted as text, or if the columns are sorted by axis
            although a taxel has several channels.

    Examples:
        >>> check_name_order(Path("a.csv"), "tactile", ["s1", "s2", "s10"])
        >>> try:
        ...     check_name_order(Path("a.csv"), "tactile", ["s1", "s10", "s2"])
        ... except ValueError as error:
        ...     print(str(error).partition("give ")[2].partition(", or")[0])
        tactile=['s1', 's2', 's10']
    """
    keys = [name.casefold() for name in names]
    numeric_order = _numeric_order(keys)
    if numeric_order is not None:
        order = [names[i] for i in numeric_order]
        raise _order_error(path, argument, names, order, "as text", "by number")
    if _is_axis_major(keys, num_channels):
        num_taxels = len(names) // num_channels
        order = [name for taxel in range(num_taxels) for name in names[taxel::num_taxels]]
        raise _order_error(path, argument, names, order, "by axis", "by taxel")


def _order_error(
    path: Path,
    argument: str,
    names: Sequence[str],
    order: Sequence[str],
    file_order: str,
    expected_order: str,
) -> ValueError:
    def join_names(names: Sequence[str]) -> str:
        return short_list(names, _MAX_LISTED, lambda name: quoted(name)[1:-1], ending=", ...")

    quoted_names = short_list(order, _MAX_LISTED, quoted, ending=", ...")
    return ValueError(
        f"'{argument}' must list the columns of '{path}' in the order of the layout, since the "
        f"file has them sorted {file_order} ({join_names(names)}) and not {expected_order} "
        f"({join_names(order)}): give {argument}=[{quoted_names}], or the list in the order of the "
        "file if that order is correct"
    )


def _numeric_order(keys: Sequence[str]) -> list[int] | None:
    # The column indices sorted by the numbers in the names, or None if the order is already right.
    indices_by_text: dict[tuple[str, ...], list[int]] = {}
    for i, key in enumerate(keys):
        indices_by_text.setdefault(tuple(_NUMBER.split(key)[::2]), []).append(i)
    order = [*range(len(keys))]
    is_unsorted = False
    for indices in indices_by_text.values():
        if _is_sorted_as_text([keys[i] for i in indices]):
            is_unsorted = True
            numbers = {i: [int(n) for n in _NUMBER.findall(keys[i])] for i in indices}
            for target, i in zip(indices, sorted(indices, key=numbers.__getitem__), strict=True):
                order[target] = i
    return order if is_unsorted else None


def _is_sorted_as_text(keys: Sequence[str]) -> bool:
    texts = [_NUMBER.findall(key) for key in keys]
    num_numbers = len(texts[0])
    if len(keys) < 3 or not num_numbers:
        return False
    # Several numbers, such as row and column, may be sorted by any of them first.
    orders = [*permutations(range(min(num_numbers, _MAX_PERMUTED)))]
    text_rows = [[[text[k] for k in order] for text in texts] for order in orders]
    number_rows = [[[int(n) for n in row] for row in rows] for rows in text_rows]
    if any(rows in (sorted(rows), sorted(rows)[::-1]) for rows in number_rows):
        return False
    return [*keys] == sorted(keys) or any(rows == sorted(rows) for rows in text_rows)


def _is_axis_major(keys: Sequence[str], num_channels: int) -> bool:
    num_taxels = len(keys) // num_channels
    if num_channels < 2 or num_taxels < 2 or len(keys) % num_channels:
        return False
    axis_names = {tuple(_differing_parts(keys[i::num_taxels])) for i in range(num_taxels)}
    if len(axis_names) > 1:
        return False
    (parts,) = axis_names
    if len({*parts}) < num_channels or not all(part.isalpha() for part, _ in parts):
        return False
    if all(part in ("x", "y", "z") or _AXIS.fullmatch(word) for part, word in parts):
        return True
    # Other words are axes if the numbers of the taxels start again with each word. If the number of
    # taxels is a multiple of the channels, a word may also be a part of the sensor.
    rows = [keys[i : i + num_taxels] for i in range(0, len(keys), num_taxels)]
    is_ascending = all(_is_ascending(row) for row in rows)
    is_single_letter = all(len(word) == 1 for _, word in parts) and num_taxels != num_channels
    return is_ascending and (num_taxels % num_channels != 0 or is_single_letter)


def _differing_parts(keys: Sequence[str]) -> list[tuple[str, str]]:
    # For each name, the part in which it differs from the others, and the word that contains it.
    start = _common_prefix_length(keys)
    end = _common_prefix_length([key[start:][::-1] for key in keys])
    parts = []
    for key in keys:
        stop = len(key) - end
        words = _WORD.finditer(key)
        word = next((m[0] for m in words if m.start() <= start and stop <= m.end()), "")
        parts.append((key[start:stop], word))
    return parts


def _common_prefix_length(keys: Sequence[str]) -> int:
    # The number of letters at the start that all keys share.
    min_length = min(map(len, keys))
    return next((i for i in range(min_length) if len({key[i] for key in keys}) > 1), min_length)


def _is_ascending(keys: Sequence[str]) -> bool:
    texts = {tuple(_NUMBER.split(key)[::2]) for key in keys}
    numbers = [[int(n) for n in _NUMBER.findall(key)] for key in keys]
    return len(texts) == 1 and numbers == sorted(numbers)
