r"""Reader of the zip file with PhysioNet's pressure mat data."""

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

_CHECKSUM_FILE = "SHA256SUMS.txt"
_EXPERIMENT_I = re.compile(r"experiment-i/S(?P<person>[0-9]{1,3})/(?P<posture>[0-9]{1,3})\.txt")
_EXPERIMENT_II = re.compile(
    r"experiment-ii/S(?P<person>[0-9]{1,3})/(?P<mattress>Air|Sponge)_Mat/"
    r"Matrix_(?P=mattress)_(?P<posture>[A-Z][0-9]{1,3})\.txt"
)
_CHUNK_BYTES = 2**16  # unpacked at a time


class MatFile(NamedTuple):
    r"""One file of the pressure mat data: the person, the posture, the mattress (in experiment II),
    and the readings :math:`(T, R, C)` of a mat with :math:`R` rows and :math:`C` columns.

    Examples:
        >>> MatFile("S1", "B1", "air", np.zeros((1, 64, 27))).reading.shape
        (1, 64, 27)
    """

    person: str
    posture: str
    mattress: str | None
    reading: np.ndarray


def read_pressure_mat_zip(path: PathLike, experiment: str = "i") -> list[MatFile]:
    r"""Reads the files of one experiment in `A Pressure Map Dataset for In-bed Posture
    Classification <https://physionet.org/content/pmd/1.0.0/>`_, sorted by person, mattress and
    posture.

    The files contain integers as text. In experiment I, each line holds the 64 x 32 readings of a
    frame. In experiment II, each file holds one frame in 64 lines of 27 readings.

    Args:
        path (str or PathLike): The zip file.
        experiment (str): :obj:`"i"` or :obj:`"ii"`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not a zip file or is damaged, would take more than 1 GiB and 200
            times its size, has no file of the experiment, a file above 16 MiB or two files with the
            same name, or if a line has an invalid reading or number of readings. The message names
            the zip file and the file in it.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "mat.zip"
        ...     with zipfile.ZipFile(path, "w") as archive:
        ...         archive.writestr("pmd/experiment-i/S1/4.txt", 3 * f"{'5 ' * 2048}\n")
        ...     files = read_pressure_mat_zip(path)
        >>> files[0].person, files[0].posture, files[0].reading.shape
        ('S1', '4', (3, 64, 32))
    """
    need(experiment in ("i", "ii"), "'experiment' must be 'i' or 'ii'", repr(experiment))
    pattern, num_columns = (_EXPERIMENT_I, 32) if experiment == "i" else (_EXPERIMENT_II, 27)
    files = []
    with _open_archive(path) as archive:
        for inner, entry in _entries_by_name(archive).items():
            match = pattern.fullmatch(inner)
            if match is None:
                continue
            where = f"'{path}', {entry.filename!r}"
            readings_per_line = 64 * num_columns if experiment == "i" else num_columns
            rows = _parse_readings(b"".join(_read_chunks(archive, entry)), where, readings_per_line)
            is_complete = experiment == "i" or len(rows) == 64
            need(
                is_complete, f"{where} must have 64 rows of {readings_per_line} readings", len(rows)
            )
            reading = rows.reshape(-1, 64, num_columns)
            mattress = match["mattress"].lower() if experiment == "ii" else None
            files.append(MatFile(f"S{match['person']}", match["posture"], mattress, reading))
    need(files, f"'{path}' must hold files of experiment {experiment.upper()} (got none)")
    return sorted(
        files, key=lambda f: (int(f.person[1:]), f.mattress or "", _posture_key(f.posture))
    )


def pressure_mat_hash(path: PathLike) -> str:
    r"""Compares all files in the zip file with its list of checksums, and returns the SHA-256 of
    this list. It stays the same if the archive is compressed again.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not a zip file or is damaged, would take more than 1 GiB and 200
            times its size, has no list of checksums, if a listed file is missing or differs, or if
            a file of readings is not listed or is repeated. The message names the zip file and the
            file in it.
    """
    with _open_archive(path) as archive:
        entries = _entries_by_name(archive)
        need(_CHECKSUM_FILE in entries, f"'{path}' must hold {_CHECKSUM_FILE} (got none)")
        checksums = b"".join(_read_chunks(archive, entries.pop(_CHECKSUM_FILE)))
        for line in checksums.decode("ascii", "replace").splitlines():
            checksum, _, name = line.partition(" ")
            name = name.strip()
            # Each entry is compared only once, even if it is listed repeatedly.
            entry = entries.pop(name, None)
            if entry is None or _entry_sha256(archive, entry) != checksum:
                raise ValueError(
                    f"'{path}' must hold '{name}' with the SHA-256 checksum {checksum}"
                )
        unlisted = [inner for inner in entries if _is_reading(inner)]
        if unlisted:
            raise ValueError(
                f"'{path}' must hold only the files listed in its {_CHECKSUM_FILE} (got "
                f"{unlisted[0]!r}): download it again"
            )
    return hashlib.sha256(checksums).hexdigest()


