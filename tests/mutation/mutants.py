"""Small changes to the source that a test should notice: a comparison, an operator, a constant or a
condition at a time."""

import ast
import random
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_COMPARE: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
_ARITHMETIC: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "*",
    ast.Mod: "*",
    ast.Pow: "*",
    ast.BitOr: "&",
    ast.BitAnd: "|",
}
# Calls whose arguments are words for a reader.
_WORDS = ("warn", "warning", "info", "debug", "write", "print")


class Mutant(NamedTuple):
    """One change: these characters of a file, from ``start`` to ``stop``, become others."""

    file: str
    line: int
    kind: str
    start: int
    stop: int
    before: str
    after: str

    @property
    def code(self) -> str:
        """What tells it from others."""
        words = " ".join(f"{self.before} -> {self.after}".split())
        return f"{self.file}:{self.line}:{self.start}: {words}"

    def source(self, text: str) -> str:
        """The mutated source of a file."""
        data = text.encode()
        return (data[: self.start] + self.after.encode() + data[self.stop :]).decode()


def mutants(root: Path, file: str) -> list[Mutant]:
    """All mutants of a file, in its order.

    Left out are docstrings and other texts, the messages of errors and warnings, annotations,
    what is only for type checkers, ``__all__``, and what cannot be noticed as long as the program
    is right: assertions, and the ``strict`` of ``zip``.
    """
    text = (root / file).read_text(encoding="utf-8")
    finder = _Finder(file, text)
    finder.visit(ast.parse(text))
    return sorted(set(finder.found), key=lambda mutant: (mutant.start, mutant.after))


class _Finder(ast.NodeVisitor):
    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self.data = text.encode()
        self.lines = [0]
        for line in self.data.splitlines(keepends=True):
            self.lines.append(self.lines[-1] + len(line))
        self.found: list[Mutant] = []

    def _span(self, node: ast.AST) -> tuple[int, int]:
        start = self.lines[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        stop = self.lines[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        return start, stop

    def _add(self, kind: str, start: int, stop: int, after: str, line: int) -> None:
        before = self.data[start:stop].decode()
        self.found.append(Mutant(self.file, line, kind, start, stop, before, after))

    def _between(self, left: ast.AST, right: ast.AST, kind: str, after: str) -> None:
        """Changes the operator between two operands, with whatever parentheses are around it."""
        start, stop = self._span(left)[1], self._span(right)[0]
        gap = self.data[start:stop]
        word = gap.replace(b"(", b" ").replace(b")", b" ").strip()
        if b"#" in word or not word:
            return
        place = gap.index(word)
        line = right.lineno  # type: ignore[attr-defined]
        self._add(kind, start + place, start + place + len(word), after, line)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for left, right, operator in zip(operands, operands[1:], node.ops, strict=False):
            self._between(left, right, "comparison", _COMPARE[type(operator)])
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        after = _ARITHMETIC.get(type(node.op))
        if after is not None and not any(map(_is_text, (node.left, node.right))):
            self._between(node.left, node.right, "arithmetic", after)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        after = "or" if isinstance(node.op, ast.And) else "and"
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._between(left, right, "condition", after)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        start = self._span(node)[0]
        if isinstance(node.op, ast.Not):
            self._add("condition", start, start + len("not"), "", node.lineno)
        elif isinstance(node.op, ast.USub):
            self._add("arithmetic", start, start + 1, "+", node.lineno)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value, (start, stop) = node.value, self._span(node)
        if isinstance(value, bool):
            self._add("constant", start, stop, str(not value), node.lineno)
        elif isinstance(value, int | float):
            self._add("constant", start, stop, repr(value + 1), node.lineno)

    def _condition(self, test: ast.expr) -> None:
        if _name(test) == "TYPE_CHECKING":
            return
        if isinstance(test, ast.Compare | ast.UnaryOp) and len(getattr(test, "ops", [1])) == 1:
            return  # its own operator is changed
        start, stop = self._span(test)
        text = self.data[start:stop].decode()
        self._add("condition", start, stop, f"not ({text})", test.lineno)

    def visit_If(self, node: ast.If) -> None:
        if _name(node.test) != "TYPE_CHECKING":
            self._condition(node.test)
            self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        self._condition(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._condition(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._condition(test)
        self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        pass

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    def visit_Call(self, node: ast.Call) -> None:
        if _name(node.func) in _WORDS:
            return
        for part in [node.func, *node.args]:
            self.visit(part)
        for keyword in node.keywords:
            if keyword.arg != "strict":
                self.visit(keyword.value)

    def visit_Assert(self, node: ast.Assert) -> None:
        pass

    def visit_arguments(self, node: ast.arguments) -> None:
        for default in [*node.defaults, *node.kw_defaults]:
            if default is not None:
                self.visit(default)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        names = {_name(target) for target in node.targets}
        if isinstance(node.value, ast.Subscript | ast.BinOp) and _is_alias(names):
            return
        self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self.visit(node.args)
        for part in [*node.decorator_list, *node.body]:
            self.visit(part)


def _is_alias(names: set[str]) -> bool:
    """Whether names are those of types: ``Level = Literal[...] | None``."""
    return all(name.lstrip("_")[:1].isupper() and not name.isupper() for name in names)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _name(node: ast.AST) -> str:
    return getattr(node, "id", getattr(node, "attr", ""))


def sampled(root: Path, package: str, folders: Sequence[str], size: int, seed: int) -> list[Mutant]:
    """A random sample of the mutants of folders: of each folder as large a part."""
    found = {
        folder: [
            mutant
            for path in sorted((root / package / folder).rglob("*.py"))
            for mutant in mutants(root, path.relative_to(root).as_posix())
        ]
        for folder in folders
    }
    number = sum(map(len, found.values()))
    sample = []
    for folder, own in found.items():
        # A draw for each folder: what changes in one does not change the sample of another.
        draw = random.Random(f"{seed} {folder}")
        sample += draw.sample(own, round(size * len(own) / number))
    return sample
