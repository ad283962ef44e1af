r"""The form of the file names in a training set. It shows which class another recording has."""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._label_names import label_numbers

# A predictor file may come from someone else, and matching a malicious regular expression could
# take years. Only plain text with a few names is stored, and long file names are not matched.
_FORM = re.compile(r"(?:\{[A-Za-z_]\w*\}|[\w /-])+")
_NAME = re.compile(r"\{(\w+)\}")
_GROUP = re.compile(r"\(\?P<(\w+)>[^()]*\)")  # a named group without other groups in it
_MAX_NAMES = 5
_MAX_CHARACTERS = 120


@dataclass(frozen=True)
class FileNameForm:
    r"""The form of file names, and which part of them is the class.

    Args:
        form (str): Plain text with names in braces, such as :obj:`"{person}_{object}_{trial}"`.
        target (str): The name that is the class.

    Raises:
        ValueError: If the form is not such a text, is too long or does not contain the target.

    Examples:
        >>> names = FileNameForm("{person}_{object}_{trial}", "object")
        >>> names.find_class("day2/p4_cup_001.csv", ["ball", "cup"])
        'cup'
    """

    form: str
    target: str

    def __post_init__(self) -> None:
        need(
            _is_form(self.form) and self.target in _NAME.findall(self.form),
            f"its 'file_names' must be plain text with up to {_MAX_NAMES} names in braces, "
            "including the target",
            f"{str(self.form)[:80]} and {str(self.target)[:80]}",
        )

    @classmethod
    def from_dataset(cls, dataset: Any) -> Self | None:
        r"""Returns the form of the file names of a data set. Returns :obj:`None` if they do not
        contain the class, or if :obj:`pattern` contains more than text and named groups.
        """
        pattern, target = getattr(dataset, "pattern", None), getattr(dataset, "target", None)
        if not isinstance(pattern, str) or not isinstance(target, str):
            return None
        form = _GROUP.sub(r"{\1}", pattern)
        return cls(form, target) if _is_form(form) and target in _NAME.findall(form) else None

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Returns a form from the mapping that :meth:`to_dict` returned."""
        is_complete = isinstance(content, dict) and {*content} == {"form", "target"}
        need(is_complete, "its 'file_names' must have 'form' and 'target'", str(content)[:80])
        return cls(**content)

    def to_dict(self) -> dict[str, str]:
        r"""Returns the arguments as JSON values."""
        return asdict(self)

    def find_class(self, path: PathLike, class_names: Sequence[str]) -> str | None:
        r"""Returns the class in the name of a file, or :obj:`None`.

        Args:
            path (str or PathLike): The file.
            class_names (sequence of str): The names of the classes.
        """
        num_parts = self.form.count("/") + 1
        name = "/".join(Path(path).with_suffix("").parts[-num_parts:])
        parts = {"trial": "[0-9]+", self.target: f"({'|'.join(map(re.escape, class_names))})"}
        pattern = _NAME.sub(lambda match: parts.get(match[1], "[^/]+?"), self.form)
        is_short = len(name) <= _MAX_CHARACTERS
        match = re.fullmatch(pattern, name, re.IGNORECASE) if is_short else None
        if match is None:
            return None
        (number,) = label_numbers(class_names, [match[1]])
        return None if number is None else class_names[number]


def _is_form(form: Any) -> bool:
    is_plain = isinstance(form, str) and len(form) <= _MAX_CHARACTERS and _FORM.fullmatch(form)
    return bool(is_plain) and len(_NAME.findall(form)) <= _MAX_NAMES
