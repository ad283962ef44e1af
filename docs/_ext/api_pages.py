"""Writes the pages of the reference: one for each public package, one for each public name."""

import ast
import inspect
import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from pprint import pformat
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from docutils import nodes
from repository_links import write_if_changed
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.inspect import signature as sphinx_signature
from sphinx.util.inspect import stringify_signature

PACKAGE = "torch_geometric_tactile"
# In the order of the reference. Public names are those of `__all__`.
MODULES = (
    "sensors",
    "data",
    "data.splits",
    "io",
    "datasets",
    "sim",
    "transforms",
    "loader",
    "nn.conv",
    "nn.pool",
    "nn.models",
    "baselines",
    "training",
    "analysis",
    "visualization",
    "predictor",
    "live",
    "experiments",
    "papers",
    "reports",
    "testing",
)
# Modules with names in common.
_SHARED = ("data", "data.splits")


class PublicName(NamedTuple):
    """A public name and what it is."""

    module: str
    name: str
    kind: str

    @property
    def full(self) -> str:
        """Its full name, which is that of its page."""
        return f"{self.module}.{self.name}"


def public_names(module: str) -> list[PublicName]:
    """Returns the public names of a module of the package, sorted."""
    full = f"{PACKAGE}.{module}"
    home = import_module(full)
    names = getattr(home, "__all__", None) or _functions_of(home)
    names = [name for name in names if _home(getattr(home, name), module) == module]
    found = [PublicName(full, name, _kind(name, getattr(home, name))) for name in names]
    return sorted((one for one in found if one.kind != "module"), key=lambda one: one.name.lower())


def _home(value: Any, module: str) -> str:
    # Where a name of two public modules is described: where it is defined.
    if module not in _SHARED:
        return module
    defined = getattr(value, "__module__", "").removeprefix(f"{PACKAGE}.")
    if defined in _SHARED:
        return defined
    is_above = any(value is other for other in vars(import_module(f"{PACKAGE}.data")).values())
    return "data" if is_above else module


def all_public_names() -> list[PublicName]:
    """Returns all public names of the package."""
    return [one for module in MODULES for one in public_names(module)]


def _functions_of(module: ModuleType) -> list[str]:
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and inspect.isroutine(value) | inspect.isclass(value)
        and value.__module__ == module.__name__
    ]


def _kind(name: str, value: Any) -> str:
    if inspect.ismodule(value):
        return "module"
    if inspect.isclass(value) and value.__name__ != name:
        return "alias"
    if inspect.isclass(value):
        return "exception" if issubclass(value, BaseException) else "class"
    return "function" if inspect.isroutine(value) else "data"


def get_object(full: str) -> Any:
    """Returns what the full name of a public name stands for."""
    module, _, name = full.rpartition(".")
    return getattr(import_module(module), name)  # a function may have the name of its module


@cache
def _page_of_class() -> dict[type, str]:
    return {
        get_object(one.full): one.full
        for one in all_public_names()
        if one.kind in ("class", "exception")
    }


def own_members(full: str) -> list[str]:
    """Returns the members that the page of a class shows: its own and those of private bases.

    Args:
        full (str): The name of the class.
    """
    own: list[str] = []
    for base in _bases(get_object(full), public=False):
        own += [name for name in _documented(base) if name not in own]
    return own


def inherited_members(full: str) -> list[str]:
    """Returns members of public bases, as names with the name of the base.

    Args:
        full (str): The name of the class.
    """
    seen = set(own_members(full))
    found = []
    for base in _bases(get_object(full), public=True):
        for name in _documented(base):
            if name not in seen:
                seen.add(name)
                found.append(f"{_page_of_class()[base]}.{name}")
    return found


def _bases(owner: type, public: bool) -> list[type]:
    ours = [base for base in owner.__mro__ if base.__module__.startswith(PACKAGE)]
    return [base for base in ours if (base is not owner and base in _page_of_class()) == public]


def _documented(owner: type) -> list[str]:
    return [name for name, value in vars(owner).items() if _is_documented(name, value)]


