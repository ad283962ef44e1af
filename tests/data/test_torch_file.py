"""Files of PyTorch that may be damaged, or anyone's."""

import os
import subprocess
import sys
import zipfile

import pytest
import torch
from hostile_pickle import Touch

from torch_geometric_tactile.data import _torch_file as torch_file
from torch_geometric_tactile.data._torch_file import (
    check_once,
    load_mapped,
    mark_path,
    read_torch_file,
)


@pytest.fixture
def path(tmp_path):
    torch.save({"a": torch.arange(500.0), "b": ["text", 1]}, tmp_path / "a.pt")
    os.utime(tmp_path / "a.pt", (10, 10))
    return tmp_path / "a.pt"


@pytest.fixture
def checked(monkeypatch):
    """Which files were compared with their checksums; all are large."""
    seen = []
    check = torch_file.check_zip
    monkeypatch.setattr(torch_file, "_ALWAYS_CHECKED_BYTES", 0)
    monkeypatch.setattr(torch_file, "check_zip", lambda path: (seen.append(path), check(path)))
    return seen


@pytest.mark.parametrize("mmap", [False, True])
@pytest.mark.parametrize("once", [False, True])
def test_content_is_read(path, mmap, once):
    content = read_torch_file(path, mmap=mmap, once=once)
    assert content["a"].equal(torch.arange(500.0))
    assert content["b"] == ["text", 1]
    assert not mark_path(path).exists()  # a small file is checked every time


def test_large_file_is_checked_once(path, checked):
    for _ in range(3):
        read_torch_file(path, once=True)
    assert checked == [path]
    read_torch_file(path)
    assert checked == [path] * 2
    assert sorted(os.listdir(path.parent)) == ["a.pt", "a.pt.checked"]


def test_large_file_is_checked_again_when_it_changed(path, checked):
    check_once(path)
    content = bytearray(path.read_bytes())
    content[content.find(b"text")] ^= 1
    path.write_bytes(content)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"a\.pt' is damaged"):
            check_once(path)


@pytest.mark.parametrize("what", ["time", "inode", "size"])
def test_each_sign_of_a_change_counts(path, checked, what):
    check_once(path)
    content = path.read_bytes()
    if what == "inode":  # a copy with the old time
        (path.parent / "b.pt").write_bytes(content)
        (path.parent / "b.pt").replace(path)
    if what == "size":
        path.write_bytes(content + b" ")
    os.utime(path, (11, 11) if what == "time" else (10, 10))
    check_once(path)
    assert len(checked) == 2


@pytest.mark.parametrize("mark", [b"", b"\xff", b"3", b'{"size": 1}'])
def test_mark_that_says_nothing_is_not_trusted(path, checked, mark):
    mark_path(path).write_bytes(mark)
    check_once(path)
    check_once(path)
    assert checked == [path]


def test_file_that_may_still_change_is_checked_again(path, checked):
    os.utime(path)  # now: a write of this moment may leave the same time
    check_once(path)
    assert not mark_path(path).exists()


