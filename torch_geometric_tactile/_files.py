r"""Files that are either complete or absent."""

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
except ImportError:  # Windows: leftovers of a kill stay, as nothing tells whose they are
    fcntl = None  # type: ignore[assignment]

_LONGEST = 100  # bytes of the target's name in that of a temporary; eCryptfs allows 143 in all
_SLOTS = 16  # writers of one target at once whose leftovers are found
_SCRATCH = "torch_geometric_tactile_"
_OWNER = ".owner"

#: What the readers of numpy, zip files and images raise for damaged or strange files.
UNREADABLE = (
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    OverflowError,
    RecursionError,
    RuntimeError,  # encrypted; NotImplementedError: another version or compression of zip
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def existing_file(path: PathLike, advice: str) -> Path:
    r"""Returns the path of a file that exists."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; {advice}")
    return path


def unreadable(path: Path, kind: str, error: Exception) -> ValueError:
    r"""Returns the error of a file that is damaged."""
    reason = str(error) or type(error).__name__
    return ValueError(f"'{path}' cannot be read as {kind}: {reason}; copy or write it again")


@contextmanager
def atomic_path(path: PathLike) -> Iterator[Path]:
    r"""Yields a temporary path beside :obj:`path` that becomes :obj:`path` when the block succeeds.

    A reader never sees half a file: on an error or a kill, :obj:`path` keeps its old content. What
    a kill left behind is removed by the next write to the same :obj:`path`; the temporary of a
    writer that is alive is never touched. The block may truncate the temporary and write to it, but
    must not replace it by another file or lock it (h5py: ``locking=False``).

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
    if path.exists() and not path.is_file():  # renaming a file over a device would replace it
        raise FileExistsError(f"'{path}' must be a file (got a folder, pipe or device)")
    remove_leftovers(path)
    temporary, handle = _new_temporary(path)
    try:
        with _errors_about(path, temporary):
            yield temporary
            share(temporary)
            with temporary.open("rb+") as written:  # Windows flushes no file opened for reading
                os.fsync(written.fileno())
            os.replace(temporary, path)
    finally:
        # Under its name there may already be the temporary of another writer.
        if fcntl is None or _is_at(handle, temporary):
            temporary.unlink(missing_ok=True)
        _release(handle)


@contextmanager
def exclusive_access(path: PathLike) -> Iterator[None]:
    r"""Waits until no other process or thread is in such a block for the same file, to read a file,
    change it and write it anew. A file system without locks excludes nobody.

    The lock is a hidden file beside :obj:`path`, which is removed at the end. That of a process
    that was killed holds nobody up, and is removed by the next.
    """
    lock = Path(f"{_start(Path(path))}lock")
    lock.parent.mkdir(parents=True, exist_ok=True)
    if fcntl is None:
        from filelock import FileLock

        with FileLock(lock):  # on Windows it removes its file
            yield
        return
    with _errors_about(Path(path), lock):
        handle = _wait_for_lock(lock)
    try:
        yield
    finally:
        # Removed while it is held: who waits for it sees that it has no name, and starts anew.
        if _is_at(handle, lock):
            lock.unlink(missing_ok=True)
        _release(handle)


def _wait_for_lock(lock: Path) -> int:
    while True:
        handle = os.open(lock, os.O_CREAT | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0), 0o666)
        try:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(handle, fcntl.LOCK_EX)
            if _is_at(handle, lock):
                return handle
        except BaseException:  # such as an interrupt while it waits
            os.close(handle)
            raise
        os.close(handle)


def hold_file(handle: int, path: PathLike, *, exclusive: bool = True) -> Callable[[], None]:
    r"""Locks an open file, and returns the function that releases it. A file system without locks
    holds nothing. On Windows, writers hold a second file :obj:`PATH.lock`, and readers nothing.
    """
    if fcntl is not None:
        try:
            fcntl.flock(handle, fcntl.LOCK_NB | (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH))
        except BlockingIOError as error:
            raise is_held(path) from error
        except OSError:  # a file system without locks
            pass
    elif exclusive:
        from filelock import FileLock, Timeout

        lock = FileLock(f"{path}.lock")
        try:
            lock.acquire(timeout=0)
        except Timeout as error:
            raise is_held(path) from error
        return lock.release
    return _nothing  # closing the file releases it


def is_held(path: PathLike) -> BlockingIOError:
    r"""Returns the error of a file that another process writes."""
    return BlockingIOError(
        f"'{path}' is locked by another process that writes it: close it there first"
    )


def _nothing() -> None:
    return


