import re
import tracemalloc

import numpy as np
import pytest

pytest.importorskip("h5py", reason="needs the extra 'io'")

import h5py

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import read_hdf5, write_hdf5
from torch_geometric_tactile.io.recording_hdf5 import read_hdf5_head

TEN = 10 * np.ones((1, 4, 3))


@pytest.fixture
def path(tmp_path):
    write_hdf5(Recording([0.5], TEN, privileged={"p": [1]}), tmp_path / "a.h5")
    return tmp_path / "a.h5"


@pytest.fixture
def make(tmp_path):
    """Writes a file of version 1 with other data sets: ``make(tactile=...)``."""

    def write(num_frames=1, **contents):
        path = tmp_path / "b.h5"
        with h5py.File(path, "w") as file:
            file.attrs.update(format="tactile recording", version=1, num_frames=num_frames)
            file.attrs.update(label="null", meta="{}")
            for name, content in ({"time": [0.5], "tactile": TEN} | contents).items():
                if callable(content):
                    content(file, name)
                else:
                    file[name] = content
        return path

    return write


def refuses(path, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_hdf5(path)
    assert f"'{path}'" in str(caught.value)


def link(target):
    def change(file, name):
        file[name] = target

    return change


def virtual(file, name):
    source = h5py.VirtualSource("elsewhere.h5", "tactile", shape=(1, 4, 3))
    layout = h5py.VirtualLayout(shape=(1, 4, 3), dtype="f4")
    layout[:] = source
    file.create_virtual_dataset(name, layout)


def external(file, name):
    file.create_dataset(name, (1, 4, 3), "f4", external=[("elsewhere.raw", 0, 48)])


def named_type(file, name):
    file["type"] = np.dtype("f4")
    file.create_dataset(name, (1, 4, 3), file["type"])


def lzf(file, name):
    file.create_dataset(name, data=TEN, compression="lzf")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (link(h5py.ExternalLink("elsewhere.h5", "/tactile")), r"'tactile' itself .*ExternalLink"),
        (link(h5py.SoftLink("/time")), r"'tactile' itself \(got a SoftLink"),
        (virtual, r"'tactile' itself \(got a virtual or external array"),
        (external, r"'tactile' itself \(got a virtual or external array"),
        (named_type, r"numbers, booleans or strings in 'tactile' \(got a named type\)"),
        (lambda f, n: f.create_group(n), r"must hold an array in 'tactile' \(got <HDF5 group"),
        (lambda f, n: f.__setitem__(n, np.dtype("f4")), r"must hold an array in 'tactile'"),
        (h5py.Empty("f4"), r"must hold an array in 'tactile'"),
        (np.zeros((1, 4, 3), complex), r"numbers, booleans or strings in 'tactile'"),
        (np.zeros((1, 4, 3), np.longdouble), r"numbers, booleans or strings in 'tactile'"),
        (np.zeros((1, 4, 3), [("a", "f4")]), r"numbers, booleans or strings in 'tactile'"),
        (np.zeros((1, 4, 3), "V4"), r"numbers, booleans or strings in 'tactile'"),
        (lzf, r"by gzip or not at all \(got the filter 32000 in 'tactile'\)"),
    ],
)
def test_tactile_must_be_an_array_of_numbers_in_the_file_itself(content, message, make):
    refuses(make(tactile=content), message)


@pytest.mark.parametrize("kind", ["privileged", "extra"])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (link(h5py.ExternalLink("elsewhere.h5", "/")), r"'{}' itself .*ExternalLink"),
        (np.zeros(1), r"must hold a group in '{}'"),
        (lambda f, n: f.create_group(f"{n}/p"), r"an array in '{}/p'"),
        (
            lambda f, n: f.create_group(n).__setitem__("p", h5py.ExternalLink("x.h5", "/")),
            r"'{}/p' itself",
        ),
    ],
)
def test_privileged_and_extra_must_be_groups_in_the_file_itself(kind, content, message, make):
    refuses(make(**{kind: content}), message.format(kind))


