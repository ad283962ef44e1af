r"""Checks and storage of the outputs of tutorial cells."""

import ast
import base64
import io
import re
import tempfile
from pathlib import Path

from form import ROOT, first_line, is_figure
from matplotlib.image import imread
from nbformat import NotebookNode
from PIL import Image

_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
_FOLDERS = (
    f"{ROOT}/",
    f"{Path.home()}/",
    f"{tempfile.gettempdir()}/",
    "/home/",
    "/tmp/",
    "/Users/",
)
_MACHINE_PATH = re.compile(rf"(?<!\w)({'|'.join(map(re.escape, _FOLDERS))})")
_SCOPES = (ast.FunctionDef, ast.ClassDef, ast.Lambda)


def without_escapes(text: str) -> str:
    r"""Returns a text without the colours of a terminal."""
    return _ESCAPES.sub("", text)


def output_problems(cell: NotebookNode) -> list[str]:
    r"""Returns the problems of the outputs of a cell: stderr, a warning, a path or an address of
    this machine, no picture in a figure cell, or no output although the code prints. Markdown cells
    and cells that were not run have no problems.
    """
    if cell.cell_type != "code" or cell.execution_count is None:
        return []
    name = f"the cell '{first_line(cell)}'"
    problems = []
    for output in cell.outputs:
        text = without_escapes(_text(output)).strip()
        if output.get("name") == "stderr":
            problems.append(f"{name} writes to stderr: {text}")
        elif re.search("warning", text, re.IGNORECASE):
            problems.append(f"{name} prints a warning: {text}")
        if _MACHINE_PATH.search(text):
            problems.append(f"{name} prints a path of this machine: {text}")
        if re.search(r" at 0x[0-9a-f]+>", text):
            problems.append(f"{name} shows an object by its address: {text}")
    if is_figure(cell) and not shows_picture(cell):
        problems.append(f"the figure cell '{first_line(cell)}' shows no picture")
    elif prints(cell.source) and not cell.outputs:
        problems.append(f"{name} prints and has no output")
    return problems


def shows_picture(cell: NotebookNode) -> bool:
    r"""Returns whether a cell has a picture that is not empty."""
    pictures = [output.get("data", {}).get("image/png") for output in cell.get("outputs", [])]
    return any(_is_drawn(picture) for picture in pictures if picture)


def prints(code: str) -> bool:
    r"""Returns whether the code of a cell calls :func:`print`, outside functions and classes."""
    nodes: list[ast.AST] = list(ast.parse(code).body)
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print":
            return True
        if not isinstance(node, _SCOPES):
            nodes += ast.iter_child_nodes(node)
    return False


def to_stored(output: NotebookNode) -> NotebookNode:
    r"""Returns an output in the form in which it is committed. Pictures have 256 colours, which take
    a third of the bytes, and no text alternative.
    """
    picture = output.get("data", {}).get("image/png")
    if not picture:
        return output
    image = Image.open(io.BytesIO(base64.b64decode(picture)))
    if image.mode == "P":  # stored before
        return output
    file = io.BytesIO()
    # The method that keeps the rare colours of gradients: no channel differs by more than 12 of 255.
    colours = image.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE)
    colours.save(file, "PNG", optimize=True)
    text = base64.b64encode(file.getvalue()).decode()
    return NotebookNode({**output, "data": NotebookNode({"image/png": text})})


def _text(output: NotebookNode) -> str:
    return output.get("text") or output.get("data", {}).get("text/plain", "")


def _is_drawn(picture: str) -> bool:
    # A figure that nothing was drawn into has one colour.
    pixels = imread(io.BytesIO(base64.b64decode(picture)))
    return bool((pixels != pixels[:1, :1]).any())
