import errno
import io
import os
from pathlib import Path

import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import RandomJitter

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._processed_file import (
    OtherFormatError,
    _is_view,
    read_processed,
    save_static,
)
from torch_geometric_tactile.transforms import KNNGraph


def files(folder):
    return sorted(path.name for path in Path(folder).rglob("*") if path.is_file())


@pytest.fixture
def raw_toy(toy, tmp_path):
    """The class of a small data set that is read from a raw file, which says by how much."""

    class RawToy(toy):
        @property
        def raw_file_names(self):
            return ["a.txt"]

        def raw_state(self):
            return [f"a.txt={Path(self.raw_paths[0]).read_text()}"]

        def read(self):
            data, names = super().read()
            data.x = data.x + float(Path(self.raw_paths[0]).read_text())
            return data, names

    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "a.txt").write_text("1")
    return RawToy


def test_processed_file_is_read_the_second_time(toy, tmp_path):
    first, second = toy(tmp_path), toy(tmp_path)
    assert toy.reads == 1
    assert second.data.x.equal(first.data.x)
    assert second.class_names == first.class_names
    assert second.data.to_dict().keys() == first.data.to_dict().keys()
    assert files(tmp_path) == ["toy.pt"]


def test_force_reload_reads_again(toy, tmp_path):
    toy(tmp_path)
    assert toy(tmp_path, force_reload=True, pre_transform=KNNGraph(k=3))[0].num_edges == 12
    assert toy.reads == 2


def test_force_reload_under_an_open_dataset(toy, tmp_path):
    dataset = toy(tmp_path)
    toy(tmp_path, force_reload=True, pre_filter=lambda data: int(data.y) == 1)
    assert dataset.data.x.equal(torch.arange(48.0).view(6, 4, 2))


def test_processed_file_is_memory_mapped(toy, tmp_path, monkeypatch):
    asked = []
    load = torch.load

    def spy(*args, **kwargs):
        asked.append(kwargs)
        return load(*args, **kwargs)

    toy(tmp_path)
    monkeypatch.setattr(torch, "load", spy)
    dataset = toy(tmp_path)
    assert {"map_location": "cpu", "mmap": True, "weights_only": True} in asked
    maps = Path("/proc/self/maps")
    if maps.exists():
        address = dataset.data.x.data_ptr()
        held = [line for line in maps.read_text().splitlines() if line.endswith("toy.pt")]
        ranges = [[int(end, 16) for end in line.split()[0].split("-")] for line in held]
        assert any(start <= address < stop for start, stop in ranges)


def test_processed_file_is_untouched_by_edits_in_memory(toy, tmp_path):
    toy(tmp_path).data.x.zero_()
    assert toy(tmp_path).data.x.sum() > 0


@pytest.mark.parametrize("keep", [0, 0.5])
def test_cut_processed_file_says_what_to_do(toy, tmp_path, keep):
    path = Path(toy(tmp_path).processed_paths[0])
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    reason = "is empty" if keep == 0 else "cannot be read"
    with pytest.raises(ValueError, match=rf"toy\.pt' {reason}; delete it or .*force_reload=True"):
        toy(tmp_path)
    assert len(toy(tmp_path, force_reload=True)) == len(toy(tmp_path)) == 6


@pytest.mark.parametrize(
    "content", [{"format": 2}, {"format": torch.tensor([3, 3])}, {}, [1, 2], torch.zeros(3)]
)
def test_processed_file_of_another_format_is_made_again(toy, tmp_path, caplog, content):
    path = Path(toy(tmp_path).processed_paths[0])
    torch.save(content, path)
    with pytest.raises(OtherFormatError, match="is not in format 3; delete it"):
        read_processed(path)
    assert len(toy(tmp_path)) == 6
    assert toy.reads == 2
    (record,) = caplog.records
    assert record.getMessage() == (
        f"processing '{path}' again: it was written by another version of torch_geometric_tactile"
    )
    toy(tmp_path)
    assert toy.reads == 2


def test_processed_file_of_another_format_without_raw_files(raw_toy, tmp_path):
    dataset = raw_toy(tmp_path)
    torch.save({"format": 1}, dataset.processed_paths[0])
    (tmp_path / "raw" / "a.txt").unlink()
    with pytest.raises(
        ValueError, match=r"cannot be used \(it was written by another version.*missing in"
    ):
        raw_toy(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("attributes", [1], "TypeError"),
        ("attributes", {}, "'x' must be a tensor of numbers"),
        (
            "attributes",
            {"x": torch.zeros(2, 2, 2, dtype=torch.long)},
            "'x' must be a tensor of num",
        ),
        ("attributes", {"x": torch.zeros(2, 2, 2), 3: 4}, "keywords must be strings"),
        ("schema", {"node": 3}, "TypeError"),
        ("schema", {"other": ()}, "other|'x'"),
        ("names", [1], "AttributeError"),
        ("names", {"class": "ab"}, "names must be lists of texts"),
        ("settings", {"class": 3}, "settings must be texts"),
        ("raw_state", "text", "names must be lists of texts"),
    ],
)
def test_processed_file_with_other_types_is_refused(toy, tmp_path, key, value, message):
    path = Path(toy(tmp_path).processed_paths[0])
    content = torch.load(path, weights_only=True)
    torch.save({**content, key: value}, path)
    with pytest.raises(ValueError, match=rf"toy\.pt' holds no samples \(.*{message}.*; delete it"):
        toy(tmp_path)
    del content[key]
    torch.save(content, path)
    with pytest.raises(ValueError, match=rf"toy\.pt' holds no samples \(KeyError: '{key}'\)"):
        toy(tmp_path)


