r"""Atomic writes, file locks, temporary files and checks of zip files."""

import hashlib
import itertools
import os
import shutil
import struct
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from torch_geometric_tactile._typing import PathLike

try:
    import fcntl
except ImportError:  # Windows: temporaries of killed processes stay, as no lock shows their owner
    fcntl = None  # type: ignore[assignment]

_MAX_NAME_BYTES = 100  # of the target in the name of a temporary; eCryptfs allows 143 in total
_MAX_CHECKED_TEMPORARIES = 16  # for each target: more concurrent writers are not expected
_SCRATCH_PREFIX = "torch_geometric_tactile_"
_OWNER_FILE = ".owner"

#: Errors that the readers of NumPy, zip files and images raise for damaged or unexpected files.
UNREADABLE = (
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    OverflowError,
    RecursionError,
    RuntimeError,  # encrypted; its NotImplementedError: an unsupported zip version or compression
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def existing_file(path: PathLike, advice: str) -> Path:
    r"""Returns the path of a file. If the file does not exist, raises an error with advice."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; {advice}")
    return path


def unreadable_error(path: Path, kind: str, error: Exception) -> ValueError:
    r"""Returns the :class:`ValueError` for a file that a reader cannot parse."""
    reason = str(error) or type(error).__name__
    return ValueError(f"'{path}' cannot be read as {kind}: {reason}; copy or write it again")


@contextmanager
def atomic_path(path: PathLike) -> Iterator[Path]:
    r"""Yields a temporary path beside :obj:`path` that becomes :obj:`path` when the block succeeds.

    A reader never sees a partly written file: after an error or a kill, :obj:`path` keeps its old
    content. The next write to the same :obj:`path` removes temporaries of killed processes, but
    never the temporary of a running process. The block may truncate the temporary and write to it,
    but must not replace it by another file or lock it (h5py: ``locking=False``).

    Examples:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "a.txt"
        >>> with atomic_path(target) as tmp:
        ...     _ = tmp.write_text("whole")
        >>> target.read_text()
        'whole'
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    if (
        path.exists() and not path.is_file()
    ):  # renaming a file over a device would replace the device
        raise FileExistsError(f"'{path}' must be a file (got a folder, pipe or device)")
    remove_leftovers(path)
    temporary, handle = _new_temporary(path)
    try:
        with _errors_naming(path, temporary):
            yield temporary
            set_default_permissions(temporary)
            with temporary.open("rb+") as file:  # Windows does not flush files opened for reading
                os.fsync(file.fileno())
            os.replace(temporary, path)
    finally:
        # The name may already belong to the temporary of another writer.
        if fcntl is None or _has_path(handle, temporary):
            temporary.unlink(missing_ok=True)
        _unlock_and_close(handle)


@contextmanager
def exclusive_access(path: PathLike) -> Iterator[None]:
    r"""Holds an exclusive lock for a file, so that a block can read, change and rewrite it. Waits
    for other processes and threads. Has no effect on a file system without locks.

    The lock is a hidden file beside :obj:`path` that is removed at the end. The lock file of a
    killed process does not block other processes; the next process removes it.
    """
    lock = Path(f"{_temporary_prefix(Path(path))}lock")
    lock.parent.mkdir(parents=True, exist_ok=True)
    if fcntl is None:
        from filelock import FileLock

        with FileLock(lock):  # on Windows it removes its file
            yield
        return
    with _errors_naming(Path(path), lock):
        handle = _wait_for_lock(lock)
    try:
        yield
    finally:
        # The file is removed while it is locked: a waiting process sees that the name is gone, and
        # starts again.
        if _has_path(handle, lock):
            lock.unlink(missing_ok=True)
        _unlock_and_close(handle)


def _wait_for_lock(lock: Path) -> int:
    while True:
        handle = os.open(lock, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(handle, fcntl.LOCK_EX)
            if _has_path(handle, lock):
                return handle
        except BaseException:  # such as an interrupt while waiting
            os.close(handle)
            raise
        os.close(handle)


def lock_file(handle: int, path: PathLike, *, exclusive: bool = True) -> Callable[[], None]:
    r"""Locks an open file without waiting, and returns a function that releases the lock.

    Has no effect on a file system without locks. On Windows, writers lock a second file
    :obj:`PATH.lock`, and readers lock nothing.

    Raises:
        BlockingIOError: If another process holds the lock.
    """
    if fcntl is not None:
        try:
            fcntl.flock(handle, fcntl.LOCK_NB | (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH))
        except BlockingIOError as error:
            raise locked_error(path) from error
        except OSError:  # a file system without locks
            pass
    elif exclusive:
        from filelock import FileLock, Timeout

        lock = FileLock(f"{path}.lock")
        try:
            lock.acquire(timeout=0)
        except Timeout as error:
            raise locked_error(path) from error
        return lock.release
    return _do_nothing  # closing the file releases it


def locked_error(path: PathLike) -> BlockingIOError:
    r"""Returns the :class:`BlockingIOError` for a file that another process writes."""
    return BlockingIOError(
        f"'{path}' is locked by another process that writes it: close it there first"
    )


def _do_nothing() -> None:
    return


def remove_leftovers(path: PathLike) -> None:
    r"""Removes temporaries of a file that were left by killed writers. Temporaries of running
    writers stay.
    """
    prefix = _temporary_prefix(Path(path))
    for slot in range(_MAX_CHECKED_TEMPORARIES):
        name = f"{prefix}{slot}.tmp"
        if not os.path.lexists(name):
            continue
        temporary = Path(name)
        with _try_lock_abandoned(temporary) as abandoned:
            if abandoned:
                with suppress(OSError):  # a folder of another user
                    temporary.unlink()


def new_scratch_folder() -> Path:
    r"""Returns a new temporary folder, which is locked until this process ends. Removes the folders
    of killed processes. The caller must remove the new folder at the end.
    """
    for owner in Path(tempfile.gettempdir()).glob(f"{_SCRATCH_PREFIX}*/{_OWNER_FILE}"):
        with _try_lock_abandoned(owner) as abandoned:
            if abandoned:
                shutil.rmtree(owner.parent, ignore_errors=True)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_SCRATCH_PREFIX))
        if _create_locked(folder / _OWNER_FILE) is not None:
            return folder


