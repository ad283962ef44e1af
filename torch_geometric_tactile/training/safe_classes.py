r"""Which classes a checkpoint, or the configuration beside one, may name.

Such a file may come from anywhere, and Lightning would call whatever it names. Here each name is
looked up and checked before anything is built, and replaced by the full path of the class that was
found, so that it cannot mean another one later.
"""

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.cli import ReduceLROnPlateau
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import Protocol, Split, StaticDataset

PACKAGES = (
    "torch_geometric_tactile",
    "torch.nn",
    "torch.optim",
    "torch_geometric.nn",
    "torch_geometric.transforms",
)
# Parts of them whose constructors evaluate text, or load files and models by their names.
DENIED = (
    "torch.nn.attention",
    "torch.nn.parallel",
    "torch.nn.utils",
    "torch_geometric.nn.model_hub",
    "torch_geometric.nn.models.git_mol",
    "torch_geometric.nn.models.glem",
    "torch_geometric.nn.models.g_retriever",
    "torch_geometric.nn.models.molecule_gpt",
    "torch_geometric.nn.nlp",
    "torch_geometric.nn.sequential",
)
# Where a class is looked for that is given without its package.
_SHORT = (
    "torch_geometric_tactile.nn.models",
    "torch_geometric_tactile.nn",
    "torch_geometric_tactile.transforms",
    "torch_geometric_tactile.datasets",
    "torch_geometric_tactile.data",
    "torch.nn",
    "torch.optim",
    "torch.optim.lr_scheduler",
    "torch_geometric.nn",
    "torch_geometric.transforms",
)
# What the places of a configuration ask for.
_PLACES: dict[str, tuple[type, ...]] = {
    "model.model": (nn.Module,),
    "model.optimizer": (Optimizer,),
    "model.lr_scheduler": (LRScheduler, ReduceLROnPlateau),
    "data.dataset": (StaticDataset,),
    "data.val_dataset": (StaticDataset,),
    "data.test_dataset": (StaticDataset,),
    "data.transform": (BaseTransform,),
    "data.train_transform": (BaseTransform,),
}
_INSIDE = (nn.Module, BaseTransform, Optimizer, LRScheduler, ReduceLROnPlateau)
_INSIDE_DATA = (*_INSIDE, StaticDataset, Protocol, Split)
_DTYPES = {f"torch.{key}" for key, value in vars(torch).items() if isinstance(value, torch.dtype)}
_CLASS_KEYS = {"class_path", "init_args", "dict_kwargs"}
_PLAIN = (bool, int, float, Tensor, torch.dtype, torch.device, torch.Size)
_ESCAPE = re.compile(r"\\(?:x([0-9a-fA-F]{2})|u([0-9a-fA-F]{4})|U([0-9a-fA-F]{8})|\s*\n\s*)")
_MAX_DEPTH = 50
_MAX_VALUES = 100_000


def safe_section(
    section: str, settings: Any, source: object, allow: Sequence[str] = ()
) -> dict[str, Any]:
    r"""Returns a section of a configuration from a file that is not trusted, with full paths of its
    classes.

    Each class must live in one of :obj:`PACKAGES` (or in one that :obj:`allow` names), under the
    name that is given as well as by its own, and be a subclass of what the place asks for. Nothing
    outside of these packages is imported.

    Args:
        section (str): :obj:`"model"` or :obj:`"data"`.
        settings (Mapping): The section.
        source (object): The file, for messages.
        allow (sequence of str): Further packages, modules or classes whose classes are trusted.

    Raises:
        ValueError: If a class is not allowed, or a value is no plain data; the message tells what
            and where.
    """
    if isinstance(allow, str):
        raise ValueError(f"'allow' must be a list of packages (got the text '{allow}')")
    checked: dict[str, Any] = _Checker(section, source, tuple(allow)).section(settings)
    # Twice: the modules of classes that were found may have brought in others of short names.
    return _Checker(section, source, tuple(allow)).section(checked)


