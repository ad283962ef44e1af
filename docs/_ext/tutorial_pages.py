"""Copies the tutorials into the site, and draws the gallery of them."""

import base64
import json
import re
from pathlib import Path
from typing import Any, NamedTuple

from repository_links import rewrite_links, write_if_changed
from sphinx.application import Sphinx

_BADGE = re.compile(r"\[!\[[^\]]*\]\([^)]*\)\]\([^)]*\)\s*")
_PLACE = "<!-- gallery -->"
_NONE = "The tutorials are not part of this copy of the site.\n"


class Tutorial(NamedTuple):
    """A notebook of the site."""

    name: str
    title: str
    question: str
    picture: str | None
    seconds: int | None


def _cells(notebook: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == kind]


def _text(cell: dict[str, Any]) -> str:
    source = cell["source"]
    return source if isinstance(source, str) else "".join(source)


def thumbnail(notebook: dict[str, Any]) -> bytes | None:
    """Returns the picture of a notebook in the gallery, as PNG: that of the cell tagged
    `thumbnail`, or the first one.
    """
    cells = _cells(notebook, "code")
    cells.sort(key=lambda cell: "thumbnail" not in cell["metadata"].get("tags", []))
    for cell in cells:
        for output in cell["outputs"]:
            picture = output.get("data", {}).get("image/png")
            if picture:
                return base64.b64decode("".join(picture))
    return None


def title_and_summary(notebook: dict[str, Any]) -> tuple[str, str]:
    """Returns the title of a notebook and the first paragraph below it."""
    for cell in _cells(notebook, "markdown"):
        text = _BADGE.sub("", _text(cell)) + "\n"
        found = re.search(r"^# (.+?)\n+(.*?)(?:\n\s*\n|\Z)", text, re.M | re.S)
        if found:
            return found[1].strip(), " ".join(found[2].split())
    raise ValueError("a tutorial must begin with a title '# ...'")


def shorten(text: str, size: int = 150) -> str:
    """Returns the first sentences of a text: one, and more while they fit.

    Args:
        text (str): The text.
        size (int): Number of letters of all but the first.
    """
    sentences = re.split(r"(?<=[.?!])\s+", text)
    taken = sentences[:1]
    for sentence in sentences[1:]:
        if len(" ".join([*taken, sentence])) > size:
            break
        taken.append(sentence)
    return " ".join(taken)


def _links(name: str, repository: str, root: Path) -> str:
    owner = repository.removeprefix("https://github.com/")
    path = f"tutorials/notebooks/{name}.ipynb"
    colab = f"https://colab.research.google.com/github/{owner}/blob/main/{path}"
    binder = f"https://mybinder.org/v2/gh/{owner}/main?labpath={path.replace('/', '%2F')}"
    links = [f"[Open in Colab]({colab})", f"[Open in Binder]({binder})"]
    if (root / path).exists():
        links.append(f"{{download}}`Download the notebook <../../{path}>`")
    return " · ".join([*links, f"[Source]({repository}/blob/main/tutorials/{name}.py)"])


def _is_install(cell: dict[str, Any]) -> bool:
    # The cell that the generator of the notebooks puts first, for Colab.
    return cell.get("id") == "install"


def site_notebook(notebook: dict[str, Any], name: str, repository: str, root: Path) -> str:
    """Returns a notebook as the site shows it: links instead of badges, no install cell.

    Args:
        notebook (dict): The notebook.
        name (str): Its name, without suffix.
        repository (str): The address of the repository.
        root (Path): The checkout.
    """
    cells = [cell for cell in notebook["cells"] if not _is_install(cell)]
    is_first = True
    for cell in cells:
        if cell["cell_type"] != "markdown":
            continue
        text = _BADGE.sub("", _text(cell))
        text = rewrite_links(text, "tutorials", "tutorials", repository, root)
        if is_first and text.lstrip().startswith("# "):
            title, _, rest = text.lstrip().partition("\n")
            text = f"{title}\n\n{_links(name, repository, root)}\n{rest}"
            is_first = False
        cell["source"] = text
    cells = [cell for cell in cells if _text(cell).strip()]
    return json.dumps({**notebook, "cells": cells}, indent=1)


def _copy(app: Sphinx, config: Any) -> None:
    source = Path(app.srcdir)
    pages = source / "tutorials"
    pages.mkdir(exist_ok=True)
    tutorials = []
    notebooks = _notebooks(source, config.tutorial_folder)
    for name, notebook in notebooks.items():
        title, question = title_and_summary(notebook)
        picture = thumbnail(notebook)
        if picture is not None:
            (pages / f"{name}.png").write_bytes(picture)
        picture_name = f"{name}.png" if picture else None
        seconds = notebook["metadata"].get("processor_seconds")
        tutorials.append(Tutorial(name, title, shorten(question), picture_name, seconds))
    for path in pages.glob("*.ipynb"):
        if path.stem not in {one.name for one in tutorials}:
            path.unlink()
    for one in tutorials:
        (pages / f"{one.name}.ipynb").touch()  # so that links between tutorials find them
    for name, notebook in notebooks.items():
        text = site_notebook(notebook, name, config.repository_url, source.parent)
        write_if_changed(pages / f"{name}.ipynb", text)
    app.tactile_gallery = gallery(tutorials)  # type: ignore[attr-defined]


def _notebooks(source: Path, folder: str) -> dict[str, dict[str, Any]]:
    paths = sorted((source / folder).glob("[0-9]*.ipynb")) if folder else []
    return {path.stem: json.loads(path.read_text("utf-8")) for path in paths}


def gallery(tutorials: list[Tutorial]) -> str:
    """Returns cards of the tutorials, as Markdown with their table of contents."""
    if not tutorials:
        return _NONE
    cards = []
    for one in tutorials:
        number = int(one.name.split("_")[0])
        picture = ""
        if one.picture:
            picture = f":img-top: tutorials/{one.picture}\n:img-alt: A figure of the tutorial\n"
        seconds = f"{one.seconds} s of processor time"
        time = f"\n```{{card-footer}}\n{seconds}\n```\n" if one.seconds else ""
        cards.append(
            f":::{{grid-item-card}} {number}. {one.title}\n:link: tutorials/{one.name}\n"
            f":link-type: doc\n{picture}\n{one.question}\n{time}:::\n"
        )
    entries = "".join(f"tutorials/{one.name}\n" for one in tutorials)
    return (
        "::::{grid} 1 2 2 3\n:gutter: 3\n:class-container: gallery\n\n"
        + "\n".join(cards)
        + "::::\n\n```{toctree}\n:hidden:\n\n"
        + entries
        + "```\n"
    )


def _insert(app: Sphinx, name: str, source: list[str]) -> None:
    if name == "tutorials_index":
        source[0] = source[0].replace(_PLACE, app.tactile_gallery)  # type: ignore[attr-defined]


def _outdated(*_: Any) -> list[str]:
    # Whatever was run since the last build: Sphinx compares the page only, not its gallery.
    return ["tutorials_index"]


def setup(app: Sphinx) -> dict[str, Any]:
    """Copies the notebooks before Sphinx looks for them."""
    app.add_config_value("tutorial_folder", "", "env")
    app.connect("config-inited", _copy)
    app.connect("source-read", _insert)
    app.connect("env-get-outdated", _outdated)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
