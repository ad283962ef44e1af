import errno

import numpy as np
import pytest

pytest.importorskip("h5py", reason="needs the extra 'io'")

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import _hdf5_journal as hdf5_journal
from torch_geometric_tactile.io import append_hdf5, read_hdf5, write_hdf5


def frames(start, stop):
    values = np.arange(start, stop)
    return Recording(values / 100, values[:, None, None] * np.ones((1, 3, 2)), label="cup")


@pytest.fixture
def path(tmp_path):
    for start in range(0, 12, 4):
        append_hdf5(frames(start, start + 4), tmp_path / "a.h5")
    return tmp_path / "a.h5"


@pytest.fixture
def snapshots(path, monkeypatch):
    """The content of the file at each moment of an append in which a kill may end it."""
    taken = []
    write, truncate = hdf5_journal._write, hdf5_journal.os.ftruncate

    def watched_write(handle, data, where):
        write(handle, data[: len(data) // 2], where)
        taken.append(path.read_bytes())
        write(handle, data, where)
        taken.append(path.read_bytes())

    def watched_truncate(handle, size):
        truncate(handle, size)
        taken.append(path.read_bytes())

    monkeypatch.setattr(hdf5_journal, "_write", watched_write)
    monkeypatch.setattr(hdf5_journal.os, "ftruncate", watched_truncate)
    append_hdf5(frames(12, 15), path)
    monkeypatch.undo()
    return taken


def test_killed_append_reads_as_before_or_after_and_can_be_gone_on_with(
    path, snapshots, assert_same
):
    seen = []
    for content in snapshots:
        path.write_bytes(content)
        seen.append(read_hdf5(path).num_frames)
        assert_same(read_hdf5(path), frames(0, seen[-1]))
        assert path.read_bytes() == content  # reading writes nothing
        append_hdf5(frames(seen[-1], 30), path)
        assert_same(read_hdf5(path), frames(0, 30))
        assert not hdf5_journal.ends_in_journal(path)
    assert len(seen) == 9
    assert seen == sorted(seen)
    assert set(seen) == {12, 15}


def test_file_with_a_journal_is_compressed_without_it(path, snapshots, assert_same):
    pending = [content for content in snapshots if content[-40:].startswith(b"tactile journal\n")]
    assert len(pending) == 5
    path.write_bytes(pending[-1])
    write_hdf5(read_hdf5(path), path)
    assert_same(read_hdf5(path), frames(0, 15))


@pytest.mark.parametrize("position", [-40, -30, -20, -10, -5, -1, -41, -60, -500])
def test_damaged_journal_is_not_followed(position, path, snapshots, assert_same):
    content = bytearray(next(c for c in snapshots if c[-40:].startswith(b"tactile journal\n")))
    content[position] ^= 4
    path.write_bytes(content)
    assert_same(read_hdf5(path), frames(0, 12))


@pytest.mark.parametrize("fails_at", range(3))
def test_append_on_a_full_disk_names_the_file_and_keeps_its_frames(
    fails_at, path, monkeypatch, assert_same
):
    write, before = hdf5_journal._write, path.read_bytes()
    calls = []

    def full(handle, data, where):
        calls.append(where)
        if where >= len(before) and len(calls) > fails_at:
            write(handle, data[:7], where)
            raise OSError(errno.ENOSPC, "full")
        write(handle, data, where)

    monkeypatch.setattr(hdf5_journal, "_write", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.h5'"):
        append_hdf5(frames(12, 512), path)
    assert path.read_bytes() == before
    monkeypatch.undo()
    append_hdf5(frames(12, 20), path)
    assert_same(read_hdf5(path), frames(0, 20))


def test_changes_inside_that_the_disk_refuses_are_read_from_the_journal(
    path, monkeypatch, assert_same
):
    write, size = hdf5_journal._write, path.stat().st_size

    def full(handle, data, where):
        if where < size:
            raise OSError(errno.ENOSPC, "full")
        write(handle, data, where)

    monkeypatch.setattr(hdf5_journal, "_write", full)
    append_hdf5(frames(12, 15), path)
    assert hdf5_journal.ends_in_journal(path)
    assert_same(read_hdf5(path), frames(0, 15))
    append_hdf5(frames(15, 18), path)
    assert_same(read_hdf5(path), frames(0, 18))
    monkeypatch.undo()
    append_hdf5(frames(18, 20), path)
    assert not hdf5_journal.ends_in_journal(path)
    assert_same(read_hdf5(path), frames(0, 20))


def test_append_of_nothing_changes_nothing(path):
    before = path.read_bytes()
    append_hdf5(frames(12, 12), path)
    assert path.read_bytes() == before


def test_appends_of_two_at_once_lose_no_frame(tmp_path, monkeypatch, assert_same):
    path = tmp_path / "a.h5"
    link, others = hdf5_journal.os.link, [frames(0, 3)]

    def late(source, target):
        while others:
            append_hdf5(others.pop(), path)  # a second process that was faster
        link(source, target)

    monkeypatch.setattr(hdf5_journal.os, "link", late)
    append_hdf5(frames(3, 6), path)
    assert_same(read_hdf5(path), frames(0, 6))
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.h5"]


def test_append_removes_what_a_killed_one_left_before_the_file_was_there(path):
    leftover = path.with_name(".a.h5.1.tmp")
    leftover.write_bytes(b"half")
    append_hdf5(frames(12, 13), path)
    assert not leftover.exists()