def _is_documented(name: str, value: Any) -> bool:
    if name.startswith("_") and name not in ("__call__", "__iter__", "__getitem__", "__len__"):
        return False
    if isinstance(value, (staticmethod, classmethod)):
        value = value.__func__
    if not isinstance(value, (FunctionType, property)) and not hasattr(value, "attrname"):
        return False
    return bool(getattr(value, "__doc__", None))


def definition(full: str) -> tuple[Path, int, str]:
    """Returns where a constant is defined: its file, its line and the comment above it.

    Args:
        full (str): The name of the constant.
    """
    module, _, name = full.rpartition(".")
    home = import_module(module)
    folder = Path(home.__file__ or "").parent
    for path in [Path(home.__file__ or ""), *sorted(folder.rglob("*.py"))]:
        text = path.read_text("utf-8")
        for statement in ast.parse(text).body:
            targets = getattr(statement, "targets", [getattr(statement, "target", None)])
            if any(isinstance(target, ast.Name) and target.id == name for target in targets):
                lines = text.splitlines()[: statement.lineno - 1]
                return path, statement.lineno, _comment(lines)
    raise LookupError(full)


def _comment(lines: list[str]) -> str:
    found: list[str] = []
    while lines and lines[-1].startswith("#:"):
        found.insert(0, lines.pop().removeprefix("#:").strip())
    return " ".join(found)


def _shown_value(full: str) -> str:
    value = get_object(full)
    value = dict(value) if isinstance(value, Mapping) else value
    text = pformat(value, width=80, compact=True, sort_dicts=False)
    return re.sub(r"<(?:class|function) '?(?:[\w.]+\.)?(\w+)[^>]*>", r"\1", text)


def _signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str, returned: str
) -> tuple[str, str] | None:
    # Models that can be on a hub have a `__new__` of any arguments; those of `__init__` count.
    if what != "class" or not re.fullmatch(r"\(\*args: \S+, \*\*kwargs: \S+\)", signature or ""):
        return None
    own = sphinx_signature(obj.__init__, bound_method=True)
    return stringify_signature(own, show_return_annotation=False, unqualified_typehints=True), ""


