import copy
import importlib
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import torch
from torch_geometric.transforms import BaseTransform, Compose, Distance

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.data._processed_dataset import ProcessedDataset
from torch_geometric_tactile.data._processed_file import read_processed
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import KNNGraph


class Binned(StaticDataset):
    """Readings whose number of channels is an argument."""

    selection_args = ("part",)
    reads = 0

    def __init__(self, name, bins=13, part=None, layout=None, root=None, **kwargs):
        self.bins = bins
        self.layout = grid(2, 2, pitch=0.01) if layout is None else layout
        super().__init__(root, **kwargs)

    @property
    def processed_file_names(self):
        return "binned.pt"

    def read(self):
        type(self).reads += 1
        return StaticData(x=torch.ones(3, 4, self.bins), pos=self.layout.pos), {}


@pytest.fixture
def binned(tmp_path):
    Binned.reads = 0
    return partial(Binned, root=tmp_path)


def messages(caplog):
    found = [record.getMessage() for record in caplog.records]
    caplog.clear()
    return [text.split(" again: ")[1] for text in found]


def test_other_arguments_are_processed_again(binned, caplog):
    assert binned("a", bins=13).data.x.shape == (3, 4, 13)
    assert binned("b", bins=5).data.x.shape == (3, 4, 5)
    assert messages(caplog) == ["name: 'a' -> 'b', bins: 13 -> 5"]
    assert binned("b", 5).data.x.shape == (3, 4, 5)  # the same argument by position
    assert Binned.reads == 2
    assert messages(caplog) == []


def test_default_is_the_argument_given(binned, caplog):
    binned("a")
    binned("a", bins=13)
    assert Binned.reads == 1


def test_arguments_that_select_are_no_part(binned, caplog):
    binned("a", part="train", transform=Distance())
    binned("a", part="test")
    assert Binned.reads == 1
    assert messages(caplog) == []


def test_other_class_is_processed_again(binned, tmp_path, caplog):
    class Other(Binned):
        pass

    binned("a")
    Other("a", root=tmp_path)
    (text,) = messages(caplog)
    assert text.startswith("class: ")
    assert ".Binned[source " in text


def test_other_layout_is_processed_again(binned, caplog):
    binned("a")
    assert binned("a", layout=grid(2, 2, pitch=0.02)).data.pos.max() == pytest.approx(0.02)
    (text,) = messages(caplog)
    assert text.startswith("layout: TaxelLayout('grid_2x2', ")


@pytest.mark.parametrize(
    ("before", "now", "change"),
    [
        (KNNGraph(k=1), KNNGraph(k=2), "pre_transform: "),
        (None, KNNGraph(k=2), "pre_transform: None -> "),
        (Compose([KNNGraph(k=2)]), Compose([KNNGraph(k=2), Distance()]), "pre_transform: "),
        (Distance(norm=False), Distance(), "pre_transform: "),
    ],
)
def test_other_pre_transform_is_processed_again(binned, caplog, before, now, change):
    if isinstance(before, Distance):
        before, now = Compose([KNNGraph(k=1), before]), Compose([KNNGraph(k=1), now])
    binned("a", pre_transform=before)
    found = binned("a", pre_transform=now)
    expected = Binned("a", pre_transform=now)
    assert found[0].edge_index.equal(expected[0].edge_index)
    assert found[0].get("edge_attr") is None or found[0].edge_attr.equal(expected[0].edge_attr)
    (text,) = messages(caplog)
    assert text.startswith(change)


def test_other_pre_filter_is_processed_again(binned, caplog):
    def threshold(least):
        return lambda data: float(data.x.sum()) >= least

    binned("a", pre_filter=threshold(1))
    binned("a", pre_filter=threshold(1))
    assert Binned.reads == 1
    binned("a", pre_filter=threshold(2))
    assert Binned.reads == 2
    binned("a", pre_filter=lambda data: True)
    assert Binned.reads == 3
    assert [text.split(":")[0] for text in messages(caplog)] == ["pre_filter"] * 2


class Cached(BaseTransform):
    def __init__(self, k):
        self.k = k
        self._cache = None

    def forward(self, data):
        self._cache = data.pos
        return data

    def __getstate__(self):
        return {"k": self.k}


