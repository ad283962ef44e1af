r"""Headers of the pages of Parquet files, which say how much pyarrow will unpack."""

from pathlib import Path
from typing import Any, BinaryIO

_DATA_PAGES = (0, 3)
# Numbers of the fields of a header, and of those of the two kinds of data pages in it.
_KIND, _UNPACKED, _PACKED, _COUNTS = 1, 2, 3, (5, 8)
_BOOLEANS, _INTEGERS, _BYTE, _DOUBLE, _BINARY, _STRUCT = (1, 2), (4, 5, 6), 3, 7, 8, 12


def check_pages(path: Path, chunks: list[Any]) -> None:
    r"""Raises an error unless the pages of columns hold what the footer of the file declares."""
    with path.open("rb") as file:
        size = path.stat().st_size
        for chunk in chunks:
            values, unpacked = _totals(file, chunk, size)
            if values != chunk.num_values or unpacked > chunk.total_uncompressed_size:
                raise ValueError(
                    f"its pages must hold {chunk.num_values} values in "
                    f"{chunk.total_uncompressed_size} bytes, as its footer declares (got {values} "
                    f"in {unpacked})"
                )


def _totals(file: BinaryIO, chunk: Any, size: int) -> tuple[int, int]:
    start = chunk.data_page_offset
    first = chunk.dictionary_page_offset
    if first is not None and 0 < first < start:
        start = first
    end = start + chunk.total_compressed_size
    values = unpacked = 0
    while 0 < start < end <= size:
        file.seek(start)
        header = _Header(file.read(min(end - start, 1 << 20)))
        fields = header.struct()
        packed, whole = fields.get(_PACKED), fields.get(_UNPACKED)
        if not isinstance(packed, int) or not isinstance(whole, int) or min(packed, whole) < 0:
            raise ValueError("its pages must have sizes (got a header without)")
        if fields.get(_KIND) in _DATA_PAGES:
            counts = [fields[key] for key in _COUNTS if isinstance(fields.get(key), dict)]
            values += counts[0].get(1, 0) if counts else 0
        unpacked += whole
        start += header.place + packed
    if start != end:
        raise ValueError("its pages must end where its footer declares (got another place)")
    return values, unpacked


class _Header:
    # Thrift's compact protocol, as far as headers of pages use it.
    def __init__(self, data: bytes) -> None:
        self.data, self.place = data, 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        out: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number += head >> 4
            if not head >> 4:
                number = self._integer()
            kind = head & 15
            if kind in _INTEGERS:
                out[number] = self._integer()
            elif kind == _STRUCT and depth < 3:
                out[number] = self.struct(depth + 1)
            elif kind == _BINARY:
                length = self._unsigned()
                self.place += length
            elif kind in (_BYTE, _DOUBLE):
                self.place += 1 if kind == _BYTE else 8
            elif kind not in _BOOLEANS:
                raise ValueError(f"its pages must have headers of Parquet (got a field of {kind})")
        return out

    def _byte(self) -> int:
        if self.place >= len(self.data):
            raise ValueError("its pages must have whole headers (got the end)")
        self.place += 1
        return self.data[self.place - 1]

    def _unsigned(self) -> int:
        out = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            out |= (byte & 127) << shift
            if byte < 128:
                return out
        raise ValueError("its pages must have headers of Parquet (got a number that is too long)")

    def _integer(self) -> int:
        number = self._unsigned()
        return number >> 1 ^ -(number & 1)