def test_processed_file_with_a_flipped_bit_is_refused(toy, tmp_path):
    path = Path(toy(tmp_path).processed_paths[0])
    content, expected = path.read_bytes(), read_processed(path)
    for place in range(0, 8 * len(content), 997):
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        path.unlink()  # others may have it mapped
        path.write_bytes(flipped)
        try:
            data, *texts = read_processed(path)
        except ValueError:
            continue
        assert all(value.equal(data[key]) for key, value in expected.data.to_dict().items())
        assert texts == [*expected[1:]]


def test_what_was_written_is_checked(toy, tmp_path, monkeypatch):
    save = torch.save

    def broken(content, file):
        kept = io.BytesIO()
        save(content, kept)
        file.write(kept.getvalue().replace(torch.ones(1).numpy().tobytes(), b"\0\0\0\0", 1))

    monkeypatch.setattr(torch, "save", broken)
    with pytest.raises(ValueError, match="is damaged or truncated"):
        toy(tmp_path)
    assert files(tmp_path) == []


@pytest.mark.parametrize("half", [b"", b"PK half of a file"])
def test_failure_while_saving_leaves_no_file(toy, tmp_path, monkeypatch, half):
    def fail(content, file):
        file.write(half)
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(torch, "save", fail)
        with pytest.raises(OSError, match="no space left"):
            toy(tmp_path)
    assert files(tmp_path) == []
    assert len(toy(tmp_path)) == 6


def test_failure_while_reading_leaves_the_old_file(toy, tmp_path):
    toy(tmp_path)

    def fail(data):
        raise RuntimeError("broken transform")

    with pytest.raises(RuntimeError, match="broken transform"):
        toy(tmp_path, force_reload=True, pre_transform=fail)
    assert files(tmp_path) == ["toy.pt"]
    assert len(toy(tmp_path)) == 6


def test_save_and_load_keep_what_is_shared(tmp_path):
    data = StaticData(
        x=torch.rand(2, 3, 1),
        pos=torch.rand(3, 3),
        bias=torch.rand(3),
        gain=torch.rand(2),
        mask=torch.rand(2, 3),
        note="dry",
        node=["bias", "mask"],
        shared=["bias", "gain"],
    )
    save_static(data, {"class": ["a"]}, tmp_path / "a.pt")
    loaded, names = read_processed(tmp_path / "a.pt")[:2]
    assert names == {"class": ["a"]}
    for key in data.keys():  # noqa: SIM118
        assert loaded.is_shared(key) == data.is_shared(key), key
        assert loaded.level(key) == data.level(key), key
    assert loaded.index_select(torch.tensor([0, 1, 0])).sample(0).bias.shape == (3,)


def test_transform_that_moves_taxels_works_on_a_loaded_file(toy, tmp_path):
    batch = toy(tmp_path, transform=RandomJitter(0.001)).batch([0, 1])
    assert batch.pos.shape == (2, 4, 3)
    assert batch.sample(0).pos.shape == (4, 3)


def test_save_writes_views_without_their_storage(tmp_path):
    whole = StaticData(x=torch.rand(1000, 10, 10))
    save_static(whole.index_select(slice(0, 1)), {}, tmp_path / "a.pt")
    assert os.path.getsize(tmp_path / "a.pt") < 10_000


def test_only_what_would_drag_a_storage_along_is_copied_to_be_saved():
    x = torch.rand(4, 3)
    assert not any(map(_is_view, (x, x.t(), x.long(), "text")))
    assert all(map(_is_view, (x[:2], x.to_sparse(), torch.nn.Parameter(x))))


def test_reading_removes_what_a_killed_second_process_left(tmp_path):
    path = tmp_path / "a.pt"
    save_static(StaticData(x=torch.ones(2, 3, 1)), {}, path)
    (tmp_path / ".a.pt.1.tmp").write_bytes(b"half")
    read_processed(path)
    assert files(tmp_path) == ["a.pt"]


def test_full_disk_is_an_error_about_the_file_and_not_one_of_torch(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    save_static(StaticData(x=torch.ones(2, 3, 1)), {}, path)
    before = path.read_bytes()

    class Full(io.FileIO):
        def write(self, data):
            raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(io, "FileIO", Full)
    with pytest.raises(OSError, match=r"No space left on device: '.*a\.pt'"):
        save_static(StaticData(x=torch.ones(2000, 300, 1)), {}, path)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert files(tmp_path) == ["a.pt"]


def test_samples_without_an_attribute_of_their_own_are_counted_in_the_file(tmp_path):
    samples = [Data(edge_index=torch.tensor([[0, 1], [1, 0]]), num_nodes=2)] * 4
    save_static(StaticData.from_data_list(samples), {}, tmp_path / "a.pt")
    assert read_processed(tmp_path / "a.pt").data.num_samples == 4


@pytest.mark.parametrize("number", [3, True])
def test_other_numbers_of_samples_in_the_file_are_refused(tmp_path, number):
    save_static(StaticData(x=torch.zeros(2, 2, 1)), {}, tmp_path / "a.pt")
    content = torch.load(tmp_path / "a.pt", weights_only=True)
    torch.save(content | {"num_samples": number}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match=r"a\.pt' holds no samples"):
        read_processed(tmp_path / "a.pt")
