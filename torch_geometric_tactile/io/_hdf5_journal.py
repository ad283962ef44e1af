r"""Changes of an HDF5 file that are whole or absent, whatever happens while they are written.

HDF5 changes a file in many places, one after the other, and ends the process if the disk is full
when it closes the file. Here it writes to memory instead. The new parts are then written behind the
old end of the file, after them a journal of the bytes that change before it, then these bytes, and
the file is cut where the new parts end. A file that ends in a whole journal is read as if the
changes were made; behind the end that its own header names, HDF5 looks at nothing.
"""

import io
import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

_PAGE = 4096
_MAGIC = b"tactile journal\n"
_FOOTER = struct.Struct("<16sQQII")  # magic, bytes before it, size of the new file, two checksums
_ENTRY = struct.Struct("<QI")  # where, how many bytes


class PatchedFile(io.RawIOBase):
    r"""A file of which all changes are kept in memory."""

    def __init__(self, handle: int) -> None:
        self.handle = handle
        self.size = self._stored = os.fstat(handle).st_size
        self._pages: dict[int, bytearray] = {}
        self._position = 0
        self._replay()

    def readable(self) -> bool:
        r"""Whether the file can be read: yes."""
        return True

    def writable(self) -> bool:
        r"""Whether the file can be written to: yes."""
        return True

    def seekable(self) -> bool:
        r"""Whether the position can be set: yes."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        r"""Sets the position and returns it."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self.size}[whence]
        self._position = base + offset
        return self._position

    def readinto(self, buffer: Any) -> int:
        r"""Fills a buffer from the position on and returns how many bytes there were."""
        view = memoryview(buffer).cast("B")
        content = self._read(self._position, min(len(view), max(self.size - self._position, 0)))
        view[: len(content)] = content
        self._position += len(content)
        return len(content)

    def write(self, data: Any) -> int:
        r"""Keeps bytes that belong at the position and returns how many."""
        view = memoryview(data).cast("B")
        self._patch(self._position, view)
        self._position += len(view)
        self.size = max(self.size, self._position)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        r"""Sets the size of the file."""
        self.size = self._position if size is None else size
        return self.size

    def commit(self) -> None:
        r"""Writes the changes to the file, all or none of them."""
        old, end = self._stored, max(self._stored, self.size)
        inside = self._changes(0, old)
        if not inside and self.size == old:
            return
        journal = b"".join(_ENTRY.pack(where, len(part)) + part for where, part in inside)
        head = (_MAGIC, len(journal), self.size, zlib.crc32(journal))
        journal += _FOOTER.pack(*head, zlib.crc32(_FOOTER.pack(*head, 0)))
        try:
            for where, part in self._changes(old, self.size):
                _write(self.handle, part, where)
            _write(self.handle, journal, end)
        except BaseException:
            os.ftruncate(self.handle, old)
            raise
        # From here on the changes are made: whoever reads the file reads its journal.
        with suppress(OSError):
            for where, part in inside:
                _write(self.handle, part, where)
            os.ftruncate(self.handle, self.size)

    def _replay(self) -> None:
        start = self._stored - _FOOTER.size
        footer = os.pread(self.handle, _FOOTER.size, start) if start > 0 else b""
        if not footer.startswith(_MAGIC):
            return
        magic, length, size, journal_sum, footer_sum = _FOOTER.unpack(footer)
        whole = zlib.crc32(_FOOTER.pack(magic, length, size, journal_sum, 0)) == footer_sum
        if not whole or length + size > start:
            return
        journal = os.pread(self.handle, length, start - length)
        if zlib.crc32(journal) != journal_sum:
            return
        position = 0
        while position < length:
            where, count = _ENTRY.unpack_from(journal, position)
            position += _ENTRY.size
            self._patch(where, memoryview(journal)[position : position + count])
            position += count
        self.size = size

    def _read(self, start: int, count: int) -> bytearray:
        out = bytearray(count)
        have = 0
        while have < min(count, self._stored - start):  # the system reads at most 2 GiB at once
            part = os.pread(self.handle, min(count, self._stored - start) - have, start + have)
            if not part:
                break
            out[have : have + len(part)] = part
            have += len(part)
        for number in range(start // _PAGE, -(-(start + count) // _PAGE)):
            page = self._pages.get(number)
            if page is not None:
                first, last = max(start, number * _PAGE), min(start + count, (number + 1) * _PAGE)
                out[first - start : last - start] = page[
                    first - number * _PAGE : last - number * _PAGE
                ]
        return out

    def _patch(self, start: int, view: memoryview) -> None:
        end = start + len(view)
        for number in range(start // _PAGE, -(-end // _PAGE)):
            if number not in self._pages:
                self._pages[number] = self._read(number * _PAGE, _PAGE)
            first, last = max(start, number * _PAGE), min(end, (number + 1) * _PAGE)
            self._pages[number][first - number * _PAGE : last - number * _PAGE] = view[
                first - start : last - start
            ]

    def _changes(self, start: int, end: int) -> list[tuple[int, bytes]]:
        out: list[tuple[int, bytes]] = []
        for number in sorted(self._pages):
            first, last = max(start, number * _PAGE), min(end, (number + 1) * _PAGE)
            if first < last:
                base = number * _PAGE
                part = bytes(self._pages[number][first - base : last - base])
                if part != os.pread(self.handle, last - first, first):
                    out.append((first, part))
        return out


def ends_in_journal(path: Path) -> bool:
    r"""Returns whether a file may end in a journal, so that it is to be read with
    :class:`PatchedFile`.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _FOOTER.size, 0))
        return file.read(len(_MAGIC)) == _MAGIC


def _write(handle: int, data: bytes, where: int) -> None:
    view = memoryview(data)
    while view:
        count = os.pwrite(handle, view, where)
        view, where = view[count:], where + count
