r"""Objects from plain data: a class by its import path, and its arguments."""

import inspect
from collections.abc import Mapping
from typing import Any

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._user_modules import import_user_module
from torch_geometric_tactile.sensors import TaxelLayout


def find_class(class_path: str) -> Any:
    r"""Returns a class by its import path."""
    module, _, name = class_path.rpartition(".")
    try:
        return getattr(import_user_module(module), name)
    except Exception as error:  # whatever a module raises that is imported
        is_plain = isinstance(error, AttributeError | ImportError | ValueError)
        text = str(error) if is_plain else repr(error)
        raise ValueError(
            f"'class_path' must be the import path of a class (got '{class_path}': {text})"
        ) from error


def argument_names(class_path: str) -> list[str] | None:
    r"""Returns the names of a class's arguments; :obj:`None` if it takes any."""
    parameters = inspect.signature(find_class(class_path)).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    return [parameter.name for parameter in parameters]


def check_arguments(class_path: str, arguments: Mapping[str, Any]) -> None:
    r"""Checks that a class has arguments of some names."""
    known = argument_names(class_path)
    for name in arguments:
        if known is not None and name not in known:
            raise ArgumentError(
                Argument(name),
                f" must be an argument of {class_path.rpartition('.')[2]}: "
                f"{', '.join(known)} (got none)",
            )
    for value in arguments.values():  # also of the data set that a view shows
        if isinstance(value, Mapping) and "class_path" in value:
            check_arguments(value["class_path"], value.get("init_args") or {})


def build_object(content: Any, layout: TaxelLayout | None = None) -> Any:
    r"""Builds what plain data describes: a mapping with :obj:`class_path`, and :obj:`init_args` if
    it has arguments, becomes an object of that class, also inside lists and arguments. Everything
    else stays as it is. A class with an argument :obj:`layout` that is left out gets this one.

    Examples:
        >>> build_object({"class_path": "torch_geometric_tactile.transforms.ZScore"})
        ZScore()
    """
    if isinstance(content, Mapping):
        if "class_path" not in content:
            return {key: build_object(value, layout) for key, value in content.items()}
        arguments = content.get("init_args") or {}
        check_arguments(content["class_path"], arguments)
        built = {name: build_object(value, layout) for name, value in arguments.items()}
        if layout is not None and "layout" in (argument_names(content["class_path"]) or ()):
            built.setdefault("layout", layout)
        return find_class(content["class_path"])(**built)
    if isinstance(content, list | tuple):
        return [build_object(value, layout) for value in content]
    return content