@pytest.mark.parametrize("value", [3.7, True, -1, [1], "1", h5py.Empty("i8")])
def test_num_frames_must_be_an_integer(value, path):
    with h5py.File(path, "r+") as file:
        file.attrs["num_frames"] = value
    refuses(path, r"must hold an integer of at least 0 in 'num_frames'")


@pytest.mark.parametrize("name", ["label", "meta", "format"])
@pytest.mark.parametrize("value", [3, ["a", "b"], h5py.Empty("S3"), np.array([["{}"]], "S2")])
def test_texts_must_be_texts(name, value, path):
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    refuses(path, rf"must hold one string in '{name}'")


@pytest.mark.parametrize(
    ("name", "value"),
    [("num_frames", 0), ("label", '"box"'), ("meta", '{"a": 1}'), ("checksum", 1)],
)
def test_attributes_must_fit_their_checksum(name, value, path):
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    refuses(path, r"must match its checksum")


def test_arrays_must_be_those_of_the_checksum(path):
    with h5py.File(path, "r+") as file:
        del file["privileged/p"]
    refuses(path, r"must match its checksum")


def test_version_2_must_have_checksums(path):
    with h5py.File(path, "r+") as file:
        del file["tactile"]
        file["tactile"] = TEN.astype(np.float32)
    refuses(path, r"must have checksums in 'tactile' \(got none\)")


def huge(shape, **options):
    def create(file, name):
        file.create_dataset(name, shape, "f4", **options)

    return create


@pytest.mark.parametrize(
    ("num_frames", "tactile", "message"),
    [
        (10**12, huge((10**12, 4, 3), chunks=(64, 4, 3)), r"must hold 1000000000000 frames in 'ta"),
        (10**12, huge((10**12, 4, 3)), r"must hold 1000000000000 frames in 'tactile'.*got 0 bytes"),
        (1, huge((1, 10**6, 10**6), chunks=(1, 10, 10)), r"must hold 1 frames in 'tactile'"),
        (1, huge((1, 2**20, 2**9), chunks=(1, 2**20, 2**9)), r"chunks of at most 1073741824 byt"),
    ],
)
def test_claimed_sizes_are_checked_before_memory_is_taken(num_frames, tactile, message, make):
    path = make(
        num_frames, tactile=tactile, time=huge((num_frames,), chunks=(min(num_frames, 64),))
    )
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"b.h5' must h(old|ave)"):
            read_hdf5(path)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


def test_head_of_a_huge_claim_takes_no_memory(make):
    path = make(10**12, tactile=huge((10**12, 4, 3), chunks=(64, 4, 3)), time=huge((10**12,)))
    assert read_hdf5_head(path).num_taxels == 4


def test_bomb_is_refused_unless_allowed(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    write_hdf5(Recording(np.arange(4096.0), np.zeros((4096, 100, 3))), path)
    size = path.stat().st_size
    total = 4096 * (300 * 4 + 8)
    assert total > 100 * size
    assert read_hdf5(path).num_frames == 4096
    monkeypatch.setattr("torch_geometric_tactile.io._hdf5_checks.ARRAY_BYTES", 2**20)
    with pytest.raises(
        ValueError, match=rf"no more than {100 * size} bytes in memory \(got (\d+), "
    ) as caught:
        read_hdf5(path)
    needed = int(re.search(r"'max_bytes=(\d+)'", str(caught.value))[1])
    assert read_hdf5(path, max_bytes=needed).num_frames == 4096
    with pytest.raises(ValueError, match=r"a.h5' must take no more than"):
        read_hdf5(path, max_bytes=needed - 1)


def test_many_long_texts_of_version_1_are_bounded(make):
    def texts(file, name):
        stored = file.create_dataset(name, (50,), h5py.string_dtype())
        stored[:] = "x" * 100_000

    path = make(
        50,
        time=np.arange(50.0),
        tactile=np.zeros((50, 4, 3)),
        **{"privileged/word": texts},
    )
    assert read_hdf5(path).privileged["word"][49] == "x" * 100_000
    with pytest.raises(ValueError, match=r"b.h5' .*strings must take no more than 1000000 bytes"):
        read_hdf5(path, max_bytes=1_000_000)