@contextmanager
def _open_archive(path: PathLike) -> Iterator[zipfile.ZipFile]:
    path = existing_file(path, "put the zip file of https://physionet.org/content/pmd there")
    with ExitStack() as stack:
        with _errors_naming(f"'{path}'"):
            archive = stack.enter_context(zipfile.ZipFile(path))
        total = sum(entry.file_size for entry in archive.infolist())
        if is_absurd(total, path.stat().st_size, ARRAY_BYTES):
            raise ValueError(
                f"the files in '{path}' must take at most 1 GiB or 200 times its size (got "
                f"{total / 2**30:.1f} GiB, as in a file made to exhaust the memory): download it "
                "again"
            )
        yield archive


def _entries_by_name(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    # By the names inside the top folder.
    entries: dict[str, zipfile.ZipInfo] = {}
    for entry in archive.infolist():
        inner = _inner_name(entry.filename)
        if inner in entries and (inner == _CHECKSUM_FILE or _is_reading(inner)):
            raise ValueError(
                f"'{archive.filename}' must hold '{inner}' once (got "
                f"{entries[inner].filename!r} and {entry.filename!r}): download it again"
            )
        entries[inner] = entry
    return entries


def _read_chunks(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    where = f"'{archive.filename}', {entry.filename!r}"
    max_bytes = PRESSURE_MAT_BYTES
    need(entry.file_size <= max_bytes, f"{where} must have at most 16 MiB", entry.file_size)
    length = 0
    with _errors_naming(where):
        check_packing(entry)
        # `zipfile` unpacks no more than the declared size, and then compares the checksum.
        with archive.open(entry) as file:
            while chunk := file.read(_CHUNK_BYTES):
                length += len(chunk)
                yield chunk
        need(length == entry.file_size, f"it must have {entry.file_size} bytes", length)


def _entry_sha256(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> str:
    digest = hashlib.sha256()
    for chunk in _read_chunks(archive, entry):
        digest.update(chunk)
    return digest.hexdigest()


@contextmanager
def _errors_naming(where: str) -> Iterator[None]:
    try:
        yield
    except UNREADABLE as error:
        reason = str(error) or type(error).__name__
        raise ValueError(f"{where} cannot be read ({reason}): download it again") from error


def _is_reading(inner: str) -> bool:
    return any(pattern.fullmatch(inner) for pattern in (_EXPERIMENT_I, _EXPERIMENT_II))


def _inner_name(name: str) -> str:
    # Removes the top folder.
    return name.partition("/")[2] if not name.startswith("experiment-") else name


def _parse_readings(text: bytes, where: str, readings_per_line: int) -> np.ndarray:
    invalid = text.translate(None, b"0123456789 \t\r\n")
    need(not invalid, f"{where} must hold only integers", repr(invalid[:20])[1:])
    need(text.strip(), f"{where} must have {readings_per_line} readings per line (got none)")
    # NumPy below 2.1 silently drops excess digits.
    long_number = re.search(rb"[0-9]{10}", text)
    need(not long_number, f"{where} must hold integers of at most nine digits")
    try:
        rows = np.loadtxt(io.BytesIO(text), dtype=np.int32, comments=None, ndmin=2)
    except ValueError as error:
        raise ValueError(
            f"{where} must hold integers in lines of equal length ({error})"
        ) from error
    need(
        rows.shape[1] == readings_per_line,
        f"{where} must have {readings_per_line} readings per line",
        rows.shape[1],
    )
    return rows.astype(np.float32)


def _posture_key(posture: str) -> tuple[str, int]:
    letter = posture.rstrip("0123456789")
    return letter, int(posture[len(letter) :])