def _temporary_prefix(path: Path) -> str:
    # The common beginning of the paths of all temporaries of a file.
    name = path.name
    if len(os.fsencode(name)) > _MAX_NAME_BYTES:
        code = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
        # Names are cut between characters, because some file systems accept only valid text.
        name = os.fsencode(name)[:_MAX_NAME_BYTES].decode("utf-8", "ignore") + f"~{code}"
    return str(path.with_name(f".{name}."))


def _new_temporary(path: Path) -> tuple[Path, int]:
    prefix = _temporary_prefix(path)
    for slot in itertools.count():
        temporary = Path(f"{prefix}{slot}.tmp")
        with _errors_naming(path, temporary):
            handle = _create_locked(temporary)
        if handle is not None:
            return temporary, handle
    raise AssertionError("unreachable")


def _create_locked(path: Path) -> int | None:
    # Returns a new locked file. Returns None if the path exists, or if another process removed the
    # new file as abandoned before it was locked.
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
    except FileExistsError:
        return None
    if fcntl is None:
        os.close(handle)  # Windows does not rename open files
        return -1
    # The lock is shared, because HDF5 readers lock too, and must be able to open the renamed file.
    _try_lock(handle, exclusive=False)
    if _has_path(handle, path):
        return handle
    os.close(handle)
    return None


def _try_lock(handle: int, exclusive: bool) -> bool:
    if fcntl is None:
        return False
    try:
        # A shared lock waits for a process that cleans up. Such a process holds its lock briefly.
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB if exclusive else fcntl.LOCK_SH)
    except OSError:  # locked by its writer, or a file system without locks
        return False
    return True


def _unlock_and_close(handle: int) -> None:
    if fcntl is not None:
        # Closing is not enough: a process forked in the meantime shares the lock.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_UN)
        os.close(handle)


@contextmanager
def _try_lock_abandoned(path: Path) -> Iterator[bool]:
    try:
        handle = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    except OSError:  # missing, or a file of another user
        yield False
        return
    try:
        yield _try_lock(handle, exclusive=True) and _has_path(handle, path)
    finally:
        os.close(handle)


def _has_path(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


@contextmanager
def _errors_naming(path: Path, temporary: Path) -> Iterator[None]:
    # Makes disk errors name the target file instead of its temporary.
    try:
        yield
    except OSError as error:
        if error.errno is None or str(error.filename) not in ("None", str(temporary)):
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from error


def set_default_permissions(path: PathLike) -> None:
    r"""Gives a private temporary file the permissions of a new file."""
    umask = os.umask(0)
    os.umask(umask)
    Path(path).chmod(0o666 & ~umask)


def file_sha256(path: PathLike) -> str:
    r"""Returns the SHA-256 of a file as a hexadecimal string."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_packing(entry: zipfile.ZipInfo) -> None:
    r"""Raises a :class:`ValueError` unless an entry of a zip file can be unpacked piece by piece.

    With other compression methods (bzip2, LZMA), Python unpacks one piece of the file completely,
    which may need gigabytes of memory.
    """
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(
            f"its part {entry.filename!r} must be stored or deflated (got compression "
            f"method {entry.compress_type})"
        )


def check_zip(path: PathLike) -> None:
    r"""Compares every entry of a zip file with its checksum. The entries must be stored without
    compression, as in PyTorch's files, and must not overlap, so that the number of bytes read is
    limited by the size of the file.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the file is damaged or truncated.
    """
    problem = ""
    try:
        with zipfile.ZipFile(path) as archive:
            total = sum(entry.file_size for entry in archive.infolist())
            if total > os.path.getsize(path):
                problem = f"its parts have {total} bytes in total, more than the file"
            for entry in archive.infolist():
                # PyTorch reads an entry marked as a folder (0x10) as zeros.
                if entry.compress_type != zipfile.ZIP_STORED or entry.external_attr & 0x10:
                    problem = f"its part {entry.filename!r} is not an uncompressed file"
            damaged = None if problem else archive.testzip()
            if damaged is not None:
                problem = f"its part {damaged!r} differs from its checksum"
    except FileNotFoundError:
        raise
    except UNREADABLE as error:
        problem = str(error)
    if problem:
        raise ValueError(
            f"'{path}' is damaged or truncated ({problem}): copy or write it again"
        ) from None
