import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import pickle
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch

from torch_geometric_tactile.data import Protocol, StaticData, StaticDataset, Windows
from torch_geometric_tactile.datasets import AllegroUSkin, FakeTactileDataset
from torch_geometric_tactile.experiments import source as data_source
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments.source import DataFacts, DataSource
from torch_geometric_tactile.sensors import grid

ALLEGRO = "torch_geometric_tactile.datasets.AllegroUSkin"
FAKE = "torch_geometric_tactile.datasets.FakeTactileDataset"


class OwnDataset(StaticDataset):
    """A data set of a user's own, in memory."""

    def __init__(self, offset=0.0):
        self.layout = grid(1, 2, pitch=0.01)
        self.offset = offset
        super().__init__(None)

    def read(self):
        return StaticData(
            x=torch.arange(12.0).view(6, 2, 1) + self.offset, y=torch.arange(6) % 2
        ), {}


def test_own_class_in_memory(monkeypatch):
    import sys
    import types

    module = types.ModuleType("my_glove")
    module.OwnDataset = OwnDataset
    monkeypatch.setitem(sys.modules, "my_glove", module)
    source, facts = DataSource("my_glove.OwnDataset").resolve()
    assert (facts.num_samples, facts.num_trials, facts.num_classes) == (6, 0, 2)
    assert (source.kind, source.caption) == ("ours", "Your own recordings: 6 samples.")
    train, test = source.parts(Protocol("frame", folds=3), 0, 2)
    assert (len(train), len(test)) == (4, 2)
    again, _ = DataSource("my_glove.OwnDataset").resolve()
    other, _ = DataSource("my_glove.OwnDataset", {"offset": 1.0}).resolve()
    assert source.fingerprint == again.fingerprint != other.fingerprint


@pytest.mark.parametrize("by", ["trial", "frame"])
@pytest.mark.parametrize("selection", [{}, {"stride": 2}, {"stride": 3, "phases": ["hold"]}])
def test_split_is_that_of_the_data_set_itself(grasps, by, selection):
    source, facts = DataSource(ALLEGRO, {"root": str(grasps), "split": None}, selection).resolve()
    protocol = Protocol(by, val=0.1, test=0.2, stratify="group" if by == "trial" else None)
    for seed in range(3):
        parts = source.parts(protocol, seed, 0)
        for name, part in zip(("train", "test"), parts, strict=True):
            own = AllegroUSkin(grasps, split=name, split_by=by, split_seed=seed, **selection)
            assert part.column("time").equal(own.column("time"))
            assert part.column("trial").equal(own.column("trial"))
    assert facts.num_samples == len(AllegroUSkin(grasps, split=None, **selection))


def test_caption_of_simulated_recordings(grasps, tmp_path):
    source, _ = DataSource(ALLEGRO, {"root": str(grasps), "split": None}).resolve()
    assert source.kind == "simulated"
    assert source.caption == (
        "**Simulated**, not a result of a real hand: 12 trials of `tactile simulate` (objects "
        "`paper8`, seed 7, 0.08 s at 100 Hz, MuJoCo 3.3.0)."
    )
    shutil.copytree(grasps / "raw", tmp_path / "raw")
    elsewhere, _ = DataSource(ALLEGRO, {"root": str(tmp_path), "split": None}).resolve()
    assert elsewhere.caption.endswith("12 trials.")
    assert elsewhere.identity() == source.identity()  # wherever the files lie
    (tmp_path / "raw" / "sponge_003.npz").unlink()
    fewer, _ = DataSource(ALLEGRO, {"root": str(tmp_path), "split": None}).resolve()
    assert fewer.fingerprint != source.fingerprint


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"preset": 5}', "[" * 100_000])
def test_damaged_summary_of_a_simulation_is_named(text, tmp_path):
    (tmp_path / "simulation.json").write_text(text)
    dataset = SimpleNamespace(root=tmp_path)
    with pytest.raises(
        ValueError, match=r"simulation\.json' must be a summary of 'tactile simulate'"
    ):
        data_source._caption(dataset, "simulated", DataFacts(10, 2, 1, 1))


def test_nothing_left_of_a_part():
    source, _ = DataSource(FAKE, {"num_samples": 20}).resolve()
    with pytest.raises(ValueError, match=r"'the given parts' must leave samples to test on"):
        source.parts(Protocol("given"), 0, 0)


@pytest.mark.parametrize(
    ("class_path", "arguments", "message"),
    [
        ("nowhere.Class", {}, r"'class_path' must be the import path of a class.*nowhere\.Class"),
        ("Class", {}, "'class_path' must be the import path of a class"),
        (FAKE, {"stride": 2}, "'stride' must be an argument of FakeTactileDataset: num_samples"),
        ("torch_geometric_tactile.transforms.ZScore", {}, "'class_path' must be a StaticDataset"),
    ],
)
def test_wrong_sources(class_path, arguments, message):
    with pytest.raises(ValueError, match=message):
        DataSource(class_path, arguments).resolve()


