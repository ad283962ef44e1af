import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")


import pickle

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.source import DataSource

DATA = DataSource("a.B", {"root": "r", "task": "t"}, fingerprint="d")


def experiment(**changes):
    arguments = {"data": DATA, "protocol": Protocol("trial"), "protocol_name": "by trial"}
    arguments |= {"name": "a", "model": {"x": 1}, "epochs": 2}
    return Experiment(**{**arguments, **changes})


def data(**changes):
    return {"data": DataSource(**{**vars(DATA), **changes})}


def test_identity_is_all_that_the_result_follows_from():
    same = [experiment(), experiment(name="b"), experiment(threads=2)]
    same += [
        experiment(**data(arguments={"root": "s", "task": "t"})),
        experiment(**data(caption="c")),
    ]
    same += [experiment(protocol_name="whole trials")]
    assert len({e.code for e in same}) == 1
    others = [
        {"model": {"x": 2}},
        {"transform": {"class_path": "a.T"}},
        {"trainer": {"gradient_clip_val": 1}},
        {"batch_size": 7},
        {"seed": 1},
        {"fold": 1},
        {"protocol": Protocol("frame")},
        {"protocol": Protocol("trial", stratify="group")},
        {"epochs": 3},
        {"accelerator": "gpu"},
        {"measure_memory": True},
        data(fingerprint="e"),
        data(class_path="a.C"),
        data(arguments={"root": "r", "task": "u"}),
        data(selection={"stride": 2}),
    ]
    assert len({experiment(**change).code for change in [{}, *others]}) == 1 + len(others)


def test_names_are_for_people_and_for_files():
    one = experiment(protocol=Protocol("group", folds=5), protocol_name="leave objects/out", fold=3)
    assert one.label == "a, leave objects/out, seed 0, fold 3"
    assert one.file_name == f"a_leave-objects-out_seed0_fold-3_{one.code}.json"
    assert experiment().label == "a, by trial, seed 0"


def test_pickled_experiment_is_the_same():
    one = experiment(seed=3, transform={"class_path": "a.T"}, **data(selection={"stride": 2}))
    assert len(one.code) == 12  # kept in the object, and no part of it
    again = pickle.loads(pickle.dumps(one))
    assert again.identity() == one.identity()
    assert again.code == one.code
    assert again.protocol == one.protocol