def test_file_in_a_folder_that_cannot_be_written_to(path, checked, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(torch_file, "atomic_path", refuse)
    check_once(path)
    check_once(path)
    assert checked == [path] * 2


@pytest.mark.parametrize("mmap", [False, True])
def test_objects_are_not_unpickled(tmp_path, mmap):
    torch.save({"a": Touch(tmp_path / "mark")}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match=r"a\.pt' must hold plain data and tensors only"):
        read_torch_file(tmp_path / "a.pt", mmap=mmap)
    assert not (tmp_path / "mark").exists()
    torch.load(tmp_path / "a.pt", weights_only=False)
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize(
    "value",
    [
        torch.zeros(1).expand(10**12),
        torch.zeros(4)[::2].expand(3, 2),
        torch.empty(10**12, device="meta"),
    ],
)
def test_tensors_that_claim_more_than_there_is(tmp_path, value):
    torch.save({"a": [(value,)]}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match=r"a\.pt' must hold the \d+ bytes of its tensor, shape"):
        read_torch_file(tmp_path / "a.pt")


def test_quantized_tensors_are_refused(tmp_path):
    value = torch.quantize_per_tensor(torch.zeros(3), 0.1, 0, torch.quint8)
    torch.save({"a": [(value,)]}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match=r"a\.pt' must hold plain numbers \(got a quantized"):
        read_torch_file(tmp_path / "a.pt")


def test_views_and_transposed_tensors_are_read(tmp_path):
    values = [torch.rand(3, 4).t(), torch.rand(8)[2:4], torch.tensor(1.0), torch.zeros(0, 3)]
    torch.save(values, tmp_path / "a.pt")
    for found, value in zip(read_torch_file(tmp_path / "a.pt"), values, strict=True):
        assert found.equal(value)


def test_more_values_than_any_file_needs(tmp_path, monkeypatch):
    torch.save([[0] * 30] * 30, tmp_path / "a.pt")  # 900 numbers in 31 lists
    monkeypatch.setattr(torch_file, "_MAX_VALUES", 931)
    assert read_torch_file(tmp_path / "a.pt") == [[0] * 30] * 30
    monkeypatch.setattr(torch_file, "_MAX_VALUES", 930)
    with pytest.raises(ValueError, match=r"a\.pt' must hold at most 930 values"):
        read_torch_file(tmp_path / "a.pt")


@pytest.mark.parametrize("mmap", [False, True])
def test_part_that_is_shorter_than_its_tensor(tmp_path, mmap):
    torch.save({"x": torch.arange(6.0)}, tmp_path / "whole.pt")
    with (
        zipfile.ZipFile(tmp_path / "whole.pt") as whole,
        zipfile.ZipFile(tmp_path / "a.pt", "w") as short,
    ):
        for name in whole.namelist():
            content = whole.read(name)
            short.writestr(name, content[:-4] if "/data/" in name else content)
    with pytest.raises(ValueError, match=r"a\.pt'"):
        read_torch_file(tmp_path / "a.pt", mmap=mmap)


_SIZE = 2**28  # bytes of the file, half of them more than the process may have

_LIMITED = """
import resource, sys, torch
from torch_geometric_tactile.data._torch_file import read_torch_file

with open("/proc/self/status") as file:
    used = next(int(line.split()[1]) for line in file if line.startswith("VmData")) * 1024
resource.setrlimit(resource.RLIMIT_DATA, (used + {room}, used + {room}))
content = read_torch_file(sys.argv[1], mmap=True, once=True)
x = content["x"]
assert x[-1, 0] == 7 and x.sum() == 7, x
print("read", tuple(x.shape), flush=True)
if len(sys.argv) > 2:
    x[0, 0] = 1.0
"""


@pytest.fixture
def large_file(tmp_path):
    x = torch.zeros(2**16, _SIZE // 2**18)
    x[-1, 0] = 7
    torch.save(
        {"x": x, "names": ["a"], "none": torch.zeros(0), "last": torch.ones(3)},
        path := (tmp_path / "large.pt"),
    )
    return path


def _run_limited(*arguments):
    script = _LIMITED.format(room=_SIZE // 2)
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


@pytest.mark.full
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
def test_file_larger_than_the_limit_of_the_process_is_read(large_file):
    done = _run_limited(large_file)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("read (65536, 1024)")


@pytest.mark.full
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
def test_file_larger_than_the_limit_cannot_be_changed_by_its_tensors(large_file):
    before = large_file.read_bytes()
    done = _run_limited(large_file, "write")
    assert "read" in done.stdout
    assert done.returncode < 0  # by a signal
    assert large_file.read_bytes() == before


def test_shared_mapping_holds_the_same(tmp_path, monkeypatch):
    content = {"x": torch.arange(6.0).view(2, 3), "deep": [{"y": torch.tensor([1, 2])}], "n": 3}
    torch.save(content, tmp_path / "a.pt")
    load, asked = torch.load, []

    def refusing(*args, **kwargs):
        asked.append(torch.serialization.get_default_mmap_options())
        if len(asked) == 1:
            raise RuntimeError("unable to mmap 99 bytes from file <a.pt>: Cannot allocate memory")
        return load(*args, **kwargs)

    monkeypatch.setattr(torch, "load", refusing)
    found = load_mapped(tmp_path / "a.pt")
    assert found["x"].equal(content["x"])
    assert found["deep"][0]["y"].tolist() == [1, 2]
    assert found["n"] == 3
    assert asked[0] != asked[1]
    assert torch.serialization.get_default_mmap_options() == asked[0]


def test_private_mapping_may_be_written_to(tmp_path):
    torch.save({"x": torch.zeros(4)}, tmp_path / "a.pt")
    found = read_torch_file(tmp_path / "a.pt", mmap=True)
    found["x"][0] = 5
    assert read_torch_file(tmp_path / "a.pt", mmap=True)["x"].tolist() == [0, 0, 0, 0]


def test_other_errors_are_not_caught(tmp_path, monkeypatch):
    def failing(*args, **kwargs):
        raise RuntimeError("no such thing")

    monkeypatch.setattr(torch, "load", failing)
    with pytest.raises(RuntimeError, match="no such thing"):
        load_mapped(tmp_path / "a.pt")
