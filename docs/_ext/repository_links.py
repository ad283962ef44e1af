"""Lets Markdown pages link to files outside `docs` as they do on GitHub.

A link to a file that is a page of the site leads to that page; any other, to the repository.
`CHANGELOG.md` and `CONTRIBUTING.md` are copied into the site.
"""

import os
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

# Files outside `docs` that are pages of the site.
PAGES = {
    "CHANGELOG.md": "generated/changelog.md",
    "CONTRIBUTING.md": "generated/contributing.md",
    "README.md": "index.md",
    "tutorials": "tutorials_index.md",
}
_LINK = re.compile(r"(\]\()([^)\s]+)(\))")
_FENCE = re.compile(r"\s*(`{3,}|~{3,})")


def rewrite_links(text: str, folder: str, page_folder: str, repository: str, root: Path) -> str:
    """Returns a Markdown page whose links outside `docs` lead to the site or to the repository.

    Args:
        text (str): The page.
        folder (str): The folder of the file in the repository, such as `docs/results`.
        page_folder (str): The folder of the page in `docs`, such as `results`.
        repository (str): The address of the repository.
        root (Path): The checkout.
    """

    def target(link: re.Match[str]) -> str:
        path, hash_, anchor = link[2].partition("#")
        path = path.removeprefix(f"{repository}/blob/main/")
        if not path or re.match(r"[a-z]+:|/", path):
            return link[0]
        is_full = link[2].startswith(repository)
        full = path if is_full else os.path.normpath(os.path.join(folder, path))
        if full.startswith("docs" + os.sep) and folder.startswith("docs") and not is_full:
            return link[0]
        page = _page(full, root)
        if page is not None:
            return f"{link[1]}{os.path.relpath(page, page_folder or '.')}{hash_}{anchor}{link[3]}"
        kind = "tree" if (root / full).is_dir() else "blob"
        return f"{link[1]}{repository}/{kind}/main/{full}{hash_}{anchor}{link[3]}"

    return "".join(
        part if is_code else _LINK.sub(target, part) for part, is_code in _split_code(text)
    )


def _page(full: str, root: Path) -> str | None:
    if full.startswith("docs" + os.sep):
        return os.path.relpath(full, "docs")
    if full.startswith("tutorials" + os.sep):
        notebook = Path("tutorials") / f"{Path(full).stem}.ipynb"
        return str(notebook) if (root / "docs" / notebook).exists() else None
    return PAGES.get(full)


def _split_code(text: str) -> list[tuple[str, bool]]:
    # The lines, and whether each is part of a fenced block.
    parts: list[tuple[str, bool]] = []
    fence = ""
    for line in text.splitlines(keepends=True):
        found = _FENCE.match(line)
        parts.append((line, bool(fence or found)))
        if not fence:
            fence = found[1] if found else ""
        elif found and found[1].startswith(fence) and not line.strip(" `~\n"):
            fence = ""
    return parts


def _read(app: Sphinx, name: str, source: list[str]) -> None:
    path = Path(str(app.env.doc2path(name)))
    if path.suffix != ".md" or name.startswith("generated/"):
        return
    page_folder = os.path.dirname(name)
    folder = os.path.normpath(os.path.join("docs", page_folder))
    root = Path(app.srcdir).parent
    source[0] = rewrite_links(source[0], folder, page_folder, app.config.repository_url, root)


def _copy_pages(app: Sphinx) -> None:
    root = Path(app.srcdir).parent
    for source, page in PAGES.items():
        if not page.startswith("generated/"):
            continue
        text = (root / source).read_text("utf-8")
        text = rewrite_links(text, "", "generated", app.config.repository_url, root)
        write_if_changed(Path(app.srcdir) / page, text)


def write_if_changed(path: Path, text: str) -> None:
    """Writes a generated page, unless it is there already, so that it is not built again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Rewrites the links of every Markdown page as it is read."""
    app.add_config_value("repository_url", "", "env")
    app.connect("config-inited", lambda app, config: _copy_pages(app))
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
