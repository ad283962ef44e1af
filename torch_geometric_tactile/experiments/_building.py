r"""Builds objects from plain data: the import path of a class, and its arguments."""

import inspect
from collections.abc import Mapping
from typing import Any

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._user_modules import import_user_module
from torch_geometric_tactile.sensors import TaxelLayout


def find_class(class_path: str) -> Any:
    r"""Returns the class or function at an import path.

    Raises:
        ValueError: If it cannot be imported.
    """
    module, _, name = class_path.rpartition(".")
    try:
        return getattr(import_user_module(module), name)
    except Exception as error:  # importing runs code, which may raise anything
        is_plain = isinstance(error, AttributeError | ImportError | ValueError)
        text = str(error) if is_plain else repr(error)
        raise ValueError(
            f"'class_path' must be the import path of a class (got '{class_path}': {text})"
        ) from error


def argument_names(class_path: str) -> list[str] | None:
    r"""Returns the names of a class's arguments, or :obj:`None` if it accepts any keyword."""
    parameters = inspect.signature(find_class(class_path)).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    return [parameter.name for parameter in parameters]


def check_arguments(class_path: str, arguments: Mapping[str, Any]) -> None:
    r"""Checks that a class has arguments of these names, also inside nested objects.

    Raises:
        ValueError: If a name is not one of its arguments.
    """
    names = argument_names(class_path)
    for name in arguments:
        if names is not None and name not in names:
            raise ArgumentError(
                Argument(name),
                f" must be an argument of {class_path.rpartition('.')[2]}: "
                f"{', '.join(names)} (got none)",
            )
    for value in arguments.values():  # such as the data set from which a view is cut
        if isinstance(value, Mapping) and "class_path" in value:
            check_arguments(value["class_path"], value.get("init_args") or {})


def build_object(content: Any, layout: TaxelLayout | None = None) -> Any:
    r"""Returns plain data with built objects. A mapping with :obj:`class_path`, and
    :obj:`init_args` if there are arguments, becomes an object of that class. Mappings inside lists
    and arguments are converted as well. All other values are returned unchanged.

    Args:
        content (Any): The plain data.
        layout (TaxelLayout, optional): Default of an argument :obj:`layout`.

    Examples:
        >>> build_object({"class_path": "torch_geometric_tactile.transforms.ZScore"})
        ZScore()
    """
    if isinstance(content, Mapping):
        if "class_path" not in content:
            return {key: build_object(value, layout) for key, value in content.items()}
        arguments = content.get("init_args") or {}
        check_arguments(content["class_path"], arguments)
        objects = {name: build_object(value, layout) for name, value in arguments.items()}
        if layout is not None and "layout" in (argument_names(content["class_path"]) or ()):
            objects.setdefault("layout", layout)
        return find_class(content["class_path"])(**objects)
    if isinstance(content, list | tuple):
        return [build_object(value, layout) for value in content]
    return content