@dataclass
class _Checker:
    name: str
    source: object
    allow: tuple[str, ...]
    num_values: int = field(default=0)

    def section(self, settings: Any) -> dict[str, Any]:
        if not isinstance(settings, Mapping):
            raise self.error(f"'{self.name}' must be a mapping (got {type(settings).__name__})")
        out = {}
        for key, value in settings.items():
            place = f"{self.name}.{key}"
            self.key(key, self.name)
            if place not in _PLACES or value is None:
                out[key] = self.value(value, place, 0)
            elif isinstance(value, str):
                out[key] = {"class_path": self.class_path(value, place, _PLACES[place])}
            elif isinstance(value, Mapping) and "class_path" in value:
                out[key] = self.described(value, place, _PLACES[place], 0)
            else:
                raise self.error(f"'{place}' must have a 'class_path'")
        return out

    def value(self, value: Any, where: str, depth: int) -> Any:
        self.num_values += 1
        if depth > _MAX_DEPTH or self.num_values > _MAX_VALUES:
            raise self.error(
                f"'{where}' must hold at most {_MAX_VALUES} values, nested {_MAX_DEPTH} deep"
            )
        if value is None or isinstance(value, _PLAIN):
            return value
        if isinstance(value, str):
            self.text(value, where)
            return value
        if isinstance(value, list | tuple):
            return [self.value(item, f"{where}[{i}]", depth + 1) for i, item in enumerate(value)]
        if not isinstance(value, Mapping):
            raise self.error(f"'{where}' must be plain data (got {type(value).__name__})")
        if "class_path" in value:
            inside = _INSIDE if self.name == "model" else _INSIDE_DATA
            return self.described(value, where, inside, depth)
        for key in value:
            self.key(key, where, is_argument=False)
        return {key: self.value(item, f"{where}.{key}", depth + 1) for key, item in value.items()}

    def described(
        self, value: Mapping[Any, Any], where: str, kinds: tuple[type, ...], depth: int
    ) -> dict[str, Any]:
        if unknown := set(value) - _CLASS_KEYS:
            raise self.error(f"'{where}' must have the keys {sorted(_CLASS_KEYS)} (got {unknown})")
        out: dict[str, Any] = {"class_path": self.class_path(value["class_path"], where, kinds)}
        for name in ("init_args", "dict_kwargs"):
            arguments = value.get(name)
            if arguments is None:
                continue
            if not isinstance(arguments, Mapping):
                raise self.error(f"'{where}.{name}' must be a mapping")
            for key in arguments:
                self.key(key, where)
            out[name] = {
                key: self.value(item, f"{where}.{key}", depth + 1)
                for key, item in arguments.items()
            }
        return out

    def key(self, key: Any, where: str, is_argument: bool = True) -> None:
        # Keys such as 'model.class_path' and 'model+' would be paths into other values.
        if not isinstance(key, str | int) or (is_argument and not str(key).isidentifier()):
            raise self.error(f"'{where}' must have names as keys (got {key!r})")
        if any(name in _unescaped(str(key)) for name in (*_CLASS_KEYS, "__path__", "_class_path")):
            raise self.error(f"'{where}' must have no key {key!r}")

    def text(self, text: str, where: str) -> None:
        # What jsonargparse may make of a text where an argument takes more than texts: a mapping,
        # the contents of a file, or what an import path leads to.
        if "class_path" in _unescaped(text):
            raise self.error(f"'{where}' must have no class in a text (got {text[:80]!r})")
        if "://" in text or "::" in text or _is_file(text, where):
            raise self.error(f"'{where}' must be no file or address (got {text[:80]!r})")
        if not all(part.isidentifier() for part in text.split(".")):
            return
        if "." not in text:
            known = self.known.get(text, ())
            if known and not any(self.is_allowed(_path(cls)) for cls in known):
                raise self.not_allowed(_path(known[0]), where)
        elif _is_in(text, self.allow):
            self.found(text, where)  # her own functions as well
        elif self.is_allowed(text):
            self.class_path(text, where, _INSIDE_DATA)
        elif text not in _DTYPES and _is_module(text.partition(".")[0]):
            raise self.not_allowed(text, where)

    @cached_property
    def known(self) -> dict[str, list[type]]:
        r"""The classes that a name without package may mean to jsonargparse."""
        found: dict[str, list[type]] = {}
        for cls in _subclasses(_INSIDE_DATA):
            found.setdefault(cls.__name__, []).append(cls)
        return found

    def class_path(self, path: Any, where: str, kinds: tuple[type, ...]) -> str:
        if not isinstance(path, str):
            raise self.error(f"'{where}.class_path' must be a text (got {type(path).__name__})")
        if "." not in path:
            path = next((f"{place}.{path}" for place in _SHORT if _has(place, path)), path)
        if path == _path(ReduceLROnPlateau):
            found: Any = ReduceLROnPlateau
        elif self.is_allowed(path):
            found = self.found(path, where)
        else:
            raise self.not_allowed(path, where)
        if not isinstance(found, type):
            raise self.error(f"'{where}' must name a class, not a function (got '{path}')")
        is_own = _is_in(path, self.allow)
        if not issubclass(found, kinds) and not (is_own and where not in _PLACES):
            names = " or a ".join(kind.__name__ for kind in kinds)
            raise self.error(f"'{where}' must be a {names} (got '{path}')")
        return path if is_own else _path(found)

    def found(self, path: str, where: str) -> Any:
        # The class or function; by its own name it must be allowed as well: a module has much in
        # it that it has from elsewhere.
        module, _, name = path.rpartition(".")
        if not all(part.isidentifier() and not part.startswith("__") for part in path.split(".")):
            raise self.error(f"'{where}' must be an import path (got '{path}')")
        try:
            found = getattr(import_module(module), name)
        except (ImportError, AttributeError) as error:
            raise self.error(f"'{where}' must be a class (got '{path}': {error})") from error
        own = _path(found)
        is_inner = "." in getattr(found, "__qualname__", ".")
        if (is_inner or not self.is_allowed(own)) and path not in self.allow:
            raise self.not_allowed(path if own.startswith("?") else own, where)
        return found

    def is_allowed(self, path: str) -> bool:
        ours = _is_in(path, PACKAGES) and not _is_in(path, DENIED)
        return ours or path == _path(ReduceLROnPlateau) or _is_in(path, self.allow)

    def error(self, text: str) -> ValueError:
        return ValueError(f"'{self.source}' cannot be used: {text}")

    def not_allowed(self, path: str, where: str) -> ValueError:
        return self.error(
            f"'{where}' names '{path}', which is not among the classes that a file may name (those "
            f"of {', '.join(PACKAGES)}); if it is your own, allow it or its package: "
            f"allow=['{path}'] in Python, --allow {path} on the command line"
        )