def _doc_of_data(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    if what == "data":
        lines[:] = [definition(name)[2], ""]


# -- The pages ---------------------------------------------------------------------------------
_HEADINGS = (("class", "Classes"), ("function", "Functions"), ("data", "Constants"))


def _package_page(module: str) -> str:
    full = f"{PACKAGE}.{module}"
    intro = inspect.getdoc(import_module(full)) or ""
    parts = [f"{full}\n{'=' * len(full)}\n", f".. currentmodule:: {full}\n", f"{intro}\n"]
    names = public_names(module)
    for kind, heading in (*_HEADINGS, ("exception", "Exceptions")):
        entries = [one.name for one in names if one.kind == kind]
        if entries:
            rows = "".join(f"   {name}\n" for name in entries)
            parts.append(f"{heading}\n{'-' * len(heading)}\n")
            parts.append(f".. autosummary::\n   :toctree: api\n   :nosignatures:\n\n{rows}")
    aliases = [one for one in names if one.kind == "alias"]
    if aliases:
        entries = "".join(f"   api/{one.full}\n" for one in aliases)
        parts.append(f"Other names\n-----------\n\n.. toctree::\n   :maxdepth: 1\n\n{entries}")
    return "\n".join(parts)


def _alias_page(one: PublicName, repository: str) -> str:
    return (
        f"{one.name}\n{'=' * len(one.name)}\n\n.. currentmodule:: {one.module}\n\n"
        f".. py:class:: {one.name}\n\n   {definition(one.full)[2]}\n\n"
        f"   `[source] <{_definition_link(one.full, repository)}>`__\n"
    )


def _keep_module(app: Sphinx, module: str, name: str) -> str | None:
    # The source of an alias of a built-in type is ours; no other module of it has a page.
    value = getattr(import_module(module), name, None)
    return module if inspect.isclass(value) and value.__module__ == "builtins" else None


def _write_pages(app: Sphinx, config: Any) -> None:
    folder = Path(app.srcdir) / "generated"
    for module in MODULES:
        write_if_changed(folder / f"{module}.rst", _package_page(module))
    for one in all_public_names():
        if one.kind == "alias":
            text = _alias_page(one, config.repository_url)
            write_if_changed(folder / "api" / f"{one.full}.rst", text)
    known = {one.full for one in all_public_names()}
    built = Path(app.outdir) / "generated" / "api"
    for path in [*(folder / "api").glob("*.rst"), *built.glob("*.html")]:
        if path.stem not in known:  # of an earlier build
            path.unlink()
    config.autosummary_generate = [str(folder / f"{module}.rst") for module in MODULES]
    names = all_public_names()
    classes = [one.full for one in names if one.kind in ("class", "exception")]
    constants = [one.full for one in names if one.kind == "data"]
    config.autosummary_context = {
        "own_members": {full: own_members(full) for full in classes},
        "inherited_members_of": {full: inherited_members(full) for full in classes},
        "definition": {full: _definition_link(full, config.repository_url) for full in constants},
        "shown_value": {full: _shown_value(full) for full in constants},
    }


def _definition_link(full: str, repository: str) -> str:
    path, line, _ = definition(full)
    inside = path.relative_to(Path(import_module(PACKAGE).__file__ or "").parents[1])
    return f"{repository}/blob/main/{inside.as_posix()}#L{line}"


# -- Links to the pages ------------------------------------------------------------------------
@cache
def _short_names() -> dict[str, str]:
    """Pages by every dotted name that leads to one page only."""
    found: dict[str, set[str]] = {}
    for one in all_public_names():
        parts = one.full.split(".")
        names = {".".join(parts[cut:]) for cut in range(len(parts))}
        if parts[1] == "nn":
            names |= {f"nn.{one.name}", f"{PACKAGE}.nn.{one.name}"}
        if one.full == f"{PACKAGE}.predictor.Predictor":
            names |= {f"{PACKAGE}.Predictor"}
        for name in names:
            found.setdefault(name, set()).add(one.full)
    return {name: pages.pop() for name, pages in found.items() if len(pages) == 1}


def _resolve(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, content: nodes.Element
) -> nodes.Element | None:
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    page = _short_names().get(target)
    suffix = ""
    if page is None and "." in target:
        owner, _, member = target.rpartition(".")
        page, suffix = _short_names().get(owner), f".{member}"
    if page is None:
        return None
    return _reference(app, env, page + suffix, node["refdoc"], content)


def _reference(
    app: Sphinx, env: BuildEnvironment, full: str, page: str, content: nodes.Node
) -> nodes.Element | None:
    entry = env.domains.python_domain.objects.get(full)
    if entry is None:
        return None
    address = app.builder.get_relative_uri(page, entry.docname) + f"#{entry.node_id}"
    return nodes.reference("", "", content, internal=True, refuri=address, reftitle=full)


def _link_code(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Links code such as `transforms.Tare` in the text of Markdown pages to its page."""
    if page.startswith("generated/") and page not in ("generated/changelog",):
        return
    for node in list(doctree.findall(nodes.literal)):
        name = node.astext().removesuffix("()")
        known = _short_names().get(name)
        is_name = "." in name or re.fullmatch(r"[A-Z]+[a-z]\w*", name)
        if known is None or not is_name or isinstance(node.parent, (nodes.reference, nodes.title)):
            continue
        link = _reference(app, app.env, known, page, node.deepcopy())
        if link is not None:
            node.replace_self(link)


def setup(app: Sphinx) -> dict[str, Any]:
    """Writes the pages before Sphinx looks for them, and resolves short names."""
    app.connect("config-inited", _write_pages, priority=100)
    app.connect("viewcode-follow-imported", _keep_module)
    app.connect("autodoc-process-docstring", _doc_of_data)
    app.connect("autodoc-process-signature", _signature)
    app.connect("missing-reference", _resolve, priority=100)
    app.connect("doctree-resolved", _link_code)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
