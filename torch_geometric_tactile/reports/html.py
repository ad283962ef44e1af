r"""Reports as self-contained HTML pages."""

import base64
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.visualization._style import DPI, INSTALL

_PNG = b"\x89PNG\r\n\x1a\n"
_CSS_PIXELS_PER_INCH = 96  # by definition; pictures are shown at their physical size


class ReportTable(NamedTuple):
    r"""A table of a report: a title, a caption, column names and cells.

    Args:
        title (str): Title above the table.
        caption (str): Explanation of the numbers; may be empty.
        header (list of str): Names of the columns.
        rows (list of list of str): The cells. A row whose first cell begins with :obj:`*` is
            shown in bold, without the asterisk.

    Examples:
        >>> table = ReportTable("Accuracy", "in %", ["model", "accuracy"], [["GCN", "84.0"]])
        >>> table.rows[0]
        ['GCN', '84.0']
    """

    title: str
    caption: str
    header: list[str]
    rows: list[list[str]]


class ReportPicture(NamedTuple):
    r"""A picture of a report: the path of a PNG file, a title and a caption.

    Args:
        path (str or PathLike): The PNG file; the report contains a copy.
        title (str): Title above the picture.
        caption (str): Explanation of the picture; may be empty.

    Examples:
        >>> picture = ReportPicture("confusion.png", "Confusion", "Rows are true classes.")
        >>> picture.title
        'Confusion'
    """

    path: PathLike
    title: str
    caption: str


def write_report(
    path: PathLike,
    *,
    title: str,
    notice: str,
    facts: Sequence[tuple[str, str]],
    tables: Sequence[ReportTable],
    pictures: Sequence[ReportPicture],
    verdict: str = "",
    is_warning: bool = True,
) -> None:
    r"""Writes a report as one HTML file, atomically. The file loads no other files, contains no
    scripts, and is readable on a phone, in dark mode and in print.

    Args:
        path (str or PathLike): The file.
        title (str): Title of the report.
        notice (str): Description of the data, and whether it is measured or generated.
        facts (sequence of tuple of str): Names and values, such as split, seed and versions.
        tables (sequence of ReportTable): The tables.
        pictures (sequence of ReportPicture): The pictures, shown below the tables.
        verdict (str): Conclusion, shown below the title; may be empty.
        is_warning (bool): If :obj:`True`, :obj:`notice` is a warning and is shown first, for
            example that the data is generated. Otherwise it follows the verdict.

    Raises:
        ImportError: If jinja2 is missing.
        FileNotFoundError: If a picture does not exist.
        ValueError: If :obj:`notice` is empty, if a row and its header differ in length, or if a
            picture is not a PNG file.

    Examples:
        >>> from tempfile import TemporaryDirectory
        >>> table = ReportTable("Accuracy", "in %", ["model", "accuracy"], [["GCN", "84.0"]])
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder) / "report.html"
        ...     texts = {"title": "Grasps", "notice": "Generated data."}
        ...     write_report(path, **texts, facts=[("seed", "0")], tables=[table], pictures=[])
        ...     "84.0" in path.read_text(encoding="utf-8")
        True
    """
    need(notice.strip(), "'notice' must describe the data (got an empty text)")
    try:
        import jinja2
    except ImportError as error:
        raise ImportError(f"reports need jinja2: {INSTALL}") from error
    environment = jinja2.Environment(
        autoescape=True,
        finalize=lambda value: printable(value) if isinstance(value, str) else value,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = files(__package__).joinpath("report.html").read_text(encoding="utf-8")
    page = environment.from_string(template).render(
        title=title,
        notice=notice,
        verdict=verdict,
        is_warning=is_warning,
        facts=list(facts),
        tables=[_table_context(table) for table in tables],
        pictures=[_picture_context(picture) for picture in pictures],
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _table_context(table: ReportTable) -> dict[str, Any]:
    for row in table.rows:
        if len(row) != len(table.header) or not row:
            raise ValueError(
                f"'rows' of table '{table.title}' must have {len(table.header)} cells, like its "
                f"header (got {len(row)})"
            )
    is_numeric = [
        bool(table.rows) and not any(char.isalpha() for row in table.rows for char in row[i])
        for i in range(len(table.header))
    ]
    rows = [
        {"bold": row[0].startswith("*"), "cells": [row[0].removeprefix("*").lstrip(), *row[1:]]}
        for row in table.rows
    ]
    return {**table._asdict(), "rows": rows, "numeric": is_numeric}


def _picture_context(picture: ReportPicture) -> dict[str, Any]:
    path = Path(picture.path)
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist: write the picture with 'save_figure'")
    content = path.read_bytes()
    if not content.startswith(_PNG) or len(content) < 24:
        raise ValueError(f"'path' of a picture must be a PNG file (got '{path}')")
    # The header of a PNG file holds width and height as big-endian integers.
    width, height = (int.from_bytes(content[i : i + 4], "big") for i in (16, 20))
    return {
        "title": picture.title,
        "caption": picture.caption,
        "data": base64.b64encode(content).decode("ascii"),
        "width": round(width * _CSS_PIXELS_PER_INCH / DPI),
        "height": round(height * _CSS_PIXELS_PER_INCH / DPI),
    }
