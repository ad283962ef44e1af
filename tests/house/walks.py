r"""Follows the arguments of two commands: ``python tests/house/walks.py [--root FOLDER]``.

How far does what a user types travel, and how often does it come back? Nothing is run; the calls
are read from the files, in the order of the code. The definitions:

* The **value** is :obj:`arguments` of a verb's :obj:`run`, and whatever is assigned from an
  expression that names the value. A call that is given the value, or is a method of it, passes it
  on to the function, whose parameters it then is. Each function is read once; further calls of it
  are counted and not read again. A method is that of the only class of the package with a method of
  this name; where several classes have one, or a type of Python has, nothing is followed.
  A guard (``_checks``) refuses values and passes none on: it is not followed, as ``raise`` is
  not.
* A **room** is a module into which the value is passed. A **stay** is a run of calls into one
  module with none into another in between; a **return** is a stay in a module that had one before.
  That a function ends is no return.
* The value is followed **to the end** of the command, reports included, or **up to the runs**: to
  the call of ``run_plan``, where the first fit would begin.

At 34e7a70: ``table`` 10 rooms and 11 returns up to the runs, 33 and 65 to the end; ``compare`` 21
and 37, 33 and 73.
"""

import argparse
import ast
import sys
from collections.abc import Iterable
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

from house.measure import PACKAGE, House, imports

VERBS = ("table", "compare")
FIT = "run_plan"
GUARDS = "_checks"  # a module
PYTHON = (str, dict, list, set, tuple, int, Path)
Function = ast.FunctionDef | ast.AsyncFunctionDef


class FitReachedError(Exception):
    r"""Ends a walk at the first fit."""


class Walk:
    r"""A walk through the functions of a package.

    Args:
        house (House): The package.
        until (str, optional): The function before which the walk ends.
    """

    def __init__(self, house: House, until: str | None = None) -> None:
        self.house = house
        self.until = until
        self.stays: list[str] = []
        self.read: set[ast.AST] = set()
        self.named: dict[tuple[str, str], ast.AST] = {}
        self.methods: dict[str, list[tuple[str, Function]]] = {}
        self.imported: dict[str, dict[str, tuple[str, str]]] = {}
        for name, module in house.modules.items():
            package = name.rpartition(".")[0]
            self.imported[name] = {
                alias: (source, original)
                for source, original, alias in imports(ast.walk(module.tree), package)
            }
            for node in module.tree.body:
                if isinstance(node, Function | ast.ClassDef):
                    self.named[name, node.name] = node
                if isinstance(node, ast.ClassDef):
                    for inner in node.body:
                        if isinstance(inner, Function):
                            self.methods.setdefault(inner.name, []).append((name, inner))

    def follow(self, module: str, function: Function, values: Iterable[str]) -> None:
        r"""Goes into a function of which the parameters :obj:`values` are the value."""
        if function.name == self.until:
            raise FitReachedError
        if not self.stays or self.stays[-1] != module:
            self.stays.append(module)
        if function not in self.read:
            self.read.add(function)
            _Reader(self, module, set(values)).read(function.body)

    def callee(self, module: str, call: ast.Call, is_value: bool) -> tuple[str, Function] | None:
        r"""Returns the function of the package that a call enters, and its module."""
        if isinstance(call.func, ast.Attribute):
            if isinstance(call.func.value, ast.Name):
                source, name = self.imported[module].get(call.func.value.id, ("", ""))
                found = self.named.get((f"{source}.{name}".strip("."), call.func.attr))
                if isinstance(found, Function):
                    return f"{source}.{name}".strip("."), found
            of_python = any(hasattr(kind, call.func.attr) for kind in PYTHON)
            methods = self.methods.get(call.func.attr, []) if is_value and not of_python else []
            return methods[0] if len(methods) == 1 else None
        if not isinstance(call.func, ast.Name):
            return None
        place = (module, call.func.id)
        while place not in self.named:  # an `__init__` hands names on
            source, name = self.imported.get(place[0], {}).get(place[1], ("", ""))
            if not name:
                return None
            place = (source if source in self.house.modules else f"{source}.__init__", name)
        found = self.named[place]
        if isinstance(found, ast.ClassDef):
            inits = [n for n in found.body if isinstance(n, Function) and n.name == "__init__"]
            return (place[0], inits[0]) if inits else None
        assert isinstance(found, Function)
        return place[0], found


