r"""Annotations, labels and metadata of recordings from CSV files in their folder."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.data import Annotation, Recording
from torch_geometric_tactile.io._folder_tables import (
    ANNOTATIONS_FILE,
    LABELS_FILE,
    TABLES,
    read_annotations,
    read_labels,
)

_Row = TypeVar("_Row")


def table_paths(folders: Iterable[Path]) -> list[Path]:
    r"""Returns the paths of ``annotations.csv`` and ``labels.csv`` in folders."""
    return [
        folder / name
        for folder in sorted({*folders})
        for name in TABLES
        if (folder / name).is_file()
    ]


class RecordingTables:
    r"""The annotations, labels and metadata of recordings from CSV tables.

    The names of recordings in a table are relative to the folder of the table, or to the folder of
    all recordings if the table is outside that folder.
    """

    def __init__(self, tables: Sequence[Path], folder: Path, recordings: Sequence[Path]) -> None:
        self._annotations: dict[Path, list[Annotation]] = {}
        self._labels: dict[Path, list[tuple[Path, Mapping[str, Any]]]] = {}
        for table in tables:
            base = table.parent if table.parent.is_relative_to(folder) else folder
            if table.name == ANNOTATIONS_FILE:
                for path, rows in _by_path(table, read_annotations(table), base, recordings):
                    self._annotations.setdefault(path, []).extend(rows)
            elif table.name == LABELS_FILE:
                for path, row in _by_path(table, read_labels(table), base, recordings):
                    self._labels.setdefault(path, []).append((table, row))

    def add_to(self, recording: Recording, path: Path) -> Recording:
        r"""Returns a recording with the annotations, label and metadata from the tables.

        Raises:
            ValueError: If a table contradicts the recording.
        """
        rows = self._annotations.get(path, [])
        annotations = [*dict.fromkeys([*recording.annotations, *rows])]
        label, meta = recording.label, dict(recording.meta)
        for table, row in self._labels.get(path, ()):
            for key, value in row.items():
                present = label if key == "label" else meta.get(key)
                if present not in (None, value):
                    raise ValueError(
                        f"'{path}' must have the same '{key}' as '{table}', {value!r} (got "
                        f"{present!r} in the file): correct one of them"
                    )
                if key == "label":
                    label = value
                else:
                    meta[key] = value
        try:
            return replace(recording, label=label, meta=meta, annotations=annotations)
        except ValueError as error:
            raise ValueError(f"'{path}', with the rows of the tables beside it: {error}") from error


def _by_path(
    table: Path, rows: Mapping[str, _Row], base: Path, recordings: Sequence[Path]
) -> list[tuple[Path, _Row]]:
    # Returns the rows of a table with the paths of the recordings that they name. A name without
    # suffix may stand for several files.
    paths: dict[str, list[Path]] = {}
    for path in recordings:
        if path.is_relative_to(base):
            name = path.relative_to(base)
            for text in {name.as_posix(), name.with_suffix("").as_posix()}:
                paths.setdefault(text, []).append(path)
    unknown = [name for name in rows if name not in paths]
    if unknown:
        raise ValueError(
            f"'{table}' must name recordings in '{base}' by file name, with or without suffix "
            f"(got {quoted(unknown[0])}): correct the name, or delete its lines"
        )
    return [(path, row) for name, row in rows.items() for path in paths[name]]
