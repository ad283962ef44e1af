"""Gives pages with wide tables the full width, without the outline at their right."""

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

MAX_COLUMNS = 6  # of a table that fits beside the outline
_NO_OUTLINE = "html_theme.sidebar_secondary.remove"


def _mark_wide_tables(app: Sphinx, doctree: nodes.document) -> None:
    wide = [group for group in doctree.findall(nodes.tgroup) if group["cols"] > MAX_COLUMNS]
    for group in wide:
        group.parent["classes"].append("wide-table")
    if wide:
        app.env.metadata[app.env.docname][_NO_OUTLINE] = "true"


def setup(app: Sphinx) -> dict[str, Any]:
    """Marks the tables of each page as it is read."""
    app.connect("doctree-read", _mark_wide_tables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