class _Reader(ast.NodeVisitor):
    # Reads the body of a function in the order of the code. `values` are the names of the value.
    def __init__(self, walk: Walk, module: str, values: set[str]) -> None:
        self.walk, self.module, self.values = walk, module, values

    def read(self, body: Iterable[ast.AST]) -> None:
        for node in body:
            self.visit(node)

    def is_value(self, node: ast.AST | None) -> bool:
        nodes = () if node is None else ast.walk(node)
        return any(isinstance(n, ast.Name) and n.id in self.values for n in nodes)

    def _take(self, value: ast.AST | None, *targets: ast.AST) -> None:
        if self.is_value(value):
            names = (n for target in targets for n in ast.walk(target) if isinstance(n, ast.Name))
            self.values |= {name.id for name in names}

    def visit_Call(self, node: ast.Call) -> None:
        for given in [*node.args, *(k.value for k in node.keywords)]:
            self.visit(given)
        of_value = isinstance(node.func, ast.Attribute) and self.is_value(node.func.value)
        if isinstance(node.func, ast.Attribute):
            self.visit(node.func.value)
        found = self.walk.callee(self.module, node, of_value)
        if found is None or found[0] == GUARDS:
            return
        module, function = found
        spec = function.args
        names = [a.arg for a in (*spec.posonlyargs, *spec.args)]
        is_bound = bool(names) and names[0] in ("self", "cls")
        values = {names[0]} if is_bound and of_value else set()
        free = names[is_bound:]
        for index, given in enumerate(node.args):
            if self.is_value(given):
                values |= (
                    {*free[index:]}
                    if isinstance(given, ast.Starred)
                    else {
                        free[index] if index < len(free) else spec.vararg.arg if spec.vararg else ""
                    }
                )
        keys = [*free, *(a.arg for a in spec.kwonlyargs)]
        for keyword in node.keywords:
            if self.is_value(keyword.value):
                rest = spec.kwarg.arg if spec.kwarg else ""
                values |= (
                    set(keys)
                    if keyword.arg is None
                    else {keyword.arg if keyword.arg in keys else rest}
                )
        if values - {""}:
            self.walk.follow(module, function, values | ({"self"} if is_bound else set()))

    def visit_Assign(self, node: ast.Assign) -> None:
        self.visit(node.value)
        self._take(node.value, *node.targets)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._visit_taking(node.value, node.target)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._visit_taking(node.value, node.target)

    def visit_NamedExpr(self, node: ast.NamedExpr) -> None:
        self._visit_taking(node.value, node.target)

    def visit_For(self, node: ast.For) -> None:
        self._visit_taking(node.iter, node.target)
        self.read([*node.body, *node.orelse])

    def visit_withitem(self, node: ast.withitem) -> None:
        self._visit_taking(node.context_expr, *filter(None, [node.optional_vars]))

    def _visit_taking(self, value: ast.AST | None, *targets: ast.AST) -> None:
        if value is not None:
            self.visit(value)
            self._take(value, *targets)

    def generic_visit(self, node: ast.AST) -> None:
        for part in getattr(node, "generators", ()):  # before what a comprehension makes of them
            self._visit_taking(part.iter, part.target)
            self.read(part.ifs)
        inner = (n for n in ast.iter_child_nodes(node) if not isinstance(n, ast.comprehension))
        self.read(inner)


def walk_of(house: House, verb: str, until: str | None) -> list[str]:
    r"""Returns the stays of the arguments of a verb."""
    walk = Walk(house, until)
    module = f"commands.{verb}"
    run = walk.named[module, "run"]
    assert isinstance(run, Function)
    try:
        walk.follow(module, run, ["arguments"])
    except FitReachedError:
        return walk.stays
    if until is not None:
        raise ValueError(f"'{until}' is not reached from 'tactile {verb}'")
    return walk.stays


def main() -> None:
    r"""Prints the rooms and returns of each walk."""
    parser = argparse.ArgumentParser(description="Follows the arguments of two commands.")
    parser.add_argument("--root", type=Path, default=PACKAGE, help="folder of the package")
    parser.add_argument("--stays", action="store_true", help="print the stays, in order")
    given = parser.parse_args()
    house = House(given.root.resolve())
    print("| walk | rooms | returns |\n|---|---:|---:|")
    for verb in VERBS:
        for until, name in ((FIT, "up to the runs"), (None, "to the end")):
            stays = walk_of(house, verb, until)
            rooms = len(set(stays))
            print(f"| `tactile {verb}`, {name} | {rooms} | {len(stays) - rooms} |")
            if given.stays:
                print("\n".join(f"    {number:3} {stay}" for number, stay in enumerate(stays, 1)))


if __name__ == "__main__":
    main()
