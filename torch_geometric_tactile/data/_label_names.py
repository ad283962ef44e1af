r"""Numbering of class labels, in which different spellings of a label are one class."""

import logging
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import short_list

_logger = logging.getLogger(__name__)
# Numbers in their usual spelling. Texts such as 007, 1_000 and nan are names.
_NUMBER = re.compile(r"[+-]?(0|[1-9]\d*)(\.\d*)?")
_MAX_LISTED_CLASSES = 3  # in a message
_Key = tuple[str, Any]


def number_labels(values: Sequence[Any]) -> tuple[list[str], np.ndarray]:
    r"""Returns the sorted names of the classes and the class number of each label.

    Labels belong to one class if they are equal as numbers (:obj:`0`, :obj:`0.0`, :obj:`"0"`), or
    are equal as texts apart from surrounding blanks and case (:obj:`"slip"`, :obj:`"Slip "`).
    Single letters are an exception: :obj:`"a"` and :obj:`"A"` are two classes, since they may be
    letters to recognise. A class is named by its first spelling without surrounding blanks; whole
    numbers have no decimals. Warnings are logged for texts in several spellings, and for letters
    that differ only in case.

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
    class_spellings: dict[_Key, list[Any]] = {}
    for _, spelling in spellings:
        class_spellings.setdefault(_spelling_key(spelling), []).append(spelling)
    _warn_of_spellings(class_spellings)
    names = {key: _class_name(key, texts[0]) for key, texts in class_spellings.items()}
    # Numbers are sorted by value and precede texts.
    is_text = {
        key: key[0] == "text" or all(isinstance(text, str) for text in texts)
        for key, texts in class_spellings.items()
    }
    order = sorted(class_spellings, key=lambda k: (is_text[k], names[k] if is_text[k] else k[1]))
    number = {key: i for i, key in enumerate(order)}
    code = {spelling: number[_spelling_key(spelling[1])] for spelling in spellings}
    codes = np.array([code[type(item), item] for item in items], dtype=np.int64)
    return [names[key] for key in order], codes


def label_numbers(names: Sequence[str], values: Iterable[Any]) -> list[int | None]:
    r"""Returns the class number of each label, in any spelling; :obj:`None` for a label without a
    class.

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


def _class_name(key: _Key, spelling: Any) -> str:
    value = key[1]
    # Beyond 2**53, floating-point numbers skip integers, so an integer would be misleading.
    is_whole = key[0] == "number" and float(value).is_integer() and abs(value) < 2**53
    return str(int(value)) if is_whole else str(spelling).strip()


def _warn_of_spellings(class_spellings: dict[_Key, list[Any]]) -> None:
    variants = [
        " and ".join(repr(text) for text in texts)
        for key, texts in class_spellings.items()
        if key[0] == "text" and len({str(text).strip() for text in texts}) > 1
    ]
    if variants:
        _logger.warning(
            "labels that differ only in case and blanks are one class: %s",
            short_list(variants, _MAX_LISTED_CLASSES),
        )
    letters = {value for kind, value in class_spellings if kind == "text" and len(value) == 1}
    pairs = sorted(
        f"'{text.lower()}' and '{text}'" for text in letters if text.lower() in letters - {text}
    )
    if pairs:
        _logger.warning(
            "letters that differ in case are different classes: %s; use one spelling if they are "
            "the same class",
            short_list(pairs, _MAX_LISTED_CLASSES),
        )
