r"""What CSV files in a folder of recordings tell of them."""

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

_Told = TypeVar("_Told")


def table_paths(folders: Iterable[Path]) -> list[Path]:
    r"""Returns the ``annotations.csv`` and ``labels.csv`` in some folders."""
    return [
        folder / name
        for folder in sorted({*folders})
        for name in TABLES
        if (folder / name).is_file()
    ]


class RecordingTables:
    r"""The annotations, labels and metadata that tables tell of recordings, whose names in a table
    are relative to its folder, or to the folder of all recordings if that is inside.
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
                for path, told in _by_path(table, read_labels(table), base, recordings):
                    self._labels.setdefault(path, []).append((table, told))

    def give(self, recording: Recording, path: Path) -> Recording:
        r"""Returns the recording of a file with what the tables tell of it."""
        rows = self._annotations.get(path, [])
        annotations = [*dict.fromkeys([*recording.annotations, *rows])]
        label, meta = recording.label, dict(recording.meta)
        for table, told in self._labels.get(path, ()):
            for key, value in told.items():
                before = label if key == "label" else meta.get(key)
                if before not in (None, value):
                    raise ValueError(
                        f"'{path}' must have the '{key}' that '{table}' tells, {value!r} (got "
                        f"{before!r} in the file): correct one of them"
                    )
                if key == "label":
                    label = value
                else:
                    meta[key] = value
        try:
            return replace(recording, label=label, meta=meta, annotations=annotations)
        except ValueError as error:
            raise ValueError(f"'{path}', with what the tables beside it tell: {error}") from error


def _by_path(
    table: Path, told: Mapping[str, _Told], base: Path, recordings: Sequence[Path]
) -> list[tuple[Path, _Told]]:
    named: dict[str, list[Path]] = {}
    for path in recordings:
        if path.is_relative_to(base):
            name = path.relative_to(base)
            for text in {name.as_posix(), name.with_suffix("").as_posix()}:
                named.setdefault(text, []).append(path)
    unknown = [name for name in told if name not in named]
    if unknown:
        raise ValueError(
            f"'{table}' must name recordings in '{base}', by their files with or without suffix "
            f"(got {quoted(unknown[0])}): correct the name, or delete its lines"
        )
    return [(path, value) for name, value in told.items() for path in named[name]]
