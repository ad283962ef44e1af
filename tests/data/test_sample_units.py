import numpy as np
import pytest
import torch
from recordings import counting_recording

from torch_geometric_tactile.data import Protocol, StaticData, StaticDataset, Trials, Windows
from torch_geometric_tactile.data._sample_units import (
    list_units,
    trial_units,
    unit_column,
    unit_names,
)
from torch_geometric_tactile.datasets import RecordingFrames, SamplesFile
from torch_geometric_tactile.sensors import grid

GRID = grid(1, 2, pitch=0.01)


def data_module(*arguments, **options):
    pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    from torch_geometric_tactile.training import TactileDataModule

    return TactileDataModule(*arguments, **options)


def frames(*persons, **options):
    """A trial of three frames for each person; None is a recording that names no person."""
    recordings = [
        counting_recording(
            *(3, 2, 1),
            rate=10,
            offset=i,
            label=("slip", "hold")[i % 2],
            meta={"object": "cup", "trial": i, **({} if person is None else {"person": person})},
        )
        for i, person in enumerate(persons)
    ]
    return RecordingFrames(layout=GRID, recordings=recordings, target="label", **options)


def test_metadata_of_trials_by_hand():
    metadata = [{"person": "b", "age": 3}, {"person": "a", "age": 3}, {"age": 2.5, "x": "far"}]
    assert trial_units(metadata, ()) == {
        "trial.person": ["b", "a", ""],
        "trial.age": ["3", "3", ""],
    }
    assert trial_units([{"session": "a", "group": "b"}], ["group"]) == {"trial.session": ["a"]}
    assert trial_units([{"wet": True, "label": "slip", "trial": 3}], ()) == {}


def test_person_of_each_frame():
    dataset = frames("Eva", "Ann", "Eva")
    assert unit_names(dataset, "person") == ["Ann", "Eva"]
    assert unit_column(dataset, "person").tolist() == [1, 1, 1, 0, 0, 0, 1, 1, 1]
    assert unit_column(dataset[3:5], "person").tolist() == [0, 0]
    assert unit_column(Windows(dataset, 2, 1), "person").tolist() == [1, 1, 0, 0, 1, 1]
    assert unit_column(Trials(dataset), "person").tolist() == [1, 0, 1]
    assert "person" not in dataset[0]
    assert list_units(dataset) == ["trial", "person"]


def test_persons_are_in_one_part_each():
    dataset = frames(*"aabbccddee")
    person = unit_column(dataset, "person")
    for samples in (dataset, Windows(dataset, 2, 1)):
        person = unit_column(samples, "person")
        for fold in range(5):
            train, val, test = Protocol("person", folds=5, val=0.3).split(samples, fold=fold)
            parts = [set(person[part].tolist()) for part in (train, val, test)]
            assert len(parts[2]) == len(parts[1]) == 1
            assert not (parts[0] & parts[1] | parts[0] & parts[2] | parts[1] & parts[2])
    data = data_module(dataset, split="person", val=0.2, test=0.2)
    data.setup()
    parts = [set(unit_column(data.part(name), "person").tolist()) for name in ("train", "test")]
    assert (len(parts[0]), len(parts[1]), parts[0] & parts[1]) == (3, 1, set())
    assert len(frames(*"abcde", split="test", protocol=Protocol("person", val=0))) == 3


def test_unit_that_some_trials_lack_names_them():
    with pytest.raises(
        ValueError,
        match=r"'by' must be .*: 'trial' \(got 'person', which 2 of 4 trials lack: '1', '3'\); cor",
    ):
        Protocol("person", folds=2).split(frames("a", None, "b", None))
    dataset = frames("a", "b", None)
    names = unit_names(dataset, "person")
    assert [names[i] for i in unit_column(dataset[:6], "person")] == ["a", "a", "a", "b", "b", "b"]


def test_unknown_unit_lists_those_that_there_are():
    match = r"'by' must .*: 'trial', 'person' \(got 'persn'\): name it in the 'pattern' of the file"
    with pytest.raises(ValueError, match=match):
        Protocol("persn").split(frames("a", "b", "c"))
    with pytest.raises(ValueError, match=r"'split' must be .*: 'trial', 'person' \(got 'persn'"):
        data_module(frames("a", "b", "c"), split="persn")
    match = r"'by' must be .*: 'day' \(got 'person'\): add an array or attribute 'person'"
    data = StaticData(x=torch.zeros(2, 2, 1), day=torch.tensor([0, 1]), y=torch.tensor([0, 1]))
    with pytest.raises(ValueError, match=match):
        Protocol("person").split(data)


@pytest.mark.parametrize("key", ["x", "time", "y"])
def test_attributes_that_are_no_units(key):
    match = rf"'by' must be a unit that all samples have: 'trial', 'person' \(got '{key}'\)"
    with pytest.raises(ValueError, match=match):
        Protocol(key, folds=2).split(frames("a", "b", "b"))
    with pytest.raises(ValueError, match=rf"'split' must be a unit .*got '{key}'"):
        data_module(frames("a", "b", "b"), split=key)


def test_attribute_comes_before_metadata():
    dataset = frames("a", "b", "b")
    assert "size" not in list_units(dataset)
    sized = StaticDataset.from_arrays(
        np.zeros((4, 2, 1)), layout=GRID, trial=[0, 0, 1, 1], person=["a", "b", "b", "a"]
    )
    assert unit_names(sized, "person") == ["a", "b"]
    split = Protocol("person", folds=2).split(sized)
    assert {tuple(part.tolist()) for part in (split.train, split.test)} == {(0, 3), (1, 2)}


def test_arrays_of_a_file_are_units(tmp_path):
    x, y = np.arange(12.0).reshape(6, 2), ["a", "b"] * 3
    person = ["Ann", "Ann", "Eva", "Eva", "Ida", "Ida"]
    np.savez(tmp_path / "a.npz", x=x, y=y, group=[0, 1] * 3, person=person, num_nodes=[1] * 6)
    dataset = SamplesFile(tmp_path / "a.npz", layout=GRID)
    assert dataset.named_units == ["person"]
    assert unit_names(dataset, "person") == ["Ann", "Eva", "Ida"]
    test = Protocol("person", folds=3).split(dataset).test
    assert len(test) == 2
    assert len(dataset.person[test].unique()) == 1
