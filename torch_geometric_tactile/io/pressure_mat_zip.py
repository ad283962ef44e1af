r"""The zip file of PhysioNet's pressure mat data."""

import hashlib
import io
import re
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import UNREADABLE, check_packing, existing_file
from torch_geometric_tactile._limits import ARRAY_BYTES, PRESSURE_MAT_BYTES, is_absurd
from torch_geometric_tactile._typing import PathLike

_SUMS = "SHA256SUMS.txt"
_EXPERIMENT_I = re.compile(r"experiment-i/S(?P<person>[0-9]{1,3})/(?P<posture>[0-9]{1,3})\.txt")
_EXPERIMENT_II = re.compile(
    r"experiment-ii/S(?P<person>[0-9]{1,3})/(?P<mattress>Air|Sponge)_Mat/"
    r"Matrix_(?P=mattress)_(?P<posture>[A-Z][0-9]{1,3})\.txt"
)
_CHUNK = 2**16  # bytes that are unpacked at once


class MatFile(NamedTuple):
    r"""One file of the pressure mat data: the pressures :math:`(T, R, C)` of a mat of :math:`R`
    rows and :math:`C` columns, who lay on it, in which posture, and in experiment II on which
    mattress.

    Examples:
        >>> MatFile("S1", "B1", "air", np.zeros((1, 64, 27))).reading.shape
        (1, 64, 27)
    """

    person: str
    posture: str
    mattress: str | None
    reading: np.ndarray


def read_pressure_mat_zip(path: PathLike, experiment: str = "i") -> list[MatFile]:
    r"""Reads the files of one experiment of `A Pressure Map Dataset for In-bed Posture
    Classification <https://physionet.org/content/pmd/1.0.0/>`_, by person, mattress and posture:
    text files of whole numbers, in experiment I with a line of 64 x 32 readings for each frame, in
    experiment II with a line for each of 64 rows of 27 readings.

    Args:
        path (str or PathLike): The zip file.
        experiment (str): :obj:`"i"` or :obj:`"ii"`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no zip file or is damaged, would take more than 1 GiB and 200
            times its size, has no file of the experiment, one above 16 MiB or two of one name, or
            a line has another number of readings, or one that is none. The message names the zip
            file and the file in it.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "mat.zip"
        ...     with zipfile.ZipFile(path, "w") as archive:
        ...         archive.writestr("pmd/experiment-i/S1/4.txt", 3 * f"{'5 ' * 2048}\n")
        ...     found = read_pressure_mat_zip(path)
        >>> found[0].person, found[0].posture, found[0].reading.shape
        ('S1', '4', (3, 64, 32))
    """
    need(experiment in ("i", "ii"), "'experiment' must be 'i' or 'ii'", repr(experiment))
    pattern, columns = (_EXPERIMENT_I, 32) if experiment == "i" else (_EXPERIMENT_II, 27)
    found = []
    with _opened(path) as archive:
        for inner, entry in _entries(archive).items():
            name = pattern.fullmatch(inner)
            if name is None:
                continue
            where = f"'{path}', {entry.filename!r}"
            cells = 64 * columns if experiment == "i" else columns
            rows = _readings(b"".join(_chunks(archive, entry)), where, cells)
            is_whole = experiment == "i" or len(rows) == 64
            need(is_whole, f"{where} must have 64 rows of {cells} readings", len(rows))
            reading = rows.reshape(-1, 64, columns)
            mattress = name["mattress"].lower() if experiment == "ii" else None
            found.append(MatFile(f"S{name['person']}", name["posture"], mattress, reading))
    need(found, f"'{path}' must hold files of experiment {experiment.upper()} (got none)")
    return sorted(found, key=lambda f: (int(f.person[1:]), f.mattress or "", _number(f.posture)))


