r"""Files of LeRobot data sets: Parquet whose sizes are known before memory is taken, and texts."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._limits import ARRAY_BYTES, is_absurd
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile.io._lerobot_features import require_pyarrow
from torch_geometric_tactile.io._parquet_pages import check_pages

# Without it, `datasets` takes the files of `meta` for data.
README = """\
---
configs:
- config_name: default
  data_files: data/*/*.parquet
task_categories:
- robotics
tags:
- LeRobot
- tactile
---

A LeRobot data set (v3.0) with touch, written by torch_geometric_tactile. `meta/tactile.json` has
its shape, labels and metadata.
"""

_BYTES = 8  # of a value in memory, at most


def is_list(kind: Any) -> bool:
    r"""Returns whether a type of Arrow is that of lists."""
    types = require_pyarrow().types
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def num_rows(path: Path) -> int:
    r"""Returns the number of rows that a Parquet file declares."""
    return int(_read(path, lambda file: file.metadata.num_rows))


def read_numbers(path: Path, sizes: Mapping[str, int], allow_large: bool = False) -> Any:
    r"""Returns the columns of numbers of a Parquet file.

    A few bytes can stand for millions of equal values, so how many there are is compared with what
    there must be, before they are read.
    """

    def read(file: Any) -> Any:
        for name, size in sizes.items():
            _check_numbers(file, name, size)
        values = sum(sizes.values()) * file.metadata.num_rows
        _check_size(path, max(_BYTES * values, _unpacked(path, file, [*sizes])), allow_large)
        return file.read(columns=[*sizes], use_threads=False)

    return _read(path, read)


def read_texts(path: Path, number: str, texts: tuple[str, ...]) -> Any:
    r"""Returns a column of numbers and one of texts of a Parquet file; equal texts are held
    once.
    """
    pa = require_pyarrow()

    def find(file: Any) -> str:
        _check_numbers(file, number, 1)
        fields = file.schema_arrow
        found = [f.name for f in fields if str(f.type) in ("string", "large_string")]
        known = [name for name in texts if name in found]
        if not known and len(found) != 1:
            raise ValueError(
                f"it must hold names in '{texts[0]}' (got {printable(fields.names)[:200]})"
            )
        name = (known or found)[0]
        _check_once(file, name)
        rows = file.metadata.num_rows * _BYTES * 2
        _check_size(path, max(rows, _unpacked(path, file, [number, name])), allow_large=False)
        return name

    name = _read(path, find)
    table = _read(path, lambda file: file.read(columns=[number, name]), read_dictionary=[name])
    return pa.table({number: table.column(number), "text": table.column(name)})


def read_whole(path: Path, allow_large: bool = False) -> Any:
    r"""Returns a whole Parquet file."""

    def read(file: Any) -> Any:
        groups = (file.metadata.row_group(i) for i in range(file.metadata.num_row_groups))
        values = sum(g.column(j).num_values for g in groups for j in range(g.num_columns))
        _check_size(path, max(_BYTES * values, _unpacked(path, file, None)), allow_large)
        return file.read(use_threads=False)

    return _read(path, read)


def _read(path: Path, read: Any, **settings: Any) -> Any:
    pa = require_pyarrow()
    try:
        if not path.is_file() and path.exists():
            raise ValueError("it must be a regular file (got a folder, pipe or device)")
        file = pa.parquet.ParquetFile(path, page_checksum_verification=True, **settings)
        with file:
            return read(file)
    except (pa.ArrowException, ValueError, OSError) as error:
        if isinstance(error, FileNotFoundError | PermissionError):
            raise
        raise ValueError(f"'{path}' cannot be read as Parquet: {error}") from error


def _check_once(file: Any, name: str) -> None:
    names = file.schema_arrow.names
    if names.count(name) != 1:
        raise ValueError(f"it must have the column '{name}' once (got {printable(names)[:200]})")


def _check_numbers(file: Any, name: str, size: int) -> None:
    pa = require_pyarrow()
    _check_once(file, name)
    kind = leaf = file.schema_arrow.field(name).type
    while isinstance(leaf, pa.BaseExtensionType) or is_list(leaf):
        leaf = leaf.value_type if is_list(leaf) else leaf.storage_type
    if not (pa.types.is_integer(leaf) or pa.types.is_floating(leaf)):
        raise ValueError(f"it must hold numbers in '{name}' (got {kind})")
    values = sum(chunk.num_values for chunk in _chunks(file, [name]))
    if values != size * file.metadata.num_rows:
        raise ValueError(
            f"it must hold {size} numbers in '{name}' a row, {size * file.metadata.num_rows} in "
            f"all (got {values})"
        )


def _unpacked(path: Path, file: Any, names: list[str] | None) -> int:
    chunks = _chunks(file, names)
    check_pages(path, chunks)
    return sum(chunk.total_uncompressed_size for chunk in chunks)


def _chunks(file: Any, names: list[str] | None) -> list[Any]:
    # Of columns of numbers, texts and lists: names have dots, and each list adds two parts.
    metadata = file.metadata
    paths = [metadata.schema.column(j).path for j in range(metadata.num_columns)]
    lists = r"(\.[^.]+\.[^.]+){0,2}"
    match = re.compile("|".join(f"{re.escape(n)}{lists}" for n in names or ())).fullmatch
    wanted = [j for j, path in enumerate(paths) if names is None or match(path)]
    groups = range(metadata.num_row_groups)
    return [metadata.row_group(i).column(j) for i in groups for j in wanted]


def _check_size(path: Path, size: int, allow_large: bool) -> None:
    if not allow_large and is_absurd(size, path.stat().st_size, ARRAY_BYTES):
        raise ValueError(
            f"its tables would take {size / 2**30:.1f} GiB: pass allow_large=True if it is right"
        )


def check_new_folder(root: Path) -> None:
    r"""Raises an error unless a folder is missing or empty."""
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise FileExistsError(f"'{root}' must be a new or empty folder (got one that is not)")


def write_table(table: Any, path: Path) -> None:
    r"""Writes a Parquet file with checksums."""
    with atomic_path(path) as temporary:
        require_pyarrow().parquet.write_table(
            table, temporary, compression="snappy", use_dictionary=True, write_page_checksum=True
        )


def write_text(path: Path, text: str) -> None:
    r"""Writes a text file."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
