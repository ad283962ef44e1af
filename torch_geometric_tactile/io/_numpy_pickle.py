r"""A safe reader of pickles with lists, dicts and NumPy arrays of numbers. No code in a file is
run.

Python's unpickler calls any function that a file names. This reader uses :mod:`pickletools` only to
parse the steps of a file. It executes the few steps that create containers, strings, numbers and
arrays, and raises an error for any other step or name.
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

_TEXT_STEPS = ("SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8")
_BYTES_STEPS = ("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8")
_LITERAL_STEPS = {*_TEXT_STEPS, *_BYTES_STEPS, "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"}
_CONTAINER_STEPS = {"EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple}
_CONSTANT_STEPS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_TUPLE_SIZES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_NDARRAY, _DTYPE = "numpy.ndarray", "numpy.dtype"
_RECONSTRUCT, _SCALAR = "numpy.core.multiarray._reconstruct", "numpy.core.multiarray.scalar"
_FROM_BUFFER = "numpy.core.numeric._frombuffer"
_ALLOWED_NAMES = (_NDARRAY, _DTYPE, _RECONSTRUCT, _SCALAR, _FROM_BUFFER)
_PLAIN_DTYPE_STATE = (None, None, None, -1, -1, 0)  # of a dtype of numbers: no fields, no objects


def read_numpy_pickle(path: Path) -> Any:
    r"""Reads a pickle (protocols 3 to 5) of lists, tuples, dicts with strings as keys, strings,
    bytes, numbers, and NumPy arrays or scalars of numbers.

    Arrays may be read-only. No array is larger than its bytes in the file, but a list may hold the
    same array many times.

    Raises:
        ValueError: If the file is damaged or truncated, holds anything else, such as a function or
            an array of objects, or takes more than five million steps. The message names the file
            and the invalid content.
    """
    data = path.read_bytes()
    machine = _StackMachine()
    try:
        for count, (step, value, position) in enumerate(genops(data)):
            need(count < PICKLE_STEPS, f"it must take at most {PICKLE_STEPS:,} steps (got more)")
            if step.name == "STOP":
                need(
                    position == len(data) - 1,
                    "it must hold one pickle (got further bytes after it)",
                )
                (content,) = machine.stack
                return content
            machine.execute(step.name, value)
    except UNREADABLE as error:
        raise unreadable_error(path, "a pickle of arrays", error) from error
    raise AssertionError("unreachable: a pickle without an end is an error")


class _GlobalName(str):
    # The name of a class or function of NumPy in a file.
    __slots__ = ()


class _PendingObject:
    # An array or dtype whose content comes in a later step, which sets `value`.
    def __init__(self, dtype: np.dtype | None = None) -> None:
        self.dtype = dtype
        self.value: Any = None


class _StackMachine:
    # Executes the steps of a pickle on a stack.
    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}

    def execute(self, step: str, value: Any) -> None:
        stack = self.stack
        if step in _LITERAL_STEPS:
            stack.append(value)
        elif step in _CONSTANT_STEPS:
            stack.append(_CONSTANT_STEPS[step])
        elif step in _CONTAINER_STEPS:
            stack.append(_CONTAINER_STEPS[step]())
        elif step == "MARK":
            self.marks.append(len(stack))
        elif step in _TUPLE_SIZES or step == "TUPLE":
            stack.append(tuple(self._pop_items(_TUPLE_SIZES.get(step))))
        elif step in ("APPEND", "APPENDS"):
            items = self._pop_items(1 if step == "APPEND" else None)
            _check_type(list, stack[-1]).extend(items)
        elif step in ("SETITEM", "SETITEMS"):
            items = self._pop_items(2 if step == "SETITEM" else None)
            keys = [_check_type(str, key) for key in items[::2]]
            _check_type(dict, stack[-1]).update(zip(keys, items[1::2], strict=True))
        elif step in ("MEMOIZE", "BINPUT", "LONG_BINPUT"):
            self.memo[len(self.memo) if step == "MEMOIZE" else value] = stack[-1]
        elif step in ("BINGET", "LONG_BINGET"):
            item = self.memo[value]
            stack.append(item.value if isinstance(item, _PendingObject) else item)
        elif step == "GLOBAL":
            stack.append(_check_name(value.replace(" ", ".", 1)))
        elif step == "STACK_GLOBAL":
            module, name = self._pop_items(2)
            stack.append(_check_name(f"{_check_type(str, module)}.{_check_type(str, name)}"))
        elif step == "REDUCE":
            name, arguments = self._pop_items(2)
            stack.append(
                _apply_reduce(_check_type(_GlobalName, name), _check_type(tuple, arguments))
            )
        elif step == "BUILD":
            pending, state = self._pop_items(2)
            stack.append(
                _apply_build(_check_type(_PendingObject, pending), _check_type(tuple, state))
            )
        elif step not in ("PROTO", "FRAME"):
            raise ValueError(f"it must hold containers, numbers and arrays (got the step {step})")

    def _pop_items(self, count: int | None) -> list[Any]:
        # Removes `count` items from the stack, or all items since the last mark.
        start = self.marks.pop() if count is None else len(self.stack) - count
        items = self.stack[start:]
        need(
            start >= 0 and count in (None, len(items)),
            "its steps must find their operands on the stack",
        )
        del self.stack[start:]
        return items


def _check_type(kind: type, value: Any) -> Any:
    has_type = type(value) is kind
    need(has_type, f"a step must find a {kind.__name__.strip('_')}", type(value).__name__)
    return value


def _check_name(name: str) -> _GlobalName:
    normalized = re.sub(r"^numpy\._core\.", "numpy.core.", name)  # since NumPy 2
    need(
        normalized in _ALLOWED_NAMES,
        "it must not name classes or functions other than NumPy's arrays",
        quoted(name),
    )
    return _GlobalName(normalized)


def _apply_reduce(name: _GlobalName, arguments: tuple[Any, ...]) -> Any:
    if name == _DTYPE:
        dtype, *_ = arguments
        is_number = re.fullmatch("[biuf][0-9]{1,2}", _check_type(str, dtype))
        need(is_number, "its arrays must hold numbers, not objects", quoted(dtype))
        return _PendingObject(np.dtype(dtype))
    if name == _RECONSTRUCT:
        kind, shape, _ = arguments  # shape and type of an empty array
        need((kind, shape) == (_NDARRAY, (0,)), "it must reconstruct arrays")
        return _PendingObject()
    if name == _SCALAR:
        dtype, content = arguments
        return _to_array(content, dtype, (), "C")[()]
    need(name == _FROM_BUFFER, "it must call a constructor of arrays", name)
    return _to_array(*arguments)


def _apply_build(pending: _PendingObject, state: tuple[Any, ...]) -> Any:
    _, *values = state  # the first one is a version
    if pending.dtype is not None:
        order, *fields = values
        need(tuple(fields) == _PLAIN_DTYPE_STATE, "its arrays must hold numbers, without fields")
        pending.value = pending.dtype.newbyteorder(order)
    else:
        shape, dtype, is_fortran, content = values
        pending.value = _to_array(content, dtype, shape, "F" if is_fortran else "C")
    return pending.value


def _to_array(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    is_shape = type(shape) is tuple and all(type(n) is int and n >= 0 for n in shape)
    need(isinstance(dtype, np.dtype) and is_shape, "its arrays must have a type and a shape")
    size = math.prod(shape) * dtype.itemsize
    need(
        type(content) in (bytes, bytearray) and len(content) == size,
        f"its arrays must hold the {size} bytes of their shape",
        len(content) if type(content) in (bytes, bytearray) else type(content).__name__,
    )
    return np.frombuffer(content, dtype).reshape(shape, order=order)
