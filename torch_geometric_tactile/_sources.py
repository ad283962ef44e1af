r"""Hashes of the source code of the user's models, estimators, data sets and transforms. These are
classes and functions that belong neither to this package nor to an installed library.
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
_LIBRARY_FOLDERS = ("site-packages", "dist-packages")
_IMPORT_FUNCTIONS = ("import_module", "__import__")
_HASH_DIGITS = 16  # of a SHA-256; 64 bits are enough to tell versions of a file apart

# The digest of each loaded module at its first reading, with its spec, which `importlib.reload`
# replaces. A file may be edited after its module was loaded.
_loaded_digests: dict[str, tuple[ModuleSpec, str]] = {}


class UserSources(NamedTuple):
    r"""The source code behind import paths.

    Args:
        modules (dict): Maps the name of a module to a hash of its source.
        libraries (dict): Maps the name of an imported library to its installed version.
        unknown (dict): Maps the name of a module with unknown source to the reason.
    """

    modules: dict[str, str]
    libraries: dict[str, str]
    unknown: dict[str, str]


class _Module(NamedTuple):
    spec: ModuleSpec | None
    source: bytes | None  # None for packages without a file, and if the source is unknown
    reason: str  # why the source is unknown; empty if it is known


def user_sources(import_paths: Iterable[str]) -> UserSources:
    r"""Returns hashes of the source code on which classes, functions and modules depend.

    The result includes the modules in their import paths and all modules that these import,
    directly or indirectly, at the top or inside functions. It leaves out this package and the
    standard library, and lists the versions of installed libraries. No module is imported.

    The result cannot include modules with computed names (``import_module(name)``), files that a
    module reads, or values that are set at run time.

    Args:
        import_paths (iterable of str): Import paths, such as :obj:`"my_nets.MyNet"`. Other texts
            are skipped.

    Examples:
        >>> user_sources(["torch_geometric_tactile.nn.TaxelNet", "collections.OrderedDict"])
        UserSources(modules={}, libraries={}, unknown={})
    """
    modules: dict[str, str] = {}
    libraries: set[str] = set()
    unknown: dict[str, str] = {}
    pending = [name for path in import_paths for name in _prefixes(path)]
    visited: set[str] = set()
    while pending:
        name = pending.pop()
        top = name.partition(".")[0]
        # The top package comes first, so that installed libraries are not searched further.
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
        modules[name], reason = _loaded_digest(name, module.source)
        if reason:
            unknown[name] = reason
        is_package = module.spec is not None and module.spec.submodule_search_locations is not None
        pending.extend(_imported_names(module.source, name, is_package))
    return UserSources(
        modules=dict(sorted(modules.items())),
        libraries=_library_versions(libraries),
        unknown=dict(sorted(unknown.items())),
    )


def source_hash(value: Any) -> str:
    r"""Returns a short hash of the source code of a class or function, its base classes and their
    imports (see :func:`user_sources`). Returns an empty text if the class or function has no file,
    or belongs to this package or an installed library.

    Args:
        value (Any): A class or a function.
    """
    kinds = value.__mro__ if isinstance(value, type) else (value,)
    names = {getattr(kind, "__module__", None) or "" for kind in kinds}
    sources = user_sources(sorted(names))
    if not sources.modules:
        return ""
    return _sha256("\n".join(" ".join(item) for item in sources.modules.items()).encode())


def has_source(value: Any) -> bool:
    r"""Returns whether a class or function belongs to this package or an installed library, or has
    its source code in a readable file.

    Args:
        value (Any): A class or a function.
    """
    name = getattr(value, "__module__", None) or "builtins"
    module = _find_module(name)
    return module is not None and not module.reason


def _prefixes(path: str) -> list[str]:
    # 'a', 'a.b' and 'a.b.C' for 'a.b.C': `_find_module` later decides which of them are modules.
    parts = path.split(".")
    if not all(part.isidentifier() for part in parts):
        return []
    return [".".join(parts[:num_parts]) for num_parts in range(1, len(parts) + 1)]


def _find_module(name: str) -> _Module | None:
    # Finds the same module as an import. `importlib.util.find_spec` would import parent packages.
    if name == "__main__":
        return _Module(None, None, "it is defined in '__main__': a notebook, or the script itself")
    loaded_module = sys.modules.get(name)
    spec = (
        getattr(loaded_module, "__spec__", None) if loaded_module is not None else _find_spec(name)
    )
    if spec is None and loaded_module is None:
        return None
    file = _source_file(spec, loaded_module)
    if file is not None:
        try:
            return _Module(spec, file.read_bytes(), "")
        except OSError as error:
            return _Module(spec, None, f"'{file}' cannot be read ({error.strerror})")
    if spec is None:
        return _Module(None, None, "it has no file")
    if _is_installed(spec) or (spec.origin is None and spec.submodule_search_locations):
        return _Module(spec, None, "")  # no source: a package without an `__init__.py`
    try:  # in a zip file, for example
        text = spec.loader.get_source(name)  # type: ignore[union-attr]
    except (AttributeError, ImportError, OSError, SyntaxError):
        text = None
    if text is None:
        return _Module(spec, None, f"'{spec.origin}' is not source code")
    return _Module(spec, text.encode(), "")


def _find_spec(name: str) -> ModuleSpec | None:
    parent, _, _ = name.rpartition(".")
    path: Any = None
    if parent:
        loaded_parent = sys.modules.get(parent)
        parent_spec = (
            getattr(loaded_parent, "__spec__", None)
            if loaded_parent is not None
            else _find_spec(parent)
        )
        path = getattr(parent_spec, "submodule_search_locations", None)
        if path is None:
            return None
    for finder in sys.meta_path:
        find_spec = getattr(finder, "find_spec", None)
        spec: ModuleSpec | None = None if find_spec is None else find_spec(name, path)
        if spec is not None:
            return spec
    return None


def _source_file(spec: ModuleSpec | None, loaded_module: ModuleType | None) -> Path | None:
    origin = getattr(loaded_module, "__file__", None) if spec is None else spec.origin
    if origin is None or not origin.endswith(tuple(SOURCE_SUFFIXES)):
        return None
    path = Path(origin)
    return path if path.is_file() and not _is_installed(spec) else None


def _is_installed(spec: ModuleSpec | None) -> bool:
    if spec is None:
        return False
    if spec.origin in ("built-in", "frozen"):
        return True
    locations = [spec.origin] if spec.origin else list(spec.submodule_search_locations or ())
    return bool(locations) and all(_is_installed_file(location) for location in locations)


@lru_cache(maxsize=10_000)
def _is_installed_file(file: str) -> bool:
    path = Path(file).absolute()
    if any(part in _LIBRARY_FOLDERS for part in path.parts):
        return True
    return any(path.is_relative_to(folder) for folder in _standard_library_folders())


@cache
def _standard_library_folders() -> tuple[Path, ...]:
    keys = ("stdlib", "platstdlib")
    folders = {Path(sysconfig.get_paths()[key]) for key in keys}
    return tuple({*folders, *(folder.resolve() for folder in folders)})


def _loaded_digest(name: str, source: bytes) -> tuple[str, str]:
    # The digest of the code that this process runs. If the file differs from it, also the reason.
    digest = _sha256(source)
    spec = getattr(sys.modules.get(name), "__spec__", None)
    if spec is None:
        return digest, ""
    first_spec, first_digest = _loaded_digests.get(name, (None, ""))
    if first_spec is not spec:
        _loaded_digests[name] = (spec, digest)
    elif first_digest != digest:
        return first_digest, "it was edited after it was imported; restart Python, or reload it"
    return digest, ""


@lru_cache(maxsize=2_000)
def _imported_names(source: bytes, name: str, is_package: bool) -> tuple[str, ...]:
    # The result includes names that are attributes of modules.
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ()  # it cannot be imported, and imports nothing
    package = name if is_package else name.rpartition(".")[0]
    return tuple({prefix for path in _import_paths(tree, package) for prefix in _prefixes(path)})


def _import_paths(tree: ast.AST, package: str) -> Iterator[str]:
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
            function, argument = node.func, node.args[0]
            function_name = getattr(function, "attr", getattr(function, "id", None))
            if function_name in _IMPORT_FUNCTIONS and isinstance(argument, ast.Constant):
                yield str(argument.value)
        elif isinstance(node, ast.Assign) and package:
            targets = [getattr(target, "id", None) for target in node.targets]
            if "__all__" in targets:  # 'from package import *' imports modules of these names
                items = [item for item in ast.walk(node.value) if isinstance(item, ast.Constant)]
                yield from (".".join([package, str(item.value)]) for item in items)


def _library_versions(libraries: Iterable[str]) -> dict[str, str]:
    names = {name for top in libraries for name in _distributions_by_package().get(top, ())}
    return {name: _distribution_version(name) for name in sorted(names)}


def _distribution_version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "unknown"


@cache
def _distributions_by_package() -> dict[str, list[str]]:
    return dict(packages_distributions())


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_HASH_DIGITS]