def test_transform_that_has_been_used_is_the_same(binned):
    transform = Cached(2)
    binned("a", pre_transform=transform)
    assert transform._cache is not None
    binned("a", pre_transform=transform)
    binned("a", pre_transform=Cached(2))
    assert Binned.reads == 1
    binned("a", pre_transform=Cached(3))
    assert Binned.reads == 2


def test_biotac_sp_with_other_edges(write_bts3, tmp_path, caplog):
    write_bts3(tmp_path / "raw")
    for k, num_edges in ((2, 62), (5, None), (2, 62)):
        dataset = BioTacSP(tmp_path, checksum=False, pre_transform=KNNGraph(k=k))
        expected = KNNGraph(k=k)(dataset[0]).edge_index
        assert dataset[0].edge_index.equal(expected)
        assert num_edges in (None, dataset[0].num_edges)
    assert len(messages(caplog)) == 2
    for split in ("train", "test", "all"):
        BioTacSP(tmp_path, split=split, checksum=False, pre_transform=KNNGraph(k=2))
    assert messages(caplog) == []


class Numbered(Binned):
    """One that is read from a file."""

    def __init__(self, bins=1, root=None):
        super().__init__("numbered", bins, root=root)

    @property
    def raw_file_names(self):
        return ["a.txt"]

    def raw_state(self):
        return [f"a.txt={Path(self.raw_paths[0]).stat().st_size}"]

    def read(self):
        data, names = super().read()
        data.x = data.x * len(Path(self.raw_paths[0]).read_text())
        return data, names


@pytest.fixture
def raw(tmp_path):
    path = tmp_path / "raw" / "a.txt"
    path.parent.mkdir()
    path.write_text("1")
    Numbered.reads = 0
    return path


def test_changed_raw_file_is_processed_again(raw, tmp_path, caplog):
    Numbered(root=tmp_path)
    raw.write_text("12")
    assert Numbered(root=tmp_path).data.x.max() == 2
    assert messages(caplog) == ["'a.txt' was changed"]


def test_raw_file_that_changes_while_it_is_read_is_read_again(raw, tmp_path, monkeypatch, caplog):
    read = Numbered.read

    def and_change(self):
        found = read(self)
        raw.write_text("123")
        return found

    with monkeypatch.context() as patch:
        patch.setattr(Numbered, "read", and_change)
        assert Numbered(root=tmp_path).data.x.max() == 1
    assert Numbered(root=tmp_path).data.x.max() == 3


def test_processed_file_without_raw_files_is_used(raw, tmp_path):
    Numbered(root=tmp_path)
    raw.unlink()
    assert len(Numbered(root=tmp_path)) == 3
    assert Numbered.reads == 1


def test_processed_file_of_other_settings_without_raw_files(raw, tmp_path):
    Numbered(root=tmp_path)
    raw.unlink()
    with pytest.raises(ValueError, match=r"cannot be used \(bins: 1 -> 2\), and the raw"):
        Numbered(2, root=tmp_path)
    assert len(Numbered(root=tmp_path)) == 3


def test_nothing_is_downloaded_for_a_processed_file(raw, tmp_path):
    class Remote(Numbered):
        downloads = 0

        def download(self):
            type(self).downloads += 1
            raw.write_text("1")

    raw.unlink()
    Remote(root=tmp_path)
    raw.unlink()
    Remote(root=tmp_path)
    assert Remote.downloads == 1
    Remote(2, root=tmp_path)
    assert Remote.downloads == 2


def test_another_process_with_other_settings_is_noticed(binned, tmp_path, monkeypatch):
    read = Binned.read

    def while_another_writes(self):
        monkeypatch.setattr(Binned, "read", read)
        found = read(self)
        save = torch.save

        def save_and_lose(content, path):
            save(content, path)
            monkeypatch.setattr(torch, "save", save)

        monkeypatch.setattr(torch, "save", save_and_lose)
        return found

    monkeypatch.setattr(Binned, "read", while_another_writes)
    replace = os.replace

    def replace_twice(source, target):
        replace(source, target)
        monkeypatch.setattr(os, "replace", replace)
        Binned("b", root=tmp_path, force_reload=True)

    monkeypatch.setattr(os, "replace", replace_twice)
    with pytest.raises(
        RuntimeError, match=r"another process has meanwhile written .*name: 'b' -> 'a'"
    ):
        binned("a")