def test_objects_inside_of_objects_are_built():
    inner = {
        "class_path": "torch_geometric_tactile.transforms.ZScore",
        "init_args": {"attr": "joint"},
    }
    outer = {
        "class_path": "torch_geometric.transforms.Compose",
        "init_args": {"transforms": [inner]},
    }
    assert repr(build_object(outer).transforms[0]) == "ZScore(attr='joint')"
    assert build_object({"a": [1, None, "b"]}) == {"a": [1, None, "b"]}
    assert np.array_equal(build_object([1, 2]), [1, 2])


def test_windows_are_known_by_the_files_of_their_frames(tmp_path):
    layout = grid(1, 2, pitch=0.01)
    for name in ("a", "b"):
        np.savez(
            tmp_path / f"{name}.npz",
            x=np.arange(12.0).reshape(6, 2, 1),
            y=np.arange(6) // 3,
            trial=np.arange(6) // 3,
        )
    layout.save(tmp_path / "layout.json")

    def source(name, length=2):
        path = "torch_geometric_tactile.datasets.SamplesFile"
        frames = {"path": str(tmp_path / f"{name}.npz"), "layout": str(tmp_path / "layout.json")}
        return DataSource(
            "torch_geometric_tactile.data.Windows",
            {"dataset": {"class_path": path, "init_args": frames}, "length": length},
        ).resolve()

    (first, facts), (second, _), (longer, _) = source("a"), source("b"), source("a", 3)
    assert (facts.num_samples, facts.num_trials) == (4, 2)
    assert first.identity()["arguments"] == second.identity()["arguments"]
    assert first.identity() != longer.identity()
    assert first.load()[0].num_frames == 2


def test_source_is_one_value_for_all_processes(tmp_path):
    trial = np.arange(40) // 20
    np.savez(tmp_path / "a.npz", x=np.ones((40, 2, 3, 1)), y=trial, trial=trial)
    file = "torch_geometric_tactile.datasets.SamplesFile"
    frames = DataSource(file, {"path": str(tmp_path / "a.npz"), "grid": "2x3"}, stride=2)
    source, facts = DataSource(
        "torch_geometric_tactile.data.Windows", {"length": 5}, frames=frames
    ).resolve()
    assert (facts.num_samples, facts.num_frames) == (2 * 6, 5)
    pickled = pickle.loads(pickle.dumps(source))
    assert (pickled, hash(pickled)) == (source, hash(source))
    assert pickled.load() is source.load()  # from the cache
    assert pickled.with_arguments({"time_axis": None}).frames.arguments["time_axis"] is None
    tared = replace(source, frames=replace(frames, tare={"first": 2}))
    assert len({*map(str, (source.identity(), tared.identity(), frames.identity()))}) == 3
    assert not tared.load().batch([0]).x.any()


def test_identity_is_that_of_stored_runs():
    frames = DataSource(FAKE, {"root": "here", "num_samples": 8}, stride=2, tare={"first": 4})
    windows = DataSource("torch_geometric_tactile.data.Windows", {"length": 5}, frames=frames)
    module = "torch_geometric_tactile.experiments.compared_windows"
    strided = {"class_path": FAKE, "init_args": {"num_samples": 8}}
    strided = {
        "class_path": f"{module}.strided_frames",
        "init_args": {"dataset": strided, "stride": 2},
    }
    tared = {"class_path": f"{module}.tared_frames", "init_args": {"dataset": strided, "first": 4}}
    assert windows.identity() == {
        "class_path": "torch_geometric_tactile.data.Windows",
        "arguments": {"length": 5, "dataset": tared},
        "selection": {},
        "fingerprint": "",
    }


@pytest.mark.parametrize(
    ("split", "note"), [("test", " (the part 'test' of the data set)"), (None, "")]
)
def test_facts_say_which_part_the_samples_are(split, note):
    assert DataFacts.from_dataset(FakeTactileDataset(20, split)).part_note == note
    windows = Windows(FakeTactileDataset(20, split), 1)
    assert DataFacts.from_dataset(windows).part == split


def test_fingerprint_is_that_of_tables_and_folders_too(tmp_path):
    for person in ("a", "b"):
        (tmp_path / person).mkdir()
        lines = ["time,s0,s1", *(f"{t / 10},{t},{ord(person)}" for t in range(4))]
        (tmp_path / person / "cup_0.csv").write_text("\n".join(lines) + "\n")
    size = {"rows": 1, "cols": 2, "pitch": 0.01}
    arguments = {
        "root": str(tmp_path),
        "pattern": "{person}/{object}_{trial}",
        "target": "person",
        "layout": {"class_path": "torch_geometric_tactile.sensors.grid", "init_args": size},
    }
    source = DataSource("torch_geometric_tactile.datasets.RecordingFrames", arguments)
    codes = [source.resolve()[0].fingerprint]
    (tmp_path / "a").rename(tmp_path / "aa")  # the order of the files stays
    codes.append(source.resolve()[0].fingerprint)
    for day in (1, 2):
        (tmp_path / "labels.csv").write_text(f"recording,day\nb/cup_0,{day}\n")
        codes.append(source.resolve()[0].fingerprint)
    assert len({*codes}) == 4
