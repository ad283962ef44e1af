import errno
import os
import stat
import tempfile

import pytest

from torch_geometric_tactile import _files as files
from torch_geometric_tactile._files import (
    atomic_path,
    file_sha256,
    new_scratch_folder,
    remove_leftovers,
)


def test_atomic_path_success_replaces_the_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "new" / "folder" / "a.txt"
    for text in ("first", "second"):
        with atomic_path(path) as temporary:
            assert temporary.parent == path.parent
            temporary.write_text(text)
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


def test_atomic_path_shows_no_half_file_while_it_is_written(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        assert path.read_text() == "old"


def test_atomic_path_leaves_what_another_writer_began_under_the_free_name(tmp_path, monkeypatch):
    replace = os.replace

    def replaced(source, target):
        replace(source, target)
        source.write_text("of another")

    monkeypatch.setattr(files.os, "replace", replaced)
    with atomic_path(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
    assert (tmp_path / "a.txt").read_text() == "whole"
    assert temporary.read_text() == "of another"


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_atomic_path_error_keeps_the_old_file_and_removes_the_new(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(type(error)):
        write()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_error_before_the_first_file_leaves_none(tmp_path):
    def write():
        with atomic_path(tmp_path / "a.txt"):
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        write()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="rights follow the umask on POSIX only")
@pytest.mark.parametrize(("umask", "rights"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_atomic_path_rights_follow_umask(tmp_path, umask, rights):
    before = os.umask(umask)
    try:
        with atomic_path(tmp_path / "a.txt") as temporary:
            temporary.write_text("a")
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == rights


@pytest.mark.parametrize("kind", ["folder", "pipe", "device"])
def test_atomic_path_replaces_files_only(kind, tmp_path):
    target = tmp_path / "target"
    if kind == "folder":
        target.mkdir()
    elif kind == "pipe":
        os.mkfifo(target)
    else:
        target.symlink_to("/dev/full")
    before = target.lstat()
    match = r"target' must be a file \(got a folder, pipe or device\)"
    with pytest.raises(FileExistsError, match=match), atomic_path(target) as path:
        path.write_text("a")
    assert target.lstat().st_ino == before.st_ino
    assert list(tmp_path.iterdir()) == [target]


def test_atomic_path_takes_strings(tmp_path):
    with atomic_path(str(tmp_path / "a.txt")) as temporary:
        temporary.write_text("a")
    assert (tmp_path / "a.txt").read_text() == "a"


def test_file_sha256_of_abc_is_that_of_fips_180(tmp_path):
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    assert file_sha256(path) == ("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad")


def test_file_sha256_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="gone"):
        file_sha256(tmp_path / "gone")


def die_while_writing(path):
    """Leaves the temporary that a process leaves which is killed while it writes."""
    child = os.fork()
    if child == 0:
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            os._exit(9)
    os.waitpid(child, 0)


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="locks of files are POSIX only")


@needs_fork
def test_atomic_path_removes_what_killed_writers_left(tmp_path):
    path, other = tmp_path / "a.txt", tmp_path / "a"
    with atomic_path(path):
        die_while_writing(path)
        die_while_writing(path)
    die_while_writing(other)
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        ".a.0.tmp",
        ".a.txt.1.tmp",
        "a.txt",
    ]
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
    assert sorted(file.name for file in tmp_path.iterdir()) == [".a.0.tmp", "a.txt"]


def test_atomic_path_twice_at_once_keeps_both_apart(tmp_path):
    path = tmp_path / "a.txt"
    with atomic_path(path) as first:
        first.write_text("first")
        with atomic_path(path) as second:
            assert second != first
            second.write_text("second")
            remove_leftovers(path)
            assert first.read_text() == "first"
        assert path.read_text() == "second"
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]


@needs_fork
def test_remove_leftovers_leaves_the_temporary_of_another_process_that_is_alive(tmp_path):
    path = tmp_path / "a.txt"
    ready, go_on = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        with atomic_path(path) as temporary:
            temporary.write_text("whole")
            os.write(ready[1], b"1")
            os.read(go_on[0], 1)
        os._exit(0)
    os.read(ready[0], 1)
    remove_leftovers(path)
    os.write(go_on[1], b"1")
    assert os.waitpid(child, 0)[1] == 0
    assert path.read_text() == "whole"


def test_atomic_path_taken_for_a_leftover_before_its_lock_starts_anew(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    path, flock, times = tmp_path / "a.txt", fcntl.flock, []

    def late(handle, operation):
        if operation == fcntl.LOCK_SH and not times:
            times.append(1)
            remove_leftovers(path)  # a second process, between creation and lock
        flock(handle, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
    assert path.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_without_locks_writes_and_removes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "fcntl", None)
    path = tmp_path / "a.txt"
    (tmp_path / ".a.txt.0.tmp").write_text("whose?")
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
    assert path.read_text() == "whole"
    assert sorted(file.name for file in tmp_path.iterdir()) == [".a.txt.0.tmp", "a.txt"]


@pytest.mark.parametrize("name", ["a" * 255, "é" * 127, "é" * 127 + "a", "触" * 85, "*[a]?.txt"])
def test_atomic_path_of_the_longest_names(name, tmp_path):
    path = tmp_path / name
    for text in ("first", "second"):
        with atomic_path(path) as temporary:
            assert len(os.fsencode(temporary.name)) <= 140
            temporary.write_text(text)
    assert path.read_text() == "second"
    assert list(tmp_path.iterdir()) == [path]


def test_long_names_that_differ_at_the_end_have_their_own_temporaries(tmp_path):
    with atomic_path(tmp_path / ("a" * 254)) as a, atomic_path(tmp_path / ("a" * 253 + "b")) as b:
        assert (a.name[:99], a.name[-6:]) == (b.name[:99], b.name[-6:])
        assert a != b


@pytest.mark.parametrize("about", ["nothing", "temporary"])
def test_atomic_path_full_disk_names_the_file(about, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write():
        with atomic_path(path) as temporary:
            raise OSError(errno.ENOSPC, "full", *([temporary] if about == "temporary" else []))

    with pytest.raises(OSError, match=r"No space left on device: '.*/a\.txt'$") as caught:
        write()
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(path))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_leaves_errors_about_other_files_as_they_are(tmp_path):
    def write():
        with atomic_path(tmp_path / "a.txt"):
            (tmp_path / "source.txt").read_text()

    with pytest.raises(FileNotFoundError, match=r"source\.txt'"):
        write()


@needs_fork
def test_scratch_folder_of_a_killed_process_is_removed_by_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    foreign = tmp_path / "torch_geometric_tactile_mine"
    foreign.mkdir()
    child = os.fork()
    if child == 0:
        (new_scratch_folder() / "a.yaml").write_text("a")
        os._exit(9)
    os.waitpid(child, 0)
    assert len(list(tmp_path.iterdir())) == 2
    first = new_scratch_folder()
    (first / "b.yaml").write_text("b")
    second = new_scratch_folder()
    assert sorted(tmp_path.iterdir()) == sorted([foreign, first, second])
    assert (first / "b.yaml").read_text() == "b"
