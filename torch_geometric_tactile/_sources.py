r"""The source code of classes and functions that belong neither to this package nor to an installed
library: a user's own models, estimators, data sets and transforms.
"""

import ast
import hashlib
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from functools import cache, lru_cache
from importlib.machinery import SOURCE_SUFFIXES, ModuleSpec
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

_PACKAGE = __name__.partition(".")[0]
_INSTALLED = ("site-packages", "dist-packages")
_LITERAL_IMPORTS = ("import_module", "__import__")
_DIGITS = 16  # of a SHA-256, that are kept

# The digest of each loaded module when it was first read, with the spec that it was loaded by:
# `importlib.reload` sets another one. A file may be edited after its module was loaded.
_loaded: dict[str, tuple[ModuleSpec, str]] = {}


class OwnSources(NamedTuple):
    r"""The source code behind import paths.

    Args:
        modules (dict): A hash of the source of each module, by the module's name.
        libraries (dict): The version of each installed library that they import, by its name.
        unknown (dict): Why the source of a module is not known, by the module's name.
    """

    modules: dict[str, str]
    libraries: dict[str, str]
    unknown: dict[str, str]


class _Module(NamedTuple):
    spec: ModuleSpec | None
    source: bytes | None  # None for packages without a file, and where the source is not known
    reason: str  # why the source is not known; empty if it is


def own_sources(import_paths: Iterable[str]) -> OwnSources:
    r"""Returns the source code that classes, functions and modules are made of: the modules of
    their import paths, and all modules that these import, directly or not, at the top or inside
    functions. It stops at this package, the standard library and installed libraries, of which the
    versions are returned. No module is imported.

    Not noticed are modules whose names are computed (``import_module(name)``), files that a module
    reads, and values that are set at run time.

    Args:
        import_paths (iterable of str): Such as :obj:`"my_nets.MyNet"`. Texts that are no import
            paths are skipped.

    Examples:
        >>> own_sources(["torch_geometric_tactile.nn.TaxelNet", "collections.OrderedDict"])
        OwnSources(modules={}, libraries={}, unknown={})
    """
    modules: dict[str, str] = {}
    libraries: set[str] = set()
    unknown: dict[str, str] = {}
    pending = [name for path in import_paths for name in _prefixes(path)]
    visited: set[str] = set()
    while pending:
        name = pending.pop()
        top = name.partition(".")[0]
        # The top package comes first, so that nothing is searched in installed libraries.
        if name != top and top not in visited and top != _PACKAGE:
            pending += [name, top]
            continue
        if name in visited or top == _PACKAGE or top in libraries:
            continue
        visited.add(name)
        module = _find_module(name)
        if module is None:
            continue
        if _is_installed(module.spec):
            libraries.add(top)
            continue
        if module.reason:
            unknown[name] = module.reason
        if module.source is None:
            continue
        modules[name], reason = _digest_of_loaded(name, module.source)
        if reason:
            unknown[name] = reason
        is_package = module.spec is not None and module.spec.submodule_search_locations is not None
        pending.extend(_imported_names(module.source, name, is_package))
    return OwnSources(
        modules=dict(sorted(modules.items())),
        libraries=_versions(libraries),
        unknown=dict(sorted(unknown.items())),
    )


def source_mark(value: Any) -> str:
    r"""Returns a short hash of the source code of a class or function, its base classes and all
    that these import, as :func:`own_sources` finds it; an empty text if it is this package's or an
    installed library's, or has no file.

    Args:
        value (Any): A class or a function.
    """
    kinds = value.__mro__ if isinstance(value, type) else (value,)
    names = {getattr(kind, "__module__", None) or "" for kind in kinds}
    sources = own_sources(sorted(names))
    if not sources.modules:
        return ""
    return _sha256("\n".join(" ".join(item) for item in sources.modules.items()).encode())


def has_source(value: Any) -> bool:
    r"""Returns whether the source code of a class or function is in a file that can be read, or is
    that of this package or an installed library.

    Args:
        value (Any): A class or a function.
    """
    name = getattr(value, "__module__", None) or "builtins"
    module = _find_module(name)
    return module is not None and not module.reason


def _prefixes(path: str) -> list[str]:
    # 'a', 'a.b' and 'a.b.C' of 'a.b.C': which of them are modules is asked later.
    parts = path.split(".")
    if not all(part.isidentifier() for part in parts):
        return []
    return [".".join(parts[:count]) for count in range(1, len(parts) + 1)]


