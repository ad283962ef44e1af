r"""Measures the package: ``python tests/house/measure.py [--root FOLDER]`` prints Markdown.

Nothing is imported; the files are parsed. ``--root`` is the folder of the package, such as that of
an older checkout. The definitions:

* **room**: a folder of the package, its own folders included; files beside them are ``.``.
* **exported**: in the ``__all__`` of an ``__init__`` (of its ``.pyi`` where there is one). A module
  that is exported as a whole exports each of its names without an underscore. A name that two rooms
  export counts once.
* **private**: a module is private if a part of its path begins with an underscore.
* **unsigned module**: not private, without an exported name, and neither an entry (``__init__``,
  ``__main__``, ``cli``) nor a verb of the command line (named in ``commands``).
* **public-looking**: a function, class or constant at the top of a module that is not private,
  itself without an underscore, that no ``__init__`` exports from there. Verbs are called by their
  names, and are left out. At 34e7a70 there are 873 (666 functions and classes, 207 constants), and
  200 unsigned modules, 217 with the 17 verbs.
* **ambiguous**: a function or class without an underscore at the top of two modules, without verbs
  and entries: one name, one meaning.
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
ENTRIES = ("__init__", "__main__", "cli")


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
    def room(self) -> str:
        return self.name.partition(".")[0] if "." in self.name else "."

    @property
    def is_private(self) -> bool:
        return any(p.startswith("_") and p not in ENTRIES for p in self.name.split("."))

    @property
    def is_entry(self) -> bool:
        return self.name.rpartition(".")[2] in ENTRIES

    @property
    def definitions(self) -> list[str]:
        r"""The names of the functions, classes and constants at the top of the module."""
        found: list[str] = []
        for node in _statements(self.tree.body):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                found.append(node.name)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                found += [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        return [name for name in dict.fromkeys(found) if not name.startswith("_")]


@dataclass(frozen=True)
class House:
    r"""The modules of a package, by name."""

    root: Path

    @cached_property
    def modules(self) -> dict[str, Module]:
        paths = {".".join(p.relative_to(self.root).with_suffix("").parts): p for p in self._paths()}
        return {name: Module(name, path) for name, path in sorted(paths.items())}

    @cached_property
    def rooms(self) -> list[str]:
        return sorted({module.room for module in self.modules.values()})

    @cached_property
    def exports(self) -> set[tuple[str, str]]:
        r"""The exported names, each with the module that the :obj:`__init__` takes it from."""
        found = set()
        for name in self.inits:
            stub = self.modules[name].path.with_suffix(".pyi")
            tree = ast.parse(stub.read_text("utf-8")) if stub.exists() else self.modules[name].tree
            exported = set(names_of_all(tree) or ())
            nodes = _statements(tree.body)
            for source, _, alias in imports(nodes, name.rpartition(".")[0]):
                if alias in exported:
                    found |= self._from(source, alias)
            found |= {(name, n) for n in self.modules[name].definitions if n in exported}
        return found

    @property
    def inits(self) -> list[str]:
        return [name for name in self.modules if name.rpartition(".")[2] == "__init__"]

    @cached_property
    def verbs(self) -> set[str]:
        r"""The modules that the command line finds by name: verbs, and the kinds of a verb."""
        found = set()
        for module in self.modules.values():
            if module.room != "commands":
                continue
            for node in _statements(module.tree.body):
                if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                    if getattr(target, "id", "") in ("VERBS", "_VERBS", "KINDS"):
                        texts = (
                            n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)
                        )
                        found |= {f"commands.{text}" for text in texts if isinstance(text, str)}
        return found & set(self.modules)

    @property
    def unsigned_modules(self) -> list[str]:
        signed = {source for source, _ in self.exports} | self.verbs
        return [
            m.name for m in self.modules.values() if self._is_public(m) and m.name not in signed
        ]

    @property
    def public_looking(self) -> list[str]:
        return [
            f"{module.name}.{name}"
            for module in self.modules.values()
            if self._is_public(module) and module.name not in self.verbs
            for name in module.definitions
            if (module.name, name) not in self.exports
        ]

    @property
    def ambiguous(self) -> list[str]:
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        counts = Counter(
            node.name
            for module in self.modules.values()
            if module.name not in self.verbs and not module.is_entry
            for node in module.tree.body
            if isinstance(node, kinds) and not node.name.startswith("_")
        )
        return sorted(name for name, number in counts.items() if number > 1)

    def _from(self, source: str, alias: str) -> set[tuple[str, str]]:
        # A module that is exported as a whole exports the names that it defines; a package, none.
        if (whole := self.modules.get(f"{source}.{alias}".lstrip("."))) is not None:
            return {(whole.name, name) for name in whole.definitions}
        is_room = f"{source}.{alias}.__init__".lstrip(".") in self.modules
        is_init = f"{source}.__init__".lstrip(".") in self.modules
        return set() if is_room or is_init else {(source, alias)}

    def _is_public(self, module: Module) -> bool:
        return not module.is_private and not module.is_entry

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
    found: list[str] | None = None
    for node in _statements(tree.body):
        named = isinstance(node, ast.Assign) and any("__all__" in ast.dump(t) for t in node.targets)
        added = isinstance(node, ast.AugAssign) and "__all__" in ast.dump(node.target)
        if isinstance(node, ast.Assign | ast.AugAssign) and (named or added):
            texts = [n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)]
            found = (found or []) + [text for text in texts if isinstance(text, str)]
    return found


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


def count(house: House, room: str | None = None) -> dict[str, float]:
    r"""Returns the numbers of a room, or of the whole package."""
    modules = [m for m in house.modules.values() if room in (None, m.room)]
    lines = sum(m.num_lines for m in modules)
    nodes = [node for m in modules for node in ast.walk(m.tree)]
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = [n.body[0] for n in nodes if isinstance(n, holders) and ast.get_docstring(n) is not None]
    exported = {name for source, name in house.exports if house.modules[source] in modules}
    unsigned = [house.modules[name] for name in house.unsigned_modules]
    looking = [house.modules[name.rpartition(".")[0]] for name in house.public_looking]
    return {
        "lines": lines,
        "files": len(modules),
        "exported": len(exported),
        "lines per export": lines / max(1, len(exported)),
        "raises per 1,000": 1000 * sum(isinstance(n, ast.Raise) for n in nodes) / lines,
        "docstrings %": 100 * sum((d.end_lineno or 0) - d.lineno + 1 for d in docs) / lines,
        "public-looking": sum(m in modules for m in looking),
        "unsigned modules": sum(m in modules for m in unsigned),
    }


def main() -> None:
    r"""Prints the table."""
    parser = argparse.ArgumentParser(description="Measures the package.")
    parser.add_argument("--root", type=Path, default=PACKAGE, help="folder of the package")
    house = House(parser.parse_args().root.resolve())
    rows = {room: count(house, room) for room in house.rooms} | {"all": count(house)}
    print(f"| room | {' | '.join(rows['all'])} |\n|---|{'---:|' * len(rows['all'])}")
    for room, row in rows.items():
        print(f"| {room} | " + " | ".join(f"{value:,.0f}" for value in row.values()) + " |")
    tests = [p for p in (house.root.parent / "tests").rglob("*.py") if "__pycache__" not in p.parts]
    texts = [path.read_text(encoding="utf-8") for path in tests]
    functions = (n for t in texts for n in ast.walk(ast.parse(t)) if isinstance(n, ast.FunctionDef))
    cases = sum(node.name.startswith("test_") for node in functions)
    lines = sum(len(text.splitlines()) for text in texts)
    print(f"\ntests: {lines:,} lines, {cases:,} cases (functions), {len(tests)} files")


if __name__ == "__main__":
    main()
