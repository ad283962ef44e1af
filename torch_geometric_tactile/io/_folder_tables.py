r"""CSV files with annotations, labels and metadata of the recordings in the same folder.

``annotations.csv`` has the columns ``recording``, ``start``, ``end`` and ``label``. ``labels.csv``
has ``recording``, ``label`` and further columns of metadata. A recording is identified by the name
of its file, with or without the suffix.
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
from torch_geometric_tactile.io._csv_format import CsvFormat
from torch_geometric_tactile.io._csv_table import (
    cell_to_text,
    check_columns_exist,
    check_no_index,
    csv_rows,
    csv_table,
    map_columns,
    read_header,
    text_to_cell,
)

ANNOTATIONS_FILE, LABELS_FILE = TABLES = ("annotations.csv", "labels.csv")
# As spreadsheets write it: with commas, or with semicolons and decimal commas.
_FORMAT = CsvFormat(decimal=",", has_options=False)
_COLUMNS = ("recording", "start", "end", "label")
_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")


def read_annotations(path: Path) -> dict[str, list[Annotation]]:
    r"""Reads an ``annotations.csv``, and returns the annotations by the name of the recording."""
    lines = csv_rows(path, _FORMAT)
    names = read_header(lines)
    column_of_name = map_columns(path, names, dict(enumerate(names)))
    check_columns_exist(path, column_of_name, _COLUMNS)
    recording, start, end, label = (column_of_name[name] for name in _COLUMNS)
    table, cells = csv_table(
        path,
        lines,
        names,
        [start, end],
        texts=[recording, label],
        required=[start, end],
        row_noun="annotation",
        csv_format=_FORMAT,
    )
    annotations: dict[str, list[Annotation]] = {}
    for line, (times, texts) in enumerate(zip(table.tolist(), cells, strict=True), 2):
        name, text = (cell_to_text(cell.strip()) for cell in texts)
        try:
            annotations.setdefault(name, []).append(checked_annotation((*times, text)))
        except ValueError as error:
            raise ValueError(f"'{path}', line {line}: {error}") from error
    return annotations


def read_labels(path: Path) -> dict[str, dict[str, str | int]]:
    r"""Reads a ``labels.csv``, and returns label and metadata by the name of the recording.

    A column that holds only integers is converted to integers. Empty cells are left out.
    """
    lines = csv_rows(path, _FORMAT)
    names = read_header(lines)
    check_no_index(path, names)
    column_of_name = map_columns(path, names, dict(enumerate(names)))
    check_columns_exist(path, column_of_name, _COLUMNS[:1])
    metadata_of_recording: dict[str, dict[str, str | int]] = {}
    for line, row in lines:
        if len(row) != len(names):
            raise ValueError(f"'{path}', line {line} must have {len(names)} cells (got {len(row)})")
        cells = {name: cell_to_text(row[i].strip()) for name, i in column_of_name.items()}
        recording = cells.pop("recording")
        if recording in metadata_of_recording:
            raise ValueError(
                f"'{path}', line {line} must not repeat a recording (got {quoted(recording)})"
            )
        metadata_of_recording[recording] = {name: cell for name, cell in cells.items() if cell}
    need(
        metadata_of_recording,
        f"'{path}' must have a line for at least one recording (got only the header): is it "
        "truncated?",
    )
    # Only now are all cells of a column known.
    for name in column_of_name:
        rows = [metadata for metadata in metadata_of_recording.values() if name in metadata]
        if all(_INTEGER.fullmatch(str(metadata[name])) for metadata in rows):
            for metadata in rows:
                metadata[name] = int(metadata[name])
    return metadata_of_recording


def annotations_beside(path: Path) -> list[Annotation]:
    r"""Returns the annotations of a recording from the ``annotations.csv`` beside its file."""
    table = path.with_name(ANNOTATIONS_FILE)
    if not table.is_file():
        return []
    stat = table.stat()
    annotations = _cached_annotations(table, (stat.st_ino, stat.st_mtime_ns, stat.st_size))
    return [
        annotation for name in (path.name, path.stem) for annotation in annotations.get(name, ())
    ]


@lru_cache(maxsize=4)  # since a folder may have many recordings; `state` shows whether it changed
def _cached_annotations(table: Path, state: tuple[int, ...]) -> Mapping[str, list[Annotation]]:
    return read_annotations(table)


def write_annotations(path: Path, annotations: Sequence[Annotation]) -> None:
    r"""Writes the annotations of a recording to the ``annotations.csv`` beside its file, and
    replaces the previous ones. Rows of other recordings are kept, even if another process writes
    at the same time.
    """
    table = path.with_name(ANNOTATIONS_FILE)
    if annotations or table.exists():
        with exclusive_access(table):
            _replace_rows(table, path, annotations)


def _replace_rows(table: Path, path: Path, annotations: Sequence[Annotation]) -> None:
    names, old_rows = [*_COLUMNS], []
    if table.exists():
        read_annotations(table)  # raises an error for an invalid table
        lines = csv_rows(table, _FORMAT)
        names = read_header(lines)
        old_rows = [row for _, row in lines]
    column = names.index("recording")
    recording_names = (path.name, path.stem)
    rows = [row for row in old_rows if cell_to_text(row[column].strip()) not in recording_names]
    if not annotations and len(rows) == len(old_rows):
        return
    need(path.stem.isprintable(), "the name of a recording's file must be printable", path.stem)
    for start, end, label in annotations:
        cells = [text_to_cell(path.stem), repr(start), repr(end), text_to_cell(label)]
        cell_of_name = dict(zip(_COLUMNS, cells, strict=True))
        rows.append([cell_of_name.get(name, "") for name in names])
    if not rows:
        table.unlink()
        return
    with atomic_path(table) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([names, *rows])
