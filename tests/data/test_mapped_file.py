import subprocess
import sys

import pytest
import torch

from torch_geometric_tactile.data._mapped_file import load_mapped
from torch_geometric_tactile.data._torch_file import read_torch_file

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


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
def test_file_larger_than_the_limit_of_the_process_is_read(large_file):
    done = _run_limited(large_file)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("read (65536, 1024)")


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
