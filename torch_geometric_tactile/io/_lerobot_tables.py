r"""Parquet tables of LeRobot data sets, with sizes that are checked before memory is allocated."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._limits import ARRAY_BYTES, is_absurd
from torch_geometric_tactile._texts import printable

_BYTES_PER_VALUE = 8  # of a value in memory, at most
_SCHEMA_KEY = b"huggingface"
_DATA_PAGES = (0, 3)
# Field numbers of a page header, and of the headers of the two types of data pages in it.
_KIND, _UNPACKED, _PACKED, _DATA_PAGE_HEADERS = 1, 2, 3, (5, 8)
_BOOLEANS, _INTEGERS, _BYTE, _DOUBLE, _BINARY, _LIST, _STRUCT = (1, 2), (4, 5, 6), 3, 7, 8, 9, 12
# Field numbers of a footer, of its row groups, and of their columns.
_ROW_GROUPS, _COLUMNS, _COLUMN, _ENCRYPTION = 4, 1, 3, 8
_TYPE, _SIZE_STATISTICS, _TEXT_BYTES, _REPETITIONS, _DEFINITIONS = 1, 16, 1, 2, 3
_BYTE_ARRAY = 6  # a physical type
_MAX_DEPTH = 12  # of nested structures and lists; a footer has six


def require_pyarrow() -> Any:
    r"""Returns :obj:`pyarrow`, or raises an error with the command that installs it."""
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(
            "LeRobot data sets need pyarrow: pip install 'torch-geometric-tactile[lerobot]'"
        ) from error
    return pyarrow


def is_list(kind: Any) -> bool:
    r"""Returns whether an Arrow type is a list."""
    types = require_pyarrow().types
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def num_rows(path: Path) -> int:
    r"""Returns the number of rows declared in a Parquet file."""
    return int(_open_and_read(path, lambda file: file.metadata.num_rows))


def read_numbers(path: Path, sizes: Mapping[str, int], allow_large: bool = False) -> Any:
    r"""Reads columns of numbers from a Parquet file.

    A few bytes can represent millions of equal values, so the declared number of values is compared
    with the expected number before they are read.

    Args:
        path (Path): The file.
        sizes (Mapping): Maps the name of a column to its number of values per row.
        allow_large (bool): Whether to read tables far larger than the file.
    """

    def read(file: Any) -> Any:
        for name, size in sizes.items():
            _check_numbers(file, name, size)
        values = sum(sizes.values()) * file.metadata.num_rows
        _check_size(
            path,
            max(_BYTES_PER_VALUE * values, _checked_unpacked_size(path, file, [*sizes])),
            allow_large,
        )
        return file.read(columns=[*sizes], use_threads=False)

    return _open_and_read(path, read)


def read_texts(path: Path, number: str, texts: tuple[str, ...]) -> Any:
    r"""Reads a column of numbers and a column of strings from a Parquet file. Equal strings are
    stored once.

    Args:
        path (Path): The file.
        number (str): The name of the column of numbers.
        texts (tuple of str): Possible names of the column of strings. If it has none of them, the
            file must have a single column of strings.
    """
    pa = require_pyarrow()

    def find_text_column(file: Any) -> str:
        _check_numbers(file, number, 1)
        fields = file.schema_arrow
        text_columns = [f.name for f in fields if str(f.type) in ("string", "large_string")]
        matches = [name for name in texts if name in text_columns]
        if not matches and len(text_columns) != 1:
            raise ValueError(
                f"it must hold names in '{texts[0]}' (got {printable(fields.names)[:200]})"
            )
        name = (matches or text_columns)[0]
        _check_unique(file, name)
        rows = file.metadata.num_rows * _BYTES_PER_VALUE * 2
        _check_size(
            path, max(rows, _checked_unpacked_size(path, file, [number, name])), allow_large=False
        )
        return name

    name = _open_and_read(path, find_text_column)
    table = _open_and_read(
        path, lambda file: file.read(columns=[number, name]), read_dictionary=[name]
    )
    return pa.table({number: table.column(number), "text": table.column(name)})


def read_parquet(path: Path, allow_large: bool = False) -> Any:
    r"""Reads all columns of a Parquet file."""

    def read(file: Any) -> Any:
        groups = (file.metadata.row_group(i) for i in range(file.metadata.num_row_groups))
        values = sum(g.column(j).num_values for g in groups for j in range(g.num_columns))
        _check_size(
            path,
            max(_BYTES_PER_VALUE * values, _checked_unpacked_size(path, file, None)),
            allow_large,
        )
        return file.read(use_threads=False)

    return _open_and_read(path, read)


def _open_and_read(path: Path, read: Any, **settings: Any) -> Any:
    pa = require_pyarrow()
    try:
        if not path.is_file() and path.exists():
            raise ValueError("it must be a regular file (got a folder, pipe or device)")
        file = pa.parquet.ParquetFile(path, page_checksum_verification=True, **settings)
        with file:
            _check_columns(path, file.metadata)
            return read(file)
    except (pa.ArrowException, ValueError, OSError) as error:
        if isinstance(error, FileNotFoundError | PermissionError):
            raise
        raise ValueError(f"'{path}' cannot be read as Parquet: {error}") from error


def _check_columns(path: Path, metadata: Any) -> None:
    # Checks by hand, since pyarrow crashes when it describes a column with invalid statistics.
    with path.open("rb") as stream:
        stream.seek(-8, 2)
        length = int.from_bytes(stream.read(4), "little")
        stream.seek(-8 - length, 2)
        footer = _ThriftReader(stream.read(length)).read_struct()
    for group in _list_of(footer, _ROW_GROUPS):
        for j, chunk in enumerate(_list_of(group, _COLUMNS)[: metadata.num_columns]):
            column = _struct_of(chunk, _COLUMN)
            statistics = _struct_of(column, _SIZE_STATISTICS)
            kind = metadata.schema.column(j)
            levels = (
                (_list_of(statistics, _REPETITIONS), kind.max_repetition_level),
                (_list_of(statistics, _DEFINITIONS), kind.max_definition_level),
            )
            is_invalid = any(len(counts) not in (0, max_level + 1) for counts, max_level in levels)
            has_texts = _TEXT_BYTES in statistics and column.get(_TYPE) != _BYTE_ARRAY
            if is_invalid or has_texts or _struct_of(chunk, _ENCRYPTION):
                raise ValueError(
                    f"its column '{printable(kind.path)}' must have statistics of its type, and "
                    "no encryption"
                )


def _struct_of(struct: Any, number: int) -> dict[int, Any]:
    value = struct.get(number) if isinstance(struct, dict) else None
    return value if isinstance(value, dict) else {}


def _list_of(struct: Any, number: int) -> list[Any]:
    value = struct.get(number) if isinstance(struct, dict) else None
    return value if isinstance(value, list) else []


def _check_unique(file: Any, name: str) -> None:
    names = file.schema_arrow.names
    if names.count(name) != 1:
        raise ValueError(f"it must have the column '{name}' once (got {printable(names)[:200]})")


def _check_numbers(file: Any, name: str, size: int) -> None:
    pa = require_pyarrow()
    _check_unique(file, name)
    kind = leaf = file.schema_arrow.field(name).type
    while isinstance(leaf, pa.BaseExtensionType) or is_list(leaf):
        leaf = leaf.value_type if is_list(leaf) else leaf.storage_type
    if not (pa.types.is_integer(leaf) or pa.types.is_floating(leaf)):
        raise ValueError(f"it must hold numbers in '{name}' (got {kind})")
    values = sum(chunk.num_values for chunk in _column_chunks(file, [name]))
    if values != size * file.metadata.num_rows:
        raise ValueError(
            f"it must hold {size} numbers in '{name}' per row, {size * file.metadata.num_rows} in "
            f"total (got {values})"
        )


def _checked_unpacked_size(path: Path, file: Any, names: list[str] | None) -> int:
    chunks = _column_chunks(file, names)
    check_pages(path, chunks)
    return sum(chunk.total_uncompressed_size for chunk in chunks)


def _column_chunks(file: Any, names: list[str] | None) -> list[Any]:
    # Paths of columns: names may have dots, and each nested list adds two parts.
    metadata = file.metadata
    paths = [metadata.schema.column(j).path for j in range(metadata.num_columns)]
    list_parts = r"(\.[^.]+\.[^.]+){0,2}"
    matches = re.compile("|".join(f"{re.escape(n)}{list_parts}" for n in names or ())).fullmatch
    column_indices = [j for j, path in enumerate(paths) if names is None or matches(path)]
    groups = range(metadata.num_row_groups)
    return [metadata.row_group(i).column(j) for i in groups for j in column_indices]


def _check_size(path: Path, size: int, allow_large: bool) -> None:
    if not allow_large and is_absurd(size, path.stat().st_size, ARRAY_BYTES):
        raise ValueError(
            f"its tables would take {size / 2**30:.1f} GiB: pass allow_large=True if you trust the "
            "file"
        )


def write_parquet(table: Any, path: Path) -> None:
    r"""Writes a Parquet file with checksums."""
    with atomic_path(path) as temporary:
        require_pyarrow().parquet.write_table(
            table, temporary, compression="snappy", use_dictionary=True, write_page_checksum=True
        )


def arrow_column(values: np.ndarray) -> Any:
    r"""Converts the values of a feature to a LeRobot column. One value per step is not a list.

    Shapes:
        - **values:** Values :math:`(T, ...)`.
    """
    pa = require_pyarrow()
    array = pa.array(np.ascontiguousarray(values).ravel())
    size = values[0].size
    return array if size == 1 else pa.FixedSizeListArray.from_arrays(array, size)


def schema_metadata(
    features: Mapping[str, Any], metadata: Mapping[bytes, bytes] | None = None
) -> dict[bytes, bytes]:
    r"""Returns the metadata of a Parquet file that :obj:`datasets` needs to read the features.

    Shapes:
        - **metadata:** Metadata of an existing file, to which the features are added.
    """
    content: dict[str, Any] = {}
    if metadata is not None:
        content = json.loads(metadata[_SCHEMA_KEY])
    described = content.setdefault("info", {}).setdefault("features", {})
    for name, description in features.items():
        (size,) = description["shape"]
        value = {"dtype": description["dtype"], "_type": "Value"}
        described[name] = (
            value if size == 1 else {"feature": value, "length": size, "_type": "Sequence"}
        )
    return {**(metadata or {}), _SCHEMA_KEY: json.dumps(content).encode()}


def check_pages(path: Path, chunks: list[Any]) -> None:
    r"""Raises an error unless the sizes of the pages agree with the footer of the file."""
    with path.open("rb") as file:
        size = path.stat().st_size
        for chunk in chunks:
            values, unpacked = _page_totals(file, chunk, size)
            if values != chunk.num_values or unpacked > chunk.total_uncompressed_size:
                raise ValueError(
                    f"its pages must hold {chunk.num_values} values in "
                    f"{chunk.total_uncompressed_size} bytes, as its footer declares (got {values} "
                    f"in {unpacked})"
                )


def _page_totals(file: BinaryIO, chunk: Any, size: int) -> tuple[int, int]:
    start = chunk.data_page_offset
    dictionary_start = chunk.dictionary_page_offset
    if dictionary_start is not None and 0 < dictionary_start < start:
        start = dictionary_start
    end = start + chunk.total_compressed_size
    values = unpacked = 0
    while 0 < start < end <= size:
        file.seek(start)
        header = _ThriftReader(file.read(min(end - start, 1 << 20)))
        fields = header.read_struct()
        packed_size, unpacked_size = fields.get(_PACKED), fields.get(_UNPACKED)
        if (
            not isinstance(packed_size, int)
            or not isinstance(unpacked_size, int)
            or min(packed_size, unpacked_size) < 0
        ):
            raise ValueError("its pages must have sizes (got a header without size)")
        if fields.get(_KIND) in _DATA_PAGES:
            counts = [
                fields[key] for key in _DATA_PAGE_HEADERS if isinstance(fields.get(key), dict)
            ]
            values += counts[0].get(1, 0) if counts else 0
        unpacked += unpacked_size
        start += header.position + packed_size
    need(
        start == end,
        "its pages must end at the position that its footer declares (got another one)",
    )
    return values, unpacked


class _ThriftReader:
    # Reads the part of Thrift's compact protocol that footers and page headers use.
    def __init__(self, data: bytes) -> None:
        self.data, self.position = data, 0

    def read_struct(self, depth: int = 0) -> dict[int, Any]:
        fields: dict[int, Any] = {}
        number = 0
        while header := self._read_byte():
            number += header >> 4
            if not header >> 4:
                number = self._read_integer()
            kind = header & 15
            fields[number] = kind if kind in _BOOLEANS else self._read_value(kind, depth)
        return fields

    def _read_value(self, kind: int, depth: int) -> Any:
        if kind in _INTEGERS:
            return self._read_integer()
        if kind == _STRUCT and depth < _MAX_DEPTH:
            return self.read_struct(depth + 1)
        if kind == _LIST and depth < _MAX_DEPTH:
            header = self._read_byte()
            size = header >> 4 if header >> 4 < 15 else self._read_unsigned()
            return [self._read_value(header & 15, depth + 1) for _ in range(size)]
        if kind == _BINARY:
            length = self._read_unsigned()
            self.position += length
        elif kind in (*_BOOLEANS, _BYTE, _DOUBLE):
            self.position += 8 if kind == _DOUBLE else 1
        else:
            raise ValueError(f"its pages must have headers of Parquet (got a field of {kind})")
        return None

    def _read_byte(self) -> int:
        need(self.position < len(self.data), "its pages must have complete headers (got the end)")
        self.position += 1
        return self.data[self.position - 1]

    def _read_unsigned(self) -> int:
        number = 0
        for shift in range(0, 70, 7):
            byte = self._read_byte()
            number |= (byte & 127) << shift
            if byte < 128:
                return number
        raise ValueError("its pages must have headers of Parquet (got a number that is too long)")

    def _read_integer(self) -> int:
        number = self._read_unsigned()
        return number >> 1 ^ -(number & 1)
