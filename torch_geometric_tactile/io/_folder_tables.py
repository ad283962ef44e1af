r"""What CSV files beside recordings tell of them: ``annotations.csv``, with the columns
``recording``, ``start``, ``end`` and ``label``, and ``labels.csv``, with ``recording``, ``label``
and further columns for the metadata. A recording is called by the name of its file, with or without
the suffix.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, exclusive_access
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.data import Annotation
from torch_geometric_tactile.data._annotations import checked_annotation
from torch_geometric_tactile.io._csv_table import (
    csv_names,
    csv_rows,
    csv_table,
    placed,
    refuse_index,
    refuse_missing,
    safe_cell,
    text_of_cell,
)

ANNOTATIONS_FILE, LABELS_FILE = TABLES = ("annotations.csv", "labels.csv")
_COLUMNS = ("recording", "start", "end", "label")
_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")


def read_annotations(path: Path) -> dict[str, list[Annotation]]:
    r"""Returns the annotations in an ``annotations.csv``, by the names of their recordings."""
    lines = csv_rows(path)
    names = csv_names(lines)
    place = placed(path, names, dict(enumerate(names)))
    refuse_missing(path, place, _COLUMNS)
    recording, start, end, label = (place[name] for name in _COLUMNS)
    table, cells = csv_table(
        path,
        lines,
        names,
        [start, end],
        texts=[recording, label],
        required=[start, end],
        what="annotation",
    )
    out: dict[str, list[Annotation]] = {}
    for line, (times, texts) in enumerate(zip(table.tolist(), cells, strict=True), 2):
        name, text = (text_of_cell(cell.strip()) for cell in texts)
        try:
            out.setdefault(name, []).append(checked_annotation((*times, text)))
        except ValueError as error:
            raise ValueError(f"'{path}', line {line}: {error}") from error
    return out


def read_labels(path: Path) -> dict[str, dict[str, str | int]]:
    r"""Returns the label and metadata in a ``labels.csv``, by the names of the recordings. Columns
    of whole numbers are numbers, and empty cells tell nothing.
    """
    lines = csv_rows(path)
    names = csv_names(lines)
    refuse_index(path, names)
    place = placed(path, names, dict(enumerate(names)))
    refuse_missing(path, place, _COLUMNS[:1])
    out: dict[str, dict[str, str | int]] = {}
    for line, row in lines:
        if len(row) != len(names):
            raise ValueError(f"'{path}', line {line} must have {len(names)} cells (got {len(row)})")
        cells = {name: text_of_cell(row[i].strip()) for name, i in place.items()}
        recording = cells.pop("recording")
        if recording in out:
            raise ValueError(
                f"'{path}', line {line} must not name a recording again (got {quoted(recording)})"
            )
        out[recording] = {name: cell for name, cell in cells.items() if cell}
    need(out, f"'{path}' must have a line for at least one recording (got its header): is it cut?")
    for name in place:
        found = [told for told in out.values() if name in told]
        if all(_INTEGER.fullmatch(str(told[name])) for told in found):
            for told in found:
                told[name] = int(told[name])
    return out


def annotations_beside(path: Path) -> list[Annotation]:
    r"""Returns the annotations that the ``annotations.csv`` beside a recording's file has of it."""
    table = path.with_name(ANNOTATIONS_FILE)
    if not table.is_file():
        return []
    stat = table.stat()
    found = _known_annotations(table, (stat.st_ino, stat.st_mtime_ns, stat.st_size))
    return [row for name in (path.name, path.stem) for row in found.get(name, ())]


@lru_cache(maxsize=4)  # of a folder with many recordings
def _known_annotations(table: Path, state: tuple[int, ...]) -> Mapping[str, list[Annotation]]:
    return read_annotations(table)


def write_annotations(path: Path, annotations: Sequence[Annotation]) -> None:
    r"""Writes the annotations of a recording into the ``annotations.csv`` beside its file, in place
    of those that this has of it. All else in it stays, also what other processes write meanwhile.
    """
    table = path.with_name(ANNOTATIONS_FILE)
    if annotations or table.exists():
        with exclusive_access(table):
            _replace_rows(table, path, annotations)


def _replace_rows(table: Path, path: Path, annotations: Sequence[Annotation]) -> None:
    names, before = [*_COLUMNS], []
    if table.exists():
        read_annotations(table)  # is refused if it is none
        lines = csv_rows(table)
        names = csv_names(lines)
        before = [row for _, row in lines]
    column = names.index("recording")
    mine = (path.name, path.stem)
    rows = [row for row in before if text_of_cell(row[column].strip()) not in mine]
    if not annotations and len(rows) == len(before):
        return
    need(path.stem.isprintable(), "the name of a recording's file must be printable", path.stem)
    for start, end, label in annotations:
        cells = [safe_cell(path.stem), repr(start), repr(end), safe_cell(label)]
        told = dict(zip(_COLUMNS, cells, strict=True))
        rows.append([told.get(name, "") for name in names])
    if not rows:
        table.unlink()
        return
    with atomic_path(table) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([names, *rows])
