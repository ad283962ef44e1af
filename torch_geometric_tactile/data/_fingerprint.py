r"""Descriptions of the settings of a processed file as text that is the same in every run."""

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
# Types of private attributes that are settings. Others may be caches or open files.
_SETTING_TYPES = (
    *_PLAIN,
    *(Tensor, np.ndarray, np.generic, PathLike, enum.Enum, TaxelLayout, BaseTransform, type),
    *(types.FunctionType, types.BuiltinFunctionType, types.MethodType, functools.partial),
)
_MODULE_ATTRIBUTES = vars(torch.nn.Module()).keys()
_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")
_BYTECODE = re.compile(r"bytecode (\d+\.\d+) [0-9a-f]+")
_SOURCE = re.compile(r"\[source [0-9a-f]+\]")
_MAX_DESCRIPTION = 400  # characters; longer descriptions are replaced by a hash
_MAX_SHORT_TEXT = 60  # characters of a description in a message


def describe(value: Any) -> str:
    r"""Returns a text that changes if, and only if, a setting changes. The text is the same in
    every run, although addresses in memory and the order of sets differ between runs.

    * Tensors, arrays and layouts are described by a hash of their numbers.
    * Functions are described by their name, their byte code, their defaults and the variables that
      they close over.
    * Other objects are described by their class, their public attributes, the output of
      :obj:`arguments()` if a transform defines it, and those private attributes that are data,
      functions, layouts or transforms, or lists, tuples, sets or dictionaries of these. State that
      :obj:`__getstate__` leaves out, such as a cache, is ignored.

    The description of a user's function or class includes a hash of its source code and of all
    modules that it imports. Without a source file, as in a notebook, it includes the functions and
    values to which the code refers.

    Examples:
        >>> from torch_geometric.transforms import Constant
        >>> describe(Constant(2.0))
        'torch_geometric.transforms.constant.Constant(cat=True, node_types=None, value=2.0)'
    """
    text = _describe(value, ())
    if len(text) <= _MAX_DESCRIPTION:
        return text
    # The hash of the source code is separate from the hash of the settings, see `without_code`.
    sources = " ".join(_SOURCE.findall(text))
    mark = f"[source {_sha256(sources.encode())}]" if sources else ""
    text = _SOURCE.sub("", text)
    return f"{text[:_MAX_SHORT_TEXT]}... (sha256 {_sha256(text.encode())}){mark}"


def _describe(value: Any, parents: tuple[int, ...]) -> str:
    # `parents` are the identities of the objects that contain the value. The recursion ends at an
    # object that contains itself.
    if value is None or (isinstance(value, _PLAIN) and not isinstance(value, enum.Enum)):
        return repr(value)
    if id(value) in parents:
        return "..."
    parents = (*parents, id(value))
    if isinstance(value, enum.Enum):
        return f"{_path(type(value))}.{value.name}"
    if isinstance(value, PathLike):
        return repr(str(value))
    if isinstance(value, Tensor | np.ndarray | np.generic):
        return _describe_array(value)
    if isinstance(value, TaxelLayout):
        return f"TaxelLayout('{value.name}', {_sha256(_describe_object(value, parents).encode())})"
    if isinstance(value, Mapping):
        pairs = ((_describe(key, parents), _describe(item, parents)) for key, item in value.items())
        return "{" + ", ".join(f"{key}: {item}" for key, item in sorted(pairs)) + "}"
    if isinstance(value, Set):
        return "{" + ", ".join(sorted(_describe(item, parents) for item in value)) + "}"
    if isinstance(value, Sequence) and not isinstance(value, range):
        items = ", ".join(_describe(item, parents) for item in value)
        if type(value) in (list, tuple):
            return f"[{items}]" if isinstance(value, list) else f"({items})"
        return f"{_path(type(value))}({items})"
    return _describe_callable(value, parents) or _describe_object(value, parents)