def remove_leftovers(path: PathLike) -> None:
    r"""Removes what killed writers left of their temporaries of a file, and none of a writer that
    is alive.
    """
    start = _start(Path(path))
    for slot in range(_SLOTS):
        name = f"{start}{slot}.tmp"
        if not os.path.lexists(name):
            continue
        temporary = Path(name)
        with _abandoned(temporary) as abandoned:
            if abandoned:
                with suppress(OSError):  # someone else's folder
                    temporary.unlink()


def new_scratch_folder() -> Path:
    r"""Returns a new temporary folder that is held until this process ends, and removes those of
    processes that were killed. The caller removes it at the end.
    """
    for owner in Path(tempfile.gettempdir()).glob(f"{_SCRATCH}*/{_OWNER}"):
        with _abandoned(owner) as abandoned:
            if abandoned:
                shutil.rmtree(owner.parent, ignore_errors=True)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_SCRATCH))
        if _create(folder / _OWNER) is not None:
            return folder


def _start(path: Path) -> str:
    # What the paths of all temporaries of a file begin with.
    name = path.name
    if len(os.fsencode(name)) > _LONGEST:
        code = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
        # Cut between characters, since some file systems take whole ones only.
        name = os.fsencode(name)[:_LONGEST].decode("utf-8", "ignore") + f"~{code}"
    return str(path.with_name(f".{name}."))


def _new_temporary(path: Path) -> tuple[Path, int]:
    start = _start(path)
    for slot in itertools.count():
        temporary = Path(f"{start}{slot}.tmp")
        with _errors_about(path, temporary):
            handle = _create(temporary)
        if handle is not None:
            return temporary, handle
    raise AssertionError("unreachable")


def _create(path: Path) -> int | None:
    # A new file that is locked, or None where there is one, or someone took it for a leftover
    # between its creation and its lock.
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
    except FileExistsError:
        return None
    if fcntl is None:
        os.close(handle)  # Windows renames no open file
        return -1
    # Shared, so that HDF5 readers, which lock as well, open the file as soon as it has its name.
    _lock(handle, exclusive=False)
    if _is_at(handle, path):
        return handle
    os.close(handle)
    return None


def _lock(handle: int, exclusive: bool) -> bool:
    if fcntl is None:
        return False
    try:
        # A new temporary waits for a cleaner, which holds it for a moment only.
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB if exclusive else fcntl.LOCK_SH)
    except OSError:  # held by its writer, or a file system without locks
        return False
    return True


def _release(handle: int) -> None:
    if fcntl is not None:
        # Closing is not enough: a process that was forked meanwhile shares the lock.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_UN)
        os.close(handle)


@contextmanager
def _abandoned(path: Path) -> Iterator[bool]:
    try:
        handle = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    except OSError:  # none there, or another user's
        yield False
        return
    try:
        yield _lock(handle, exclusive=True) and _is_at(handle, path)
    finally:
        os.close(handle)


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False


@contextmanager
def _errors_about(path: Path, temporary: Path) -> Iterator[None]:
    # Errors of the disk name the file that was asked for, not its temporary or none.
    try:
        yield
    except OSError as error:
        if error.errno is None or str(error.filename) not in ("None", str(temporary)):
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from error


def share(path: PathLike) -> None:
    r"""Gives a file that was made as a private temporary one the rights that new files have."""
    umask = os.umask(0)
    os.umask(umask)
    Path(path).chmod(0o666 & ~umask)


def file_sha256(path: PathLike) -> str:
    r"""Returns the SHA-256 of a file as a hexadecimal string."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_packing(entry: zipfile.ZipInfo) -> None:
    r"""Raises a :class:`ValueError` unless an entry of a zip file can be unpacked piece by piece.

    Of the other methods (bzip2, LZMA), Python unpacks all that a piece of the file holds, which may
    be gigabytes.
    """
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(
            f"its part {entry.filename!r} must be stored or deflated (got compression "
            f"{entry.compress_type})"
        )


def check_zip(path: PathLike) -> None:
    r"""Compares every entry of a zip file with its checksum. The entries must be stored without
    compression, as PyTorch stores them, and may not share bytes, such that no more is read than the
    file holds.
    """
    problem = ""
    try:
        with zipfile.ZipFile(path) as archive:
            total = sum(entry.file_size for entry in archive.infolist())
            if total > os.path.getsize(path):
                problem = f"its parts have {total} bytes, more than the file"
            for entry in archive.infolist():
                # PyTorch reads a file that is marked as a folder (0x10) as zeros.
                if entry.compress_type != zipfile.ZIP_STORED or entry.external_attr & 0x10:
                    problem = f"its part {entry.filename!r} is no stored file"
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
