r"""Measures the package and prints Markdown: ``python tests/structure/package_files.py``.

Nothing is imported; the files are parsed. The folder of the package may be that of
an older checkout (``--root FOLDER``). The definitions:

* **folder**: a folder directly below the package, with its subfolders; files beside these are
  ``.``.
* **exported**: in the ``__all__`` of an ``__init__`` (of its ``.pyi`` where there is one). A module
  that is exported as a whole exports each of its names without an underscore. A name that two
  folders export counts once.
* **private**: a module is private if a part of its path begins with an underscore.
* **unexported module**: not private, without an exported name, and neither an entry point
  (``__init__``, ``__main__``, ``cli``) nor a command (named in ``commands``).
* **public-looking**: a function, class or constant at the top of a module that is not private,
  itself without an underscore, that no ``__init__`` exports from there. Commands are called by
  their names, and do not count.
* **ambiguous**: a function or class without an underscore at the top of two modules, commands and
  entry points aside.
* **docstrings**: the lines of the docstrings of modules, classes and functions.
* **cases**: functions ``test_...`` in ``tests`` beside the package, not multiplied by parameters.
"""

import argparse
import ast
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "torch_geometric_tactile"
ENTRY_POINTS = ("__init__", "__main__", "cli")


@dataclass(frozen=True)
class Module:
    r"""A file of the package: its name below the package, such as :obj:`data.windows`."""

    name: str
    path: Path

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.path.read_text(encoding="utf-8"))

    @cached_property
    def num_lines(self) -> int:
        return len(self.path.read_text(encoding="utf-8").splitlines())

    @property
    def folder(self) -> str:
        return self.name.partition(".")[0] if "." in self.name else "."

    @property
    def is_private(self) -> bool:
        return any(p.startswith("_") and p not in ENTRY_POINTS for p in self.name.split("."))

    @property
    def is_entry_point(self) -> bool:
        return self.name.rpartition(".")[2] in ENTRY_POINTS

    @property
    def definitions(self) -> list[str]:
        r"""The names of the functions, classes and constants at the top of the module."""
        names: list[str] = []
        for node in _statements(self.tree.body):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                names.append(node.name)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names += [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        return [name for name in dict.fromkeys(names) if not name.startswith("_")]


@dataclass(frozen=True)
class PackageFiles:
    r"""The modules of a package, by name."""

    root: Path

    @cached_property
    def modules(self) -> dict[str, Module]:
        paths = {".".join(p.relative_to(self.root).with_suffix("").parts): p for p in self._paths()}
        return {name: Module(name, path) for name, path in sorted(paths.items())}

    @cached_property
    def folders(self) -> list[str]:
        return sorted({module.folder for module in self.modules.values()})

    @cached_property
    def exports(self) -> set[tuple[str, str]]:
        r"""The exported names, each with the module that the :obj:`__init__` takes it from."""
        exports = set()
        for name in self.inits:
            stub = self.modules[name].path.with_suffix(".pyi")
            tree = ast.parse(stub.read_text("utf-8")) if stub.exists() else self.modules[name].tree
            exported = set(names_of_all(tree) or ())
            nodes = _statements(tree.body)
            for source, _, alias in imports(nodes, name.rpartition(".")[0]):
                if alias in exported:
                    exports |= self._from(source, alias)
            exports |= {(name, n) for n in self.modules[name].definitions if n in exported}
        return exports

    @property
    def inits(self) -> list[str]:
        return [name for name in self.modules if name.rpartition(".")[2] == "__init__"]

    @cached_property
    def commands(self) -> set[str]:
        r"""The modules that the command line finds by name: commands and their kinds."""
        modules = set()
        for module in self.modules.values():
            if module.folder != "commands":
                continue
            for node in _statements(module.tree.body):
                if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                    if getattr(target, "id", "") in ("COMMANDS", "_ALL_COMMANDS", "KINDS"):
                        texts = (
                            n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)
                        )
                        modules |= {f"commands.{text}" for text in texts if isinstance(text, str)}
        return modules & set(self.modules)

    @property
    def unexported_modules(self) -> list[str]:
        exporting = {source for source, _ in self.exports} | self.commands
        return [
            m.name for m in self.modules.values() if self._is_public(m) and m.name not in exporting
        ]

    @property
    def public_looking(self) -> list[str]:
        return [
            f"{module.name}.{name}"
            for module in self.modules.values()
            if self._is_public(module) and module.name not in self.commands
            for name in module.definitions
            if (module.name, name) not in self.exports
        ]

    @property
    def ambiguous(self) -> list[str]:
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        counts = Counter(
            node.name
            for module in self.modules.values()
            if module.name not in self.commands and not module.is_entry_point
            for node in module.tree.body
            if isinstance(node, kinds) and not node.name.startswith("_")
        )
        return sorted(name for name, number in counts.items() if number > 1)

    def _from(self, source: str, alias: str) -> set[tuple[str, str]]:
        # A module that is exported as a whole exports the names that it defines; a package, none.
        if (whole := self.modules.get(f"{source}.{alias}".lstrip("."))) is not None:
            return {(whole.name, name) for name in whole.definitions}
        is_package = f"{source}.{alias}.__init__".lstrip(".") in self.modules
        is_init = f"{source}.__init__".lstrip(".") in self.modules
        return set() if is_package or is_init else {(source, alias)}

    def _is_public(self, module: Module) -> bool:
        return not module.is_private and not module.is_entry_point

    def _paths(self) -> Iterator[Path]:
        return (p for p in self.root.rglob("*.py") if "__pycache__" not in p.parts)


