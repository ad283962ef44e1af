r"""Pickles of lists, dicts and NumPy arrays of numbers, of which nothing runs.

The unpickler of Python calls whatever a file names. Here, :mod:`pickletools` only tells the steps
of a file apart: the few that make containers, texts, numbers and arrays are followed, any other
step or name is refused.
"""

import math
import re
from pathlib import Path
from pickletools import genops
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import UNREADABLE, unreadable_error
from torch_geometric_tactile._limits import PICKLE_STEPS
from torch_geometric_tactile._texts import quoted

_TEXTS = ("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8")
_BYTES = ("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8")
_GIVEN = {*_TEXTS, *_BYTES, "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"}
_NEW = {"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_NDARRAY, _DTYPE = "numpy.ndarray", "numpy.dtype"
_RECONSTRUCT, _SCALAR = "numpy.core.multiarray._reconstruct", "numpy.core.multiarray.scalar"
_FROM_BUFFER = "numpy.core.numeric._frombuffer"
_NAMES = (_NDARRAY, _DTYPE, _RECONSTRUCT, _SCALAR, _FROM_BUFFER)
_PLAIN_STATE = (None, None, None, -1, -1, 0)  # of a type of numbers: no fields, no objects


def read_numpy_pickle(path: Path) -> Any:
    r"""Reads a pickle (protocols 3 to 5) of lists, tuples, dicts with texts as keys, texts, bytes,
    numbers and NumPy arrays or scalars of numbers. Its arrays may be read-only. None is larger
    than its part of the file, but a list may hold one array many times.

    Raises:
        ValueError: If the file is damaged or cut, holds anything else, such as a function or an
            array of objects, or takes more than five million steps. The message names the file, and
            what it names.
    """
    data = path.read_bytes()
    steps = _Steps()
    try:
        for count, (step, value, place) in enumerate(genops(data)):
            need(count < PICKLE_STEPS, f"it must take at most {PICKLE_STEPS:,} steps (got more)")
            if step.name == "STOP":
                need(place == len(data) - 1, "it must hold one pickle (got more behind it)")
                (found,) = steps.stack
                return found
            steps.follow(step.name, value)
    except UNREADABLE as error:
        raise unreadable_error(path, "a pickle of arrays", error) from error
    raise AssertionError("unreachable: a pickle without an end is an error")


class _Name(str):
    # What a file calls a class or function of NumPy.
    __slots__ = ()


class _Started:
    # An array or type that gets its content in a later step; `made` is what becomes of it.
    def __init__(self, form: np.dtype | None = None) -> None:
        self.form = form
        self.made: Any = None


class _Steps:
    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}

    def follow(self, step: str, value: Any) -> None:
        stack = self.stack
        if step in _GIVEN:
            stack.append(value)
        elif step in _CONSTANTS:
            stack.append(_CONSTANTS[step])
        elif step in _NEW:
            stack.append(_NEW[step]())
        elif step == "MARK":
            self.marks.append(len(stack))
        elif step in _TUPLES or step == "TUPLE":
            stack.append(tuple(self._last(_TUPLES.get(step))))
        elif step in ("APPEND", "APPENDS"):
            items = self._last(1 if step == "APPEND" else None)
            _of_type(list, stack[-1]).extend(items)
        elif step in ("SETITEM", "SETITEMS"):
            items = self._last(2 if step == "SETITEM" else None)
            keys = [_of_type(str, key) for key in items[::2]]
            _of_type(dict, stack[-1]).update(zip(keys, items[1::2], strict=True))
        elif step in ("MEMOIZE", "BINPUT", "LONG_BINPUT"):
            self.memo[len(self.memo) if step == "MEMOIZE" else value] = stack[-1]
        elif step in ("BINGET", "LONG_BINGET"):
            known = self.memo[value]
            stack.append(known.made if isinstance(known, _Started) else known)
        elif step == "GLOBAL":
            stack.append(_checked_name(value.replace(" ", ".", 1)))
        elif step == "STACK_GLOBAL":
            module, name = self._last(2)
            stack.append(_checked_name(f"{_of_type(str, module)}.{_of_type(str, name)}"))
        elif step == "REDUCE":
            name, arguments = self._last(2)
            stack.append(_called(_of_type(_Name, name), _of_type(tuple, arguments)))
        elif step == "BUILD":
            started, state = self._last(2)
            stack.append(_built(_of_type(_Started, started), _of_type(tuple, state)))
        elif step not in ("PROTO", "FRAME"):
            raise ValueError(f"it must hold containers, numbers and arrays (got the step {step})")

    def _last(self, count: int | None) -> list[Any]:
        # Takes so many values from the stack, or those since the last mark.
        start = self.marks.pop() if count is None else len(self.stack) - count
        items = self.stack[start:]
        need(start >= 0 and count in (None, len(items)), "its steps must find their values")
        del self.stack[start:]
        return items


def _of_type(kind: type, value: Any) -> Any:
    is_right = type(value) is kind
    need(is_right, f"a step must find a {kind.__name__.strip('_')}", type(value).__name__)
    return value


def _checked_name(name: str) -> _Name:
    known = re.sub(r"^numpy\._core\.", "numpy.core.", name)  # since NumPy 2
    need(known in _NAMES, "it must name no class or function but NumPy's arrays", quoted(name))
    return _Name(known)


def _called(name: _Name, arguments: tuple[Any, ...]) -> Any:
    if name == _DTYPE:
        form, *_ = arguments
        is_number = re.fullmatch("[biuf][0-9]{1,2}", _of_type(str, form))
        need(is_number, "its arrays must hold numbers, no objects", quoted(form))
        return _Started(np.dtype(form))
    if name == _RECONSTRUCT:
        kind, shape, _ = arguments  # the last two are those of no array yet
        need((kind, shape) == (_NDARRAY, (0,)), "it must reconstruct arrays")
        return _Started()
    if name == _SCALAR:
        form, content = arguments
        return _array(content, form, (), "C")[()]
    need(name == _FROM_BUFFER, "it must call what makes an array", name)
    return _array(*arguments)


def _built(started: _Started, state: tuple[Any, ...]) -> Any:
    _, *values = state  # the first is a version
    if started.form is not None:
        order, *others = values
        need(tuple(others) == _PLAIN_STATE, "its arrays must hold numbers, without fields")
        started.made = started.form.newbyteorder(order)
    else:
        shape, form, is_fortran, content = values
        started.made = _array(content, form, shape, "F" if is_fortran else "C")
    return started.made


def _array(content: Any, form: Any, shape: Any, order: Any) -> np.ndarray:
    is_shape = type(shape) is tuple and all(type(n) is int and n >= 0 for n in shape)
    need(isinstance(form, np.dtype) and is_shape, "its arrays must have a type and a shape")
    size = math.prod(shape) * form.itemsize
    need(
        type(content) in (bytes, bytearray) and len(content) == size,
        f"its arrays must hold what their shape says, {size} bytes",
        len(content) if type(content) in (bytes, bytearray) else type(content).__name__,
    )
    return np.frombuffer(content, form).reshape(shape, order=order)