def _describe_array(value: Any) -> str:
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind not in "biufc":
        return f"array({value.dtype}, {_describe(value.tolist(), ())})"  # such as texts
    tensor = torch.as_tensor(value).detach().cpu()
    tensor = tensor if tensor.layout == torch.strided else tensor.to_dense()
    numbers = tensor.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()
    return f"tensor({tensor.dtype}, {tuple(tensor.shape)}, {_sha256(numbers)})"


def _describe_callable(value: Any, parents: tuple[int, ...]) -> str | None:
    if isinstance(value, type):
        return _describe_class(value, parents)
    if isinstance(value, types.FunctionType):
        cells = [_cell_contents(cell) for cell in value.__closure__ or ()]
        state: tuple[Any, ...] = (value.__defaults__, value.__kwdefaults__, cells)
        if not has_source(value):
            state = (*state, _referenced_globals(value))
        code = _sha256(_describe_code(value.__code__).encode())
        text = f"{_path(value)}(bytecode {sys.version_info.major}.{sys.version_info.minor} {code}"
        return f"{text}, {_describe(state, parents)})"
    if isinstance(value, types.MethodType):
        return f"{_describe(value.__self__, parents)}.{value.__func__.__name__}"
    if isinstance(value, types.BuiltinFunctionType):
        return _path(value)
    if isinstance(value, functools.partial):
        return "partial" + _describe((value.func, value.args, value.keywords), parents)
    return None


def _describe_class(cls: type, parents: tuple[int, ...] = ()) -> str:
    # A class without a source file, as in a notebook, is described by its constants and the code of
    # its methods.
    if has_source(cls):
        return _path(cls)
    content: dict[str, Any] = {}
    for name, item in vars(cls).items():
        function = item.__func__ if isinstance(item, staticmethod | classmethod) else item
        function = function.fget if isinstance(function, property) else function
        if isinstance(function, types.FunctionType) or (name[:2] != "__" and _is_setting(function)):
            content[name] = function
    bases = [base for base in cls.__bases__ if base is not object]
    return f"{_path(cls)}[{_describe((content, bases), (*parents, id(cls)))}]"


def _referenced_globals(function: types.FunctionType) -> dict[str, Any]:
    # Returns the functions, classes and values of its module to which a function refers.
    names = _code_names(function.__code__) & function.__globals__.keys()
    globals_by_name = {name: function.__globals__[name] for name in names}
    modules = [value for value in globals_by_name.values() if isinstance(value, types.ModuleType)]
    settings = {name: value for name, value in globals_by_name.items() if _is_setting(value)}
    return {**settings, **user_sources(sorted(module.__name__ for module in modules)).modules}


def _code_names(code: types.CodeType) -> set[str]:
    # Returns the names in the code of a function and of the functions defined in it.
    inner_code = (const for const in code.co_consts if isinstance(const, types.CodeType))
    return set(code.co_names).union(*map(_code_names, inner_code))