def _statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    # The statements of a module, those below its `if` and `try` included.
    for node in body:
        if isinstance(node, ast.If | ast.Try):
            yield from _statements(node.body)
            yield from _statements(node.orelse)
        else:
            yield node


def names_of_all(tree: ast.Module) -> list[str] | None:
    r"""Returns the names in :obj:`__all__`, or :obj:`None` if a module has none."""
    names: list[str] | None = None
    for node in _statements(tree.body):
        assigned = isinstance(node, ast.Assign) and any(
            "__all__" in ast.dump(t) for t in node.targets
        )
        added = isinstance(node, ast.AugAssign) and "__all__" in ast.dump(node.target)
        if isinstance(node, ast.Assign | ast.AugAssign) and (assigned or added):
            texts = [n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)]
            names = (names or []) + [text for text in texts if isinstance(text, str)]
    return names


def imports(nodes: Iterable[ast.AST], package: str) -> Iterator[tuple[str, str, str]]:
    r"""Yields the names imported from this package: module, name there and name here."""
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            source = node.module or ""
            if node.level == 1:
                source = f"{package}.{source}".strip(".")
            elif source.partition(".")[0] == PACKAGE.name:
                source = source.partition(".")[2]
            else:
                continue
            yield from ((source, alias.name, alias.asname or alias.name) for alias in node.names)


def count(files: PackageFiles, folder: str | None = None) -> dict[str, float]:
    r"""Returns the numbers of a folder, or of the whole package."""
    modules = [m for m in files.modules.values() if folder in (None, m.folder)]
    lines = sum(m.num_lines for m in modules)
    nodes = [node for m in modules for node in ast.walk(m.tree)]
    with_docstrings = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = [
        n.body[0]
        for n in nodes
        if isinstance(n, with_docstrings) and ast.get_docstring(n) is not None
    ]
    exported = {name for source, name in files.exports if files.modules[source] in modules}
    unexported = [files.modules[name] for name in files.unexported_modules]
    public_looking = [files.modules[name.rpartition(".")[0]] for name in files.public_looking]
    return {
        "lines": lines,
        "files": len(modules),
        "exported": len(exported),
        "lines per export": lines / max(1, len(exported)),
        "raises per 1,000": 1000 * sum(isinstance(n, ast.Raise) for n in nodes) / lines,
        "docstrings %": 100 * sum((d.end_lineno or 0) - d.lineno + 1 for d in docs) / lines,
        "public-looking": sum(m in modules for m in public_looking),
        "unexported modules": sum(m in modules for m in unexported),
    }


def main() -> None:
    r"""Prints the table."""
    parser = argparse.ArgumentParser(description="Measures the package.")
    parser.add_argument("--root", type=Path, default=PACKAGE, help="folder of the package")
    files = PackageFiles(parser.parse_args().root.resolve())
    rows = {folder: count(files, folder) for folder in files.folders} | {"all": count(files)}
    print(f"| folder | {' | '.join(rows['all'])} |\n|---|{'---:|' * len(rows['all'])}")
    for folder, row in rows.items():
        print(f"| {folder} | " + " | ".join(f"{value:,.0f}" for value in row.values()) + " |")
    tests = [p for p in (files.root.parent / "tests").rglob("*.py") if "__pycache__" not in p.parts]
    texts = [path.read_text(encoding="utf-8") for path in tests]
    functions = (n for t in texts for n in ast.walk(ast.parse(t)) if isinstance(n, ast.FunctionDef))
    cases = sum(node.name.startswith("test_") for node in functions)
    lines = sum(len(text.splitlines()) for text in texts)
    print(f"\ntests: {lines:,} lines, {cases:,} cases (functions), {len(tests)} files")


if __name__ == "__main__":
    main()
