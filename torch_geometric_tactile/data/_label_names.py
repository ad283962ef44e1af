r"""The classes behind labels as people write them: one class under several spellings is one."""

import logging
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import short_list

_logger = logging.getLogger(__name__)
# As people write them: not 007, 1_000 or nan, which are names.
_NUMBER = re.compile(r"[+-]?(0|[1-9]\d*)(\.\d*)?")
_NUM_NAMED = 3  # classes in a message
_Key = tuple[str, Any]


def number_labels(values: Sequence[Any]) -> tuple[list[str], np.ndarray]:
    r"""Returns the names of the classes, sorted, and the number of the class of each label.

    Labels are one class if they are equal as numbers (:obj:`0`, :obj:`0.0`, :obj:`"0"`), or equal
    as texts without surrounding blanks and case (:obj:`"slip"`, :obj:`"Slip "`), except single
    letters of other case, such as :obj:`"a"` and :obj:`"A"`, which may be two letters. The name is
    the spelling that comes first, without surrounding blanks; of whole numbers, without decimals.
    A warning is logged of texts that are joined, and of letters that are not.

    Shapes:
        - **output:** the numbers :math:`(S,)`

    Examples:
        >>> names, codes = number_labels(["slip", "hold", "Slip ", "hold"])
        >>> names, codes.tolist()
        (['hold', 'slip'], [1, 0, 1, 0])
        >>> number_labels([0, 1.0, "1", 0.0])[0]
        ['0', '1']
    """
    items = [value.item() if isinstance(value, np.generic) else value for value in values]
    spellings = list(dict.fromkeys((type(item), item) for item in items))
    of_class: dict[_Key, list[Any]] = {}
    for _, spelling in spellings:
        of_class.setdefault(_spelling_key(spelling), []).append(spelling)
    _warn(of_class)
    names = {key: _name(key, written[0]) for key, written in of_class.items()}
    # Numbers in their order, before texts.
    is_text = {
        key: key[0] == "text" or all(isinstance(text, str) for text in written)
        for key, written in of_class.items()
    }
    order = sorted(of_class, key=lambda k: (is_text[k], names[k] if is_text[k] else k[1]))
    number = {key: i for i, key in enumerate(order)}
    code = {spelling: number[_spelling_key(spelling[1])] for spelling in spellings}
    codes = np.array([code[type(item), item] for item in items], dtype=np.int64)
    return [names[key] for key in order], codes


def label_numbers(names: Sequence[str], values: Iterable[Any]) -> list[int | None]:
    r"""Returns the number of each label among the names of classes, in whatever spelling;
    :obj:`None` if it is none of them.

    Examples:
        >>> label_numbers(["hold", "slip"], ["Slip", "hold ", "push"])
        [1, 0, None]
    """
    number = {_spelling_key(name): i for i, name in reversed(list(enumerate(names)))}
    return [number.get(_spelling_key(value)) for value in values]


def _spelling_key(value: Any) -> _Key:
    if isinstance(value, bool):
        return "text", str(value).casefold()
    if isinstance(value, int | float):
        return "number", value
    text = str(value).strip()
    if _NUMBER.fullmatch(text):
        return "number", float(text) if "." in text else int(text)
    return "text", text if len(text) == 1 else text.casefold()


def _name(key: _Key, written: Any) -> str:
    value = key[1]
    is_whole = key[0] == "number" and float(value).is_integer() and abs(value) < 2**53
    return str(int(value)) if is_whole else str(written).strip()


def _warn(of_class: dict[_Key, list[Any]]) -> None:
    joined = [
        " and ".join(repr(text) for text in written)
        for key, written in of_class.items()
        if key[0] == "text" and len({str(text).strip() for text in written}) > 1
    ]
    if joined:
        _logger.warning(
            "labels of one spelling but for case and blanks are one class: %s",
            short_list(joined, _NUM_NAMED),
        )
    texts = {value for kind, value in of_class if kind == "text" and len(value) == 1}
    pairs = sorted(
        f"'{text.lower()}' and '{text}'" for text in texts if text.lower() in texts - {text}
    )
    if pairs:
        _logger.warning(
            "letters of other case are classes of their own: %s; write them alike if they are one",
            short_list(pairs, _NUM_NAMED),
        )
