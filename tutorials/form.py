r"""Scripts and notebooks of the tutorials, and checks of their form."""

import ast
import re
from pathlib import Path

import jupytext
import nbformat
from nbformat import NotebookNode

FOLDER = Path(__file__).parent
ROOT = FOLDER.parent
NAMES = (
    "01_real_grasps",
    "02_your_own_glove",
    "03_live_robot",
    "04_new_day",
    "05_hand_pose",
    "06_simulated_touch",
    "07_paper_table",
    "08_grasps_in_time",
    "09_letters",
    "10_what_it_learnt",
    "11_touch_policy",
)
CLOSING = ("What to take from this", "Next")
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)#\s]+)")
_KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def script_paths(names: list[str] | None = None, folder: Path = FOLDER) -> list[Path]:
    r"""Returns the scripts of the tutorials with these names, or all of them.

    Args:
        names (list of str, optional): Names or their beginnings, such as :obj:`"04"`; paths and
            the ending :obj:`.py` are accepted.
        folder (Path): The folder of the scripts.

    Raises:
        ValueError: If a name matches no script, or more than one.
    """
    paths = sorted(folder.glob("[0-9][0-9]_*.py"))
    if not names:
        return paths
    chosen = []
    for name in names:
        found = [path for path in paths if path.stem.startswith(Path(name).stem)]
        if len(found) != 1:
            known = ", ".join(path.stem for path in paths)
            raise ValueError(f"'{name}' must be the name of one tutorial of: {known}")
        chosen += found
    return chosen


def read_script(path: Path) -> NotebookNode:
    r"""Returns the notebook of a percent script, with the same cell ids each time."""
    notebook = jupytext.reads(path.read_text(encoding="utf-8"), fmt="py:percent")
    notebook.metadata = nbformat.from_dict({"kernelspec": _KERNEL})
    for number, cell in enumerate(notebook.cells, start=1):
        cell["id"] = f"cell-{number:02d}"
    return notebook


def is_figure(cell: NotebookNode) -> bool:
    r"""Returns whether a cell is tagged as a figure."""
    return "figure" in cell.metadata.get("tags", [])


def first_line(cell: NotebookNode) -> str:
    r"""Returns the first line of a cell, to name it in a message."""
    return cell.source.strip().partition("\n")[0]


def relative_links(notebook: NotebookNode) -> list[str]:
    r"""Returns the links of the Markdown cells that lead to files."""
    return [link for cell in _markdown(notebook) for link in _LINK.findall(cell.source)]


def replace_links(notebook: NotebookNode, pages: str, tutorials: str) -> None:
    r"""Replaces the beginnings of links to files, in place. In a script, links are relative to
    :obj:`tutorials/`, such as :obj:`../docs/scaling.md` and :obj:`04_new_day.py`. The latter
    becomes :obj:`04_new_day.ipynb`.

    Args:
        notebook (NotebookNode): The notebook.
        pages (str): The text that replaces :obj:`../docs/`.
        tutorials (str): The text before the name of another tutorial.
    """

    def replaced(match: re.Match[str]) -> str:
        link = match[1]
        if link.startswith("../docs/"):
            return pages + link.removeprefix("../docs/")
        if Path(link).stem in NAMES:
            return f"{tutorials}{Path(link).stem}.ipynb"
        return link

    for cell in _markdown(notebook):
        cell.source = _LINK.sub(replaced, cell.source)


def form_problems(path: Path) -> list[str]:
    r"""Returns the problems of a script: no title with a question, fewer than two figure cells, no
    assertion about a result, missing closing sections, or broken links to files.
    """
    notebook = read_script(path)
    markdown = _markdown(notebook)
    problems = []
    first = notebook.cells[0] if notebook.cells else None
    if first is None or first.cell_type != "markdown" or not first.source.startswith("# "):
        problems.append("the first cell must be Markdown that begins with '# Title: the question?'")
    elif "?" not in first.source:
        problems.append("the first cell must ask a question")
    figures = sum(map(is_figure, notebook.cells))
    if figures < 2:
        problems.append(
            f"two cells must be tagged as figures, '# %% tags=[\"figure\"]' ({figures})"
        )
    if not any(map(_is_assertion, _statements(notebook))):
        problems.append("a code cell must hold an 'assert' about a result")
    headings = [line.lstrip("# ") for cell in markdown for line in _headings(cell)]
    problems += [f"the heading '{name}' is missing" for name in CLOSING if name not in headings]
    for link in relative_links(notebook):
        if Path(link).stem not in NAMES and not (FOLDER / link).exists():
            problems.append(
                f"the link '{link}' leads nowhere: links are relative to tutorials/, such as "
                "'../docs/scaling.md' or '04_new_day.py'"
            )
    return problems


def _markdown(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "markdown"]


def _headings(cell: NotebookNode) -> list[str]:
    return [line for line in cell.source.splitlines() if line.startswith("#")]


def _statements(notebook: NotebookNode) -> list[ast.AST]:
    codes = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return [node for code in codes for node in ast.walk(ast.parse(code))]


def _is_assertion(node: ast.AST) -> bool:
    # `assert True` says nothing about a result.
    return isinstance(node, ast.Assert) and any(
        isinstance(n, ast.Name) for n in ast.walk(node.test)
    )