def _find_module(name: str) -> _Module | None:
    # As an import would find it; `importlib.util.find_spec` would import the packages above it.
    if name == "__main__":
        return _Module(None, None, "it is defined in '__main__': a notebook, or the script itself")
    loaded = sys.modules.get(name)
    spec = getattr(loaded, "__spec__", None) if loaded is not None else _find_spec(name)
    if spec is None and loaded is None:
        return None
    file = _source_file(spec, loaded)
    if file is not None:
        try:
            return _Module(spec, file.read_bytes(), "")
        except OSError as error:
            return _Module(spec, None, f"'{file}' cannot be read ({error.strerror})")
    if spec is None:
        return _Module(None, None, "it has no file")
    if _is_installed(spec) or (spec.origin is None and spec.submodule_search_locations):
        return _Module(spec, None, "")  # the latter is a package without an `__init__.py`
    try:  # in a zip file, for example
        text = spec.loader.get_source(name)  # type: ignore[union-attr]
    except (AttributeError, ImportError, OSError, SyntaxError):
        text = None
    if text is None:
        return _Module(spec, None, f"'{spec.origin}' is no source code")
    return _Module(spec, text.encode(), "")


def _find_spec(name: str) -> ModuleSpec | None:
    parent, _, _ = name.rpartition(".")
    path: Any = None
    if parent:
        above = sys.modules.get(parent)
        found = getattr(above, "__spec__", None) if above is not None else _find_spec(parent)
        path = getattr(found, "submodule_search_locations", None)
        if path is None:
            return None
    for finder in sys.meta_path:
        find = getattr(finder, "find_spec", None)
        spec: ModuleSpec | None = None if find is None else find(name, path)
        if spec is not None:
            return spec
    return None


def _source_file(spec: ModuleSpec | None, loaded: ModuleType | None) -> Path | None:
    origin = getattr(loaded, "__file__", None) if spec is None else spec.origin
    if origin is None or not origin.endswith(tuple(SOURCE_SUFFIXES)):
        return None
    path = Path(origin)
    return path if path.is_file() and not _is_installed(spec) else None


def _is_installed(spec: ModuleSpec | None) -> bool:
    if spec is None:
        return False
    if spec.origin in ("built-in", "frozen"):
        return True
    places = [spec.origin] if spec.origin else list(spec.submodule_search_locations or ())
    return bool(places) and all(_is_installed_file(place) for place in places)


@lru_cache(maxsize=10_000)
def _is_installed_file(place: str) -> bool:
    path = Path(place).absolute()
    if any(part in _INSTALLED for part in path.parts):
        return True
    return any(path.is_relative_to(folder) for folder in _standard_library())


@cache
def _standard_library() -> tuple[Path, ...]:
    keys = ("stdlib", "platstdlib")
    folders = {Path(sysconfig.get_paths()[key]) for key in keys}
    return tuple({*folders, *(folder.resolve() for folder in folders)})


def _digest_of_loaded(name: str, source: bytes) -> tuple[str, str]:
    # That of the code that runs in this process, and why it is not that of the file.
    digest = _sha256(source)
    spec = getattr(sys.modules.get(name), "__spec__", None)
    if spec is None:
        return digest, ""
    known, first = _loaded.get(name, (None, ""))
    if known is not spec:
        _loaded[name] = (spec, digest)
    elif first != digest:
        return first, "it was edited after it was imported; restart Python, or reload it"
    return digest, ""


@lru_cache(maxsize=2_000)
def _imported_names(source: bytes, name: str, is_package: bool) -> tuple[str, ...]:
    # Also names that are attributes of modules.
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ()  # it cannot be imported, and imports nothing
    package = name if is_package else name.rpartition(".")[0]
    return tuple({prefix for path in _imports(tree, package) for prefix in _prefixes(path)})


def _imports(tree: ast.AST, package: str) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".") if node.level else []
            parts = parts[: len(parts) - max(node.level - 1, 0)]
            base = ".".join([*parts, *([node.module] if node.module else [])])
            yield from (
                base if alias.name == "*" else f"{base}.{alias.name}" for alias in node.names
            )
        elif isinstance(node, ast.Call) and node.args:
            function, first = node.func, node.args[0]
            called = getattr(function, "attr", getattr(function, "id", None))
            if called in _LITERAL_IMPORTS and isinstance(first, ast.Constant):
                yield str(first.value)
        elif isinstance(node, ast.Assign) and package:
            targets = [getattr(target, "id", None) for target in node.targets]
            if "__all__" in targets:  # 'from package import *' imports modules of these names
                items = [item for item in ast.walk(node.value) if isinstance(item, ast.Constant)]
                yield from (".".join([package, str(item.value)]) for item in items)


def _versions(libraries: Iterable[str]) -> dict[str, str]:
    names = {name for top in libraries for name in _distributions().get(top, ())}
    return {name: _version(name) for name in sorted(names)}


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "unknown"


@cache
def _distributions() -> dict[str, list[str]]:
    return dict(packages_distributions())


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]
