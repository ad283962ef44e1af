r"""What a processed file was made from, as text that is the same in every run."""

import enum
import functools
import hashlib
import re
import sys
import types
from collections.abc import Iterable, Mapping, Sequence, Set
from inspect import Parameter, signature
from os import PathLike
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile._sources import has_source, source_hash, user_sources
from torch_geometric_tactile.sensors import TaxelLayout

_PLAIN = (bool, int, float, complex, str, bytes, torch.dtype, torch.device, torch.layout)
_COUNTED = (
    *_PLAIN,
    *(Tensor, np.ndarray, np.generic, PathLike, enum.Enum, TaxelLayout, BaseTransform, type),
    *(types.FunctionType, types.BuiltinFunctionType, types.MethodType, functools.partial),
)
_OF_MODULES = vars(torch.nn.Module()).keys()
_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")
_BYTECODE = re.compile(r"bytecode (\d+\.\d+) [0-9a-f]+")
_SOURCE = re.compile(r"\[source [0-9a-f]+\]")
_LONG = 400  # characters of a description, beyond which only its hash is kept
_SHORT = 60  # characters of a description in a message


def describe(value: Any) -> str:
    r"""Returns a text that changes if, and only if, a setting changes: also between runs, where
    addresses in memory and the order of sets differ.

    Tensors, arrays and layouts are described by a hash of their numbers; functions by their name,
    their byte code, their defaults and the variables that they close over; other objects by their
    class, their public attributes, the :obj:`arguments()` of transforms that have them, and those
    private attributes that are data, functions, layouts or transforms, or lists, tuples, sets or
    dictionaries of such. What :obj:`__getstate__` leaves out, such as a cache, does not count.

    Functions and classes of the user's own also have a hash of their source code and that of all
    modules that they import. Where there is no source file, as in a notebook, the functions and
    values that their code names are described.

    Examples:
        >>> from torch_geometric.transforms import Constant
        >>> describe(Constant(2.0))
        'torch_geometric.transforms.constant.Constant(cat=True, node_types=None, value=2.0)'
    """
    text = _describe(value, ())
    if len(text) <= _LONG:
        return text
    sources = " ".join(_SOURCE.findall(text))
    mark = f"[source {_sha256(sources.encode())}]" if sources else ""
    text = _SOURCE.sub("", text)
    return f"{text[:_SHORT]}... (sha256 {_sha256(text.encode())}){mark}"


def _describe(value: Any, inside: tuple[int, ...]) -> str:
    if value is None or (isinstance(value, _PLAIN) and not isinstance(value, enum.Enum)):
        return repr(value)
    if id(value) in inside:
        return "..."
    inside = (*inside, id(value))
    if isinstance(value, enum.Enum):
        return f"{_path(type(value))}.{value.name}"
    if isinstance(value, PathLike):
        return repr(str(value))
    if isinstance(value, Tensor | np.ndarray | np.generic):
        return _describe_array(value)
    if isinstance(value, TaxelLayout):
        return f"TaxelLayout('{value.name}', {_sha256(_describe_object(value, inside).encode())})"
    if isinstance(value, Mapping):
        pairs = ((_describe(key, inside), _describe(item, inside)) for key, item in value.items())
        return "{" + ", ".join(f"{key}: {item}" for key, item in sorted(pairs)) + "}"
    if isinstance(value, Set):
        return "{" + ", ".join(sorted(_describe(item, inside) for item in value)) + "}"
    if isinstance(value, Sequence) and not isinstance(value, range):
        items = ", ".join(_describe(item, inside) for item in value)
        if type(value) in (list, tuple):
            return f"[{items}]" if isinstance(value, list) else f"({items})"
        return f"{_path(type(value))}({items})"
    return _describe_callable(value, inside) or _describe_object(value, inside)


def _describe_array(value: Any) -> str:
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind not in "biufc":
        return f"array({value.dtype}, {_describe(value.tolist(), ())})"  # text, for example
    tensor = torch.as_tensor(value).detach().cpu()
    tensor = tensor if tensor.layout == torch.strided else tensor.to_dense()
    numbers = tensor.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()
    return f"tensor({tensor.dtype}, {tuple(tensor.shape)}, {_sha256(numbers)})"


def _describe_callable(value: Any, inside: tuple[int, ...]) -> str | None:
    if isinstance(value, type):
        return _describe_class(value, inside)
    if isinstance(value, types.FunctionType):
        cells = [_cell(cell) for cell in value.__closure__ or ()]
        state: tuple[Any, ...] = (value.__defaults__, value.__kwdefaults__, cells)
        if not has_source(value):
            state = (*state, _named_globals(value))
        code = _sha256(_describe_code(value.__code__).encode())
        text = f"{_path(value)}(bytecode {sys.version_info.major}.{sys.version_info.minor} {code}"
        return f"{text}, {_describe(state, inside)})"
    if isinstance(value, types.MethodType):
        return f"{_describe(value.__self__, inside)}.{value.__func__.__name__}"
    if isinstance(value, types.BuiltinFunctionType):
        return _path(value)
    if isinstance(value, functools.partial):
        return "partial" + _describe((value.func, value.args, value.keywords), inside)
    return None


def _describe_class(kind: type, inside: tuple[int, ...] = ()) -> str:
    # Of a class in a notebook, for example, the code of its methods and its constants.
    if has_source(kind):
        return _path(kind)
    content: dict[str, Any] = {}
    for name, item in vars(kind).items():
        function = item.__func__ if isinstance(item, staticmethod | classmethod) else item
        function = function.fget if isinstance(function, property) else function
        if isinstance(function, types.FunctionType) or (name[:2] != "__" and _counts(function)):
            content[name] = function
    bases = [base for base in kind.__bases__ if base is not object]
    return f"{_path(kind)}[{_describe((content, bases), (*inside, id(kind)))}]"