def _is_in(path: str, packages: Sequence[str]) -> bool:
    return any(path == package or path.startswith(f"{package}.") for package in packages)


def _has(module: str, name: str) -> bool:
    return isinstance(getattr(import_module(module), name, None), type)


def _path(value: Any) -> str:
    return f"{getattr(value, '__module__', '?')}.{getattr(value, '__qualname__', '?')}"


def _unescaped(text: str) -> str:
    # With the escapes of YAML and JSON that can hide a letter.
    def letter(match: re.Match[str]) -> str:
        code = int(next(filter(None, match.groups()), "0"), 16)
        return chr(code) if 0 < code < sys.maxunicode else ""

    return _ESCAPE.sub(letter, text) if "\\" in text else text


def _is_file(text: str, where: str) -> bool:
    try:
        path = Path(text)
        if path.is_file() and where.endswith(".layout") and path.suffix == ".json":
            return False
        return path.exists() and not path.is_dir()
    except (OSError, ValueError):
        return False


def _is_module(name: str) -> bool:
    try:
        return name in sys.modules or find_spec(name) is not None  # which imports nothing
    except (ImportError, ValueError):
        return False


def _subclasses(kinds: Sequence[type]) -> list[type]:
    found: dict[type, None] = {}
    waiting = list(kinds)
    subclasses: Callable[[type], list[type]] = type.__subclasses__
    while waiting:
        cls = waiting.pop()
        if cls not in found:
            found[cls] = None
            waiting += subclasses(cls)
    return list(found)
