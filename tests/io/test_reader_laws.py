"""Laws of all readers of files; their whole files are those that the fuzz run starts from."""

# ruff: noqa: E402
import inspect
import os
import re
from pathlib import Path

import pytest

for extra in ("yaml", "h5py", "PIL", "lightning", "mcap", "google.protobuf", "pyarrow", "scipy"):
    pytest.importorskip(extra, reason="needs the extras 'io', 'lerobot', 'live' and 'train'")

from fuzz import lerobot_sets, readers
from fuzz.laws import ALLOWED, equal
from fuzz.run import attack, preload
from fuzz.targets import TARGETS

from torch_geometric_tactile import io

OF_OTHER_FOLDERS = ("predictor", "checkpoint", "configuration", "table", "run")
STREAMS = [target for target in TARGETS if target.name.startswith("stream: ")]
FILES = [target for target in TARGETS if target.name != "XELA live" and target not in STREAMS]
FILES = [target for target in FILES if not target.name.startswith(OF_OTHER_FOLDERS)]

# The reader of the fuzz run itself takes the name of the file, or the folder that it is in.
NOT_BY_TEXT = ("uSkin", "Sparsh", "eFlesh", "matrix", "annotations", "labels")

DAMAGES = {
    "empty": lambda content: b"",
    "truncated": lambda content: content[: len(content) // 2],
    "text": lambda content: b"no such file\n",
}

# A damaged MCAP file may be read as far as it is whole, and LeRobot has several files.
DAMAGEABLE = [target for target in FILES if target.name not in ("recovered MCAP", "LeRobot")]
EACH = {
    "argnames": ("target", "whole"),
    "argvalues": [(target, target) for target in DAMAGEABLE],
    "ids": [target.name for target in DAMAGEABLE],
    "indirect": ["whole"],
}


@pytest.fixture
def whole(request, tmp_path):
    """A whole file of a reader."""
    request.param.make(tmp_path)
    return max(path for path in tmp_path.glob(f"*{request.param.suffix}") if path.is_file())


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_names_the_file(target, path):
    is_alone = target.names_file and not target.suffix  # and not one of several of a folder
    name = re.escape(str(path if is_alone else path.parent))
    with pytest.raises((ValueError, OSError), match=name):
        target.read(path)


def test_every_public_reader_is_attacked():
    sources = inspect.getsource(readers) + inspect.getsource(lerobot_sets)
    calls = {"read_samples_npz": "SamplesFile", "read_sparsh_skin": "_read_touch"}  # that read it
    names = [name for name in io.__all__ if name.startswith("read_")]
    assert "read_recording" in names
    assert [name for name in names if f"{calls.get(name, name)}(" not in sources] == []


@pytest.mark.parametrize(**EACH)
def test_reading_changes_no_file_and_a_path_may_be_a_text(target, whole):
    before = contents(whole.parent)
    reading = target.read(whole)
    assert contents(whole.parent) == before
    if not target.name.startswith(NOT_BY_TEXT):
        assert equal(target.read(str(whole)), reading)


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize(**EACH)
def test_errors_name_the_file_that_is_damaged(target, whole, damage):
    whole.write_bytes(DAMAGES[damage](whole.read_bytes()))
    assert_names_the_file(target, whole)


@pytest.mark.parametrize(**EACH)
def test_errors_name_the_file_that_is_missing_or_a_folder(target, whole):
    whole.unlink()
    assert_names_the_file(target, whole)
    whole.mkdir()
    assert_names_the_file(target, whole)


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs users of a POSIX system")
@pytest.mark.parametrize(**EACH)
def test_errors_name_the_file_that_may_not_be_read(target, whole, monkeypatch):
    target.read(whole)  # imports libraries, which another user may not read either
    monkeypatch.chdir(whole.parent)
    whole.parent.chmod(0o755)
    whole.chmod(0)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        with pytest.raises((ValueError, OSError), match=re.escape(whole.name)):
            target.read(Path(whole.name))
    finally:
        os.seteuid(user)


@pytest.mark.filterwarnings("ignore")
def test_mutated_files_and_streams_are_read_right_or_refused():
    """The first cases of each reader in a run of ``tests/fuzz``."""
    preload()
    targets = [*FILES, *STREAMS]
    results = attack(targets, range(15 * len(targets)), seconds=20)
    failures = [
        (targets[case % len(targets)].name, case, result)
        for case, result in results
        if result.outcome not in ALLOWED
    ]
    assert failures == []