def process_often(root):
    for _ in range(20):
        assert Binned("a", root=root, force_reload=True).data.x.sum() == 156


@pytest.mark.full
def test_two_processes_at_once(binned, tmp_path):
    # New processes: a fork of one in which PyTorch has used threads may wait for ever.
    # Its source is in a file: without one, the count of `reads` is a constant of the class.
    code = f"import sys; import {__name__} as module; module.process_often(sys.argv[1])"
    command = [sys.executable, "-c", code, str(tmp_path)]
    folder = Path(__file__).parents[2]
    children = [subprocess.Popen(command, cwd=folder) for _ in range(2)]
    assert [child.wait(timeout=240) for child in children] == [0, 0]
    assert [path.name for path in (tmp_path / "processed").iterdir()] == ["binned.pt"]


def test_arguments_are_kept_no_longer_than_needed(tmp_path):
    class Large(Binned):
        def __init__(self, *arrays, root=None):
            super().__init__("large", root=root)

    for root in (None, tmp_path):
        array = torch.zeros(100)
        dataset = Large(array, root=root)
        assert sys.getrefcount(array) == 2, root
    (torch_file,) = (tmp_path / "processed").iterdir()
    settings = read_processed(torch_file).settings
    assert list(settings) == ["class", "arrays", "layout", "pre_transform", "pre_filter"]
    assert settings["arrays"].startswith("(tensor(torch.float32, (100,), ")
    assert copy.copy(dataset).data.x.equal(dataset.data.x)


class Listed(Binned):
    raw_file_names = ()


def test_no_raw_file_is_named_though_settings_change(tmp_path):
    Listed("a", root=tmp_path)
    with pytest.raises(ValueError, match=r"are missing in .* \('raw_file_names' is empty: leave"):
        Listed("b", root=tmp_path)
    Binned("a", root=tmp_path / "other")
    assert len(Binned("b", root=tmp_path / "other")) == 3  # as it says


@pytest.mark.parametrize("name", ["save", "load", "collate"])
def test_methods_of_pygs_in_memory_data_sets_name_ours(binned, name):
    dataset = binned("a")
    with pytest.raises(
        AttributeError, match=rf"no attribute '{name}', .* define 'read' in place of"
    ):
        getattr(dataset, name)
    with pytest.raises(AttributeError, match=r"has no attribute 'other'$"):
        _ = dataset.other


OWN = """
from torch_geometric_tactile.data import StaticData, StaticDataset
from own_helpers import scaled

class OwnSet(StaticDataset):
    processed_file_names = "own.pt"

    def __init__(self, root, layout, **kwargs):
        self.layout = layout
        super().__init__(root, **kwargs)

    def read(self):
        return StaticData(x=scaled(torch.ones(3, 4, 1)), pos=self.layout.pos), {{}}
"""
HELPERS = "GAIN = {gain}\ndef scaled(x):\n    return GAIN * x\n"


@pytest.fixture
def own_set(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "own_set.py").write_text("import torch\n" + OWN.format())

    def load(gain, **arguments):
        (tmp_path / "own_helpers.py").write_text(HELPERS.format(gain=gain))
        for name in ("own_set", "own_helpers"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        kind = importlib.import_module("own_set").OwnSet
        return kind(tmp_path / "root", grid(2, 2, pitch=0.01), **arguments)

    yield load
    for name in ("own_set", "own_helpers"):
        sys.modules.pop(name, None)


def test_edited_constant_of_an_own_data_set_is_processed_again(own_set, caplog):
    assert own_set(1.0).x.unique() == 1
    assert own_set(1.0).x.unique() == 1
    assert messages(caplog) == []
    assert own_set(10.0).x.unique() == 10
    (text,) = messages(caplog)
    assert text.startswith("class: own_set.OwnSet[source ")


def test_edited_code_without_raw_files_is_told(own_set, caplog, monkeypatch):
    own_set(1.0)
    monkeypatch.setattr(ProcessedDataset, "raw_file_names", (), raising=False)
    assert own_set(10.0).x.unique() == 1  # they cannot be made again
    assert "was processed by different code (class: own_set.OwnSet[source " in caplog.text
    with pytest.raises(ValueError, match=r"cannot be used \(class: .*pre_transform: None -> "):
        own_set(10.0, pre_transform=KNNGraph(k=2))