def _named_globals(function: types.FunctionType) -> dict[str, Any]:
    # What the code of a function names in its module: other functions, classes and values.
    names = _names(function.__code__) & function.__globals__.keys()
    found = {name: function.__globals__[name] for name in names}
    modules = [value for value in found.values() if isinstance(value, types.ModuleType)]
    named = {name: value for name, value in found.items() if _counts(value)}
    return {**named, **user_sources(sorted(module.__name__ for module in modules)).modules}


def _names(code: types.CodeType) -> set[str]:
    inner = (const for const in code.co_consts if isinstance(const, types.CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _cell(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not yet assigned
        return None


def _describe_code(code: types.CodeType) -> str:
    # Neither file names nor line numbers, which do not change what the function does.
    consts = (
        _describe_code(const) if isinstance(const, types.CodeType) else _describe(const, ())
        for const in code.co_consts
    )
    return repr((code.co_code.hex(), code.co_names, code.co_varnames, tuple(consts)))


def _describe_object(value: Any, inside: tuple[int, ...]) -> str:
    state: dict[str, Any] = {}
    if isinstance(value, torch.nn.Module):
        state["state_dict"] = value.state_dict()
        state["repr"] = repr(value)
    slots = (name for kind in type(value).__mro__ for name in _slots(kind))
    items = {name: getattr(value, name, None) for name in {*getattr(value, "__dict__", ()), *slots}}
    if items and type(value).__getstate__ is not object.__getstate__:
        kept = value.__getstate__()
        items = kept if isinstance(kept, dict) else items
    for name, item in items.items():
        if isinstance(value, torch.nn.Module) and name in _OF_MODULES:
            continue  # the parameters are described by now
        if not name.startswith("_") or (item is not None and _counts(item)):
            state[name] = item
    if isinstance(value, BaseTransform) and hasattr(value, "arguments"):
        state |= value.arguments()
    if not state and type(value).__repr__ is not object.__repr__:
        return f"{_describe_class(type(value), inside)}: {_ADDRESS.sub('', repr(value))}"
    text = ", ".join(f"{name}={_describe(state[name], inside)}" for name in sorted(state))
    return f"{_describe_class(type(value), inside)}({text})"


def _slots(kind: type) -> Sequence[str]:
    slots = kind.__dict__.get("__slots__", ())
    return (slots,) if isinstance(slots, str) else tuple(slots)


def _counts(value: Any) -> bool:
    # Of private attributes: others are caches or resources, which use or another run changes.
    if isinstance(value, Mapping):
        return all(map(_counts, value.values()))
    if isinstance(value, Sequence | Set) and not isinstance(value, str | bytes):
        return all(map(_counts, value))
    return value is None or isinstance(value, _COUNTED)


def _path(value: Any) -> str:
    mark = source_hash(value) if isinstance(value, type | types.FunctionType) else ""
    return f"{value.__module__}.{value.__qualname__}" + (f"[source {mark}]" if mark else "")


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def constructor_arguments(
    kind: type, args: Sequence[Any], kwargs: Mapping[str, Any]
) -> dict[str, Any]:
    r"""Returns the arguments of a constructor by name, with its defaults.

    Examples:
        >>> constructor_arguments(type("A", (), {"__init__": lambda self, k, n=3: None}), [2], {})
        {'k': 2, 'n': 3}
    """
    # `bind_partial`: what is missing or unknown is reported by the constructor itself.
    try:
        bound = signature(kind.__init__).bind_partial(None, *args, **kwargs)  # type: ignore[misc]
    except TypeError:
        return {}
    bound.apply_defaults()
    arguments = dict(list(bound.arguments.items())[1:])
    for parameter in bound.signature.parameters.values():
        if parameter.kind is Parameter.VAR_KEYWORD:
            arguments.update(arguments.pop(parameter.name))
        elif parameter.kind is Parameter.VAR_POSITIONAL and not arguments[parameter.name]:
            del arguments[parameter.name]
    return arguments


def changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    r"""Returns which settings differ, as text: :obj:`"k: 2 -> 5"`.

    The byte code of functions is not compared between versions of Python.
    """
    return [
        f"{key}: {_short(before.get(key))} -> {_short(now.get(key))}"
        for key in {**before, **now}
        if not _is_same(before.get(key), now.get(key))
    ]


def without_code(settings: Mapping[str, str]) -> dict[str, str]:
    r"""Returns settings without the hashes of the user's own source code.

    Examples:
        >>> without_code({"class": "my_data.MyData[source 0123456789abcdef]"})
        {'class': 'my_data.MyData'}
    """
    return {key: _SOURCE.sub("", text) for key, text in settings.items()}


def _is_same(old: str | None, new: str | None) -> bool:
    if old is None or new is None:
        return old == new
    if {*_BYTECODE.findall(old)} != {*_BYTECODE.findall(new)}:
        old, new = (_BYTECODE.sub("bytecode", text) for text in (old, new))
    return old == new


def _short(text: str | None) -> str:
    if text is None:
        return "none"
    return text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}..."


def state_changes(before: Iterable[str], now: Iterable[str]) -> list[str]:
    r"""Returns which lines :obj:`"key=value"` differ, as text: :obj:`"'a.h5' was added"`."""
    old, new = (dict(line.rpartition("=")[::2] for line in lines) for lines in (before, now))
    return [
        f"'{key}' was {'added' if key not in old else 'removed' if key not in new else 'changed'}"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
