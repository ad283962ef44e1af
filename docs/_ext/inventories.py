"""Writes small inventories of other projects, so that links to their pages need no network.

`docs/inventories/NAME.txt` has a line for each name that our docstrings mention: the name, what it
is, and the page (`$` stands for the name). Addresses were written by hand from the usual form of
those sites; `make linkcheck` follows them.
"""

import zlib
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

_HEAD = """\
# Sphinx inventory version 2
# Project: {project}
# Version:
# The remainder of this file is compressed using zlib.
"""


def inventory(project: str, text: str) -> bytes:
    """Returns the inventory of a project.

    Args:
        project (str): Its name.
        text (str): The names, one a line, such as `torch.nn.LSTM class generated/$.html#$`.

    Raises:
        ValueError: If a line has not three words.
    """
    rows = []
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        words = line.split()
        if len(words) != 3:
            raise ValueError(f"a line of '{project}' must be a name, a kind, a page (got '{line}')")
        name, kind, page = words
        rows.append(f"{name} py:{kind} 1 {page.replace('$', name)} -\n")
    return _HEAD.format(project=project).encode() + zlib.compress("".join(rows).encode())


def _write(app: Sphinx, config: Any) -> None:
    if config.online_inventories:
        return
    for source in sorted((Path(app.srcdir) / "inventories").glob("*.txt")):
        target = Path(app.srcdir) / "generated" / f"{source.stem}.inv"
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(inventory(source.stem, source.read_text("utf-8")))


def setup(app: Sphinx) -> dict[str, Any]:
    """Writes the inventories before Sphinx reads them."""
    app.add_config_value("online_inventories", False, "")
    app.connect("config-inited", _write, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
