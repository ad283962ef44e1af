from types import SimpleNamespace

import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.predictor._file_names import FileNameForm
from torch_geometric_tactile.predictor._preparation import (
    Preparation,
    add_shared_attributes,
    add_tare,
)
from torch_geometric_tactile.sensors import grid


@pytest.mark.parametrize(
    ("pattern", "target", "form"),
    [
        (r"(?P<object>.+)_(?P<trial>\d+)", "object", "{object}_{trial}"),
        (r"(?P<who>[^_]+)_(?P<label>slip|hold)", "label", "{who}_{label}"),
        (r"(?P<day>\w+)/(?P<object>[^/]+?)_x", "day", "{day}/{object}_x"),
        (r"(?P<object>.+)_(?P<trial>\d+)", "label", None),  # the label is in the file
        (r"(?P<object>(a|b)+)_(?P<trial>\d+)", "object", None),  # groups in a group
        (r"(?P<object>.+)_.*", "object", None),
    ],
)
def test_form_of_a_pattern(pattern, target, form):
    found = FileNameForm.from_dataset(SimpleNamespace(pattern=pattern, target=target))
    assert (None if found is None else found.form) == form
    assert found is None or FileNameForm.from_dict(found.to_dict()) == found


def test_data_set_without_a_pattern():
    assert FileNameForm.from_dataset(SimpleNamespace(target="object")) is None


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("p4_cup_001.csv", "cup"),
        ("a/b/p4_Big_Cup_1.csv", "big_cup"),
        ("p_4_cup_001.h5", "cup"),  # of several readings the one with a class
        ("p4_mug_001.csv", None),
        ("p4_cup_one.csv", None),
        ("cup_001.csv", None),
        (f"{'p' * 120}_cup_001.csv", None),
    ],
)
def test_class_in_the_name_of_a_file(path, name):
    form = FileNameForm("{person}_{object}_{trial}", "object")
    assert form.find_class(path, ["ball", "big_cup", "cup"]) == name


def test_folders_are_parts_of_the_name():
    form = FileNameForm("{day}/{object}", "day")
    assert form.find_class("x/tue/cup.csv", ["mon", "tue"]) == "tue"
    assert form.find_class("cup.csv", ["mon", "tue"]) is None


def test_worst_form_ends_soon():
    form = FileNameForm("{a}{b}{c}{d}{y}", "y")
    assert form.find_class("a" * 119 + "!", ["x"]) is None
    assert form.find_class("a" * 9999 + "!", ["!"]) is None  # would take years


def test_copies_of_a_preparation_keep_the_form():
    recordings = [Recording(time=np.arange(3.0), tactile=np.zeros((3, 2, 1)), label="slip")]
    options = {"pattern": "{label}_{trial}", "target": "label"}
    dataset = RecordingFrames(layout=grid(1, 2, 0.01), recordings=recordings, **options)
    preparation = Preparation.from_dataset(dataset)
    form = FileNameForm("{label}_{trial}", "label")
    assert preparation.file_names == form
    assert add_tare(preparation).file_names == form
    assert add_shared_attributes(preparation, tangent=torch.ones(2, 2, 3)).file_names == form