def pressure_mat_hash(path: PathLike) -> str:
    r"""Returns the SHA-256 checksum of the list of checksums in the zip file, after all files in it
    were compared with that list: it stays the same where the archive is packed anew.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is no zip file or is damaged, would take more than 1 GiB and 200
            times its size, has no list, a file that is listed is missing or another one, or a file
            of readings is not listed, or is there twice. The message names the zip file and the
            file in it.
    """
    with _opened(path) as archive:
        entries = _entries(archive)
        need(_SUMS in entries, f"'{path}' must hold {_SUMS} (got none)")
        sums = b"".join(_chunks(archive, entries.pop(_SUMS)))
        for line in sums.decode("ascii", "replace").splitlines():
            code, _, name = line.partition(" ")
            name = name.strip()
            # Each entry is compared once, however often it is listed.
            entry = entries.pop(name, None)
            if entry is None or _sha256(archive, entry) != code:
                raise ValueError(f"'{path}' must hold '{name}' with the SHA-256 checksum {code}")
        unlisted = [inner for inner in entries if _is_reading(inner)]
        if unlisted:
            raise ValueError(
                f"'{path}' must hold the files only that its {_SUMS} lists (got {unlisted[0]!r}, "
                "too): download it again"
            )
    return hashlib.sha256(sums).hexdigest()


@contextmanager
def _opened(path: PathLike) -> Iterator[zipfile.ZipFile]:
    path = existing_file(path, "put the zip file of https://physionet.org/content/pmd there")
    with ExitStack() as stack:
        with _errors_about(f"'{path}'"):
            archive = stack.enter_context(zipfile.ZipFile(path))
        total = sum(entry.file_size for entry in archive.infolist())
        if is_absurd(total, path.stat().st_size, ARRAY_BYTES):
            raise ValueError(
                f"the files in '{path}' must take 1 GiB or 200 times its size at most (got "
                f"{total / 2**30:.1f} GiB, as in a file that is made to fill the memory): download "
                "it again"
            )
        yield archive


def _entries(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    # By their names inside the folder that holds everything.
    entries: dict[str, zipfile.ZipInfo] = {}
    for entry in archive.infolist():
        inner = _inner(entry.filename)
        if inner in entries and (inner == _SUMS or _is_reading(inner)):
            raise ValueError(
                f"'{archive.filename}' must hold '{inner}' once (got "
                f"{entries[inner].filename!r} and {entry.filename!r}): download it again"
            )
        entries[inner] = entry
    return entries


def _chunks(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    where = f"'{archive.filename}', {entry.filename!r}"
    largest = PRESSURE_MAT_BYTES
    need(entry.file_size <= largest, f"{where} must have 16 MiB at most", entry.file_size)
    length = 0
    with _errors_about(where):
        check_packing(entry)
        # No more than the declared size is unpacked, and the checksum is compared at its end.
        with archive.open(entry) as file:
            while chunk := file.read(_CHUNK):
                length += len(chunk)
                yield chunk
        need(length == entry.file_size, f"it must have {entry.file_size} bytes", length)


def _sha256(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> str:
    code = hashlib.sha256()
    for chunk in _chunks(archive, entry):
        code.update(chunk)
    return code.hexdigest()


@contextmanager
def _errors_about(where: str) -> Iterator[None]:
    try:
        yield
    except UNREADABLE as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f"{where} cannot be read ({reason}): download it again") from error


def _is_reading(inner: str) -> bool:
    return any(pattern.fullmatch(inner) for pattern in (_EXPERIMENT_I, _EXPERIMENT_II))


def _inner(name: str) -> str:
    # Without the folder that holds everything.
    return name.partition("/")[2] if not name.startswith("experiment-") else name


def _readings(text: bytes, where: str, cells: int) -> np.ndarray:
    other = text.translate(None, b"0123456789 \t\r\n")
    need(not other, f"{where} must hold whole numbers only", repr(other[:20])[1:])
    need(text.strip(), f"{where} must have {cells} readings a line (got none)")
    # NumPy below 2.1 cuts the digits off that are too many.
    long = re.search(rb"[0-9]{10}", text)
    need(not long, f"{where} must hold whole numbers of nine digits at most")
    try:
        rows = np.loadtxt(io.BytesIO(text), dtype=np.int32, comments=None, ndmin=2)
    except ValueError as error:
        raise ValueError(f"{where} must hold whole numbers in equal lines ({error})") from error
    need(rows.shape[1] == cells, f"{where} must have {cells} readings a line", rows.shape[1])
    return rows.astype(np.float32)


def _number(posture: str) -> tuple[str, int]:
    letter = posture.rstrip("0123456789")
    return letter, int(posture[len(letter) :])