def _cell_contents(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not yet assigned
        return None


def _describe_code(code: types.CodeType) -> str:
    # Leaves out file names and line numbers, which do not change what the function does.
    consts = (
        _describe_code(const) if isinstance(const, types.CodeType) else _describe(const, ())
        for const in code.co_consts
    )
    return repr((code.co_code.hex(), code.co_names, code.co_varnames, tuple(consts)))


def _describe_object(value: Any, parents: tuple[int, ...]) -> str:
    state: dict[str, Any] = {}
    if isinstance(value, torch.nn.Module):
        state["state_dict"] = value.state_dict()
        state["repr"] = repr(value)
    slots = (name for cls in type(value).__mro__ for name in _slots(cls))
    items = {name: getattr(value, name, None) for name in {*getattr(value, "__dict__", ()), *slots}}
    if items and type(value).__getstate__ is not object.__getstate__:
        pickled_state = value.__getstate__()
        items = pickled_state if isinstance(pickled_state, dict) else items
    for name, item in items.items():
        if isinstance(value, torch.nn.Module) and name in _MODULE_ATTRIBUTES:
            continue  # "state_dict" and "repr" describe them
        if not name.startswith("_") or (item is not None and _is_setting(item)):
            state[name] = item
    if isinstance(value, BaseTransform) and hasattr(value, "arguments"):
        state |= value.arguments()
    if not state and type(value).__repr__ is not object.__repr__:
        return f"{_describe_class(type(value), parents)}: {_ADDRESS.sub('', repr(value))}"
    text = ", ".join(f"{name}={_describe(state[name], parents)}" for name in sorted(state))
    return f"{_describe_class(type(value), parents)}({text})"


def _slots(cls: type) -> Sequence[str]:
    slots = cls.__dict__.get("__slots__", ())
    return (slots,) if isinstance(slots, str) else tuple(slots)


def _is_setting(value: Any) -> bool:
    # Returns whether a private attribute is described. Other attributes are caches or resources,
    # which change with use or from run to run.
    if isinstance(value, Mapping):
        return all(map(_is_setting, value.values()))
    if isinstance(value, Sequence | Set) and not isinstance(value, str | bytes):
        return all(map(_is_setting, value))
    return value is None or isinstance(value, _SETTING_TYPES)


def _path(value: Any) -> str:
    mark = source_hash(value) if isinstance(value, type | types.FunctionType) else ""
    return f"{value.__module__}.{value.__qualname__}" + (f"[source {mark}]" if mark else "")


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def constructor_arguments(
    cls: type, args: Sequence[Any], kwargs: Mapping[str, Any]
) -> dict[str, Any]:
    r"""Returns the arguments of a constructor by name, with its defaults. If the arguments do not
    fit its signature, the output is empty.

    Examples:
        >>> constructor_arguments(type("A", (), {"__init__": lambda self, k, n=3: None}), [2], {})
        {'k': 2, 'n': 3}
    """
    # `bind_partial` is used because the constructor itself reports missing and unknown arguments.
    try:
        bound = signature(cls.__init__).bind_partial(None, *args, **kwargs)  # type: ignore[misc]
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


def setting_changes(before: Mapping[str, str], after: Mapping[str, str]) -> list[str]:
    r"""Returns the settings that differ, as texts such as :obj:`"k: 2 -> 5"`.

    The byte code of functions is not compared between versions of Python.
    """
    return [
        f"{key}: {_shorten(before.get(key))} -> {_shorten(after.get(key))}"
        for key in {**before, **after}
        if not _is_same_setting(before.get(key), after.get(key))
    ]


def without_code(settings: Mapping[str, str]) -> dict[str, str]:
    r"""Removes the hashes of the user's source code from settings.

    Examples:
        >>> without_code({"class": "my_data.MyData[source 0123456789abcdef]"})
        {'class': 'my_data.MyData'}
    """
    return {key: _SOURCE.sub("", text) for key, text in settings.items()}


def _is_same_setting(old: str | None, new: str | None) -> bool:
    if old is None or new is None:
        return old == new
    if {*_BYTECODE.findall(old)} != {*_BYTECODE.findall(new)}:
        old, new = (_BYTECODE.sub("bytecode", text) for text in (old, new))
    return old == new


def _shorten(text: str | None) -> str:
    if text is None:
        return "none"
    return text if len(text) <= _MAX_SHORT_TEXT else f"{text[: _MAX_SHORT_TEXT - 3]}..."


def state_changes(before: Iterable[str], after: Iterable[str]) -> list[str]:
    r"""Returns the keys whose lines :obj:`"key=value"` differ, as texts such as
    :obj:`"'a.h5' was added"`.
    """
    old, new = (dict(line.rpartition("=")[::2] for line in lines) for lines in (before, after))
    return [
        f"'{key}' was {'added' if key not in old else 'removed' if key not in new else 'changed'}"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
