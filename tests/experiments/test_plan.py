import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from dataclasses import replace

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.tables import Cell, Table, TableProtocol
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.training._config import load_config

KNN = {"class_path": "torch_geometric_tactile.transforms.KNNGraph", "init_args": {"k": 2}}
SVM = {"class_path": "torch_geometric_tactile.baselines.GraspSVM"}
SESSION = {"class_path": "torch_geometric_tactile.transforms.SessionZScore"}
TABLE = Table(
    name="mine",
    title="Mine",
    data=DataSource(
        "torch_geometric_tactile.datasets.FakeTactileDataset",
        {"num_samples": 40, "num_objects": 4, "pre_transform": KNN},
    ),
    protocols=(
        TableProtocol("folds", Protocol("frame", folds=3)),
        TableProtocol("objects", Protocol("group", leave_one_out=True)),
        TableProtocol("unseen", Protocol("given"), {"split": "all"}),
    ),
    cells=(
        Cell("SVM", "session", "svm", estimator=SVM, transform=SESSION),
        Cell("GCN", "session", "gcn", config="grasp_gcn_df"),
    ),
    seeds=2,
    measure_memory=False,
)


def test_plan_has_every_fold_of_every_protocol():
    plan = make_plan(TABLE)
    assert len(plan.experiments) == 2 * 2 * (3 + 4 + 1)
    assert len({experiment.code for experiment in plan.experiments}) == len(plan.experiments)
    # The first seed of all models comes first.
    assert [experiment.seed for experiment in plan.experiments] == [0] * 16 + [1] * 16
    folds = [
        e.fold
        for e in plan.experiments
        if (e.name, e.protocol_name, e.seed) == ("svm", "objects", 1)
    ]
    assert folds == [0, 1, 2, 3]
    assert (plan.facts.num_samples, plan.facts.num_groups, plan.facts.num_classes) == (40, 4, 2)
    svm, gcn = (plan.cell_experiment(cell) for cell in TABLE.cells)
    assert svm.is_estimator
    assert (gcn.epochs, gcn.batch_size) == (8, 256)
    assert gcn.transform == SESSION  # the configuration's own
    unseen = next(e for e in plan.experiments if e.protocol_name == "unseen")
    assert len(unseen.data.load()) == 80
    assert unseen.data.fingerprint != svm.data.fingerprint


def test_settings_stand_above_the_table():
    settings = Settings(seeds=1, epochs=3, folds=2, protocols=("folds", "unseen"), threads=2)
    plan = make_plan(TABLE, settings, data={"num_samples": 48})
    assert len(plan.experiments) == 2 * (2 + 1)
    assert plan.experiments[1].epochs == 3
    assert {e.threads for e in plan.experiments} == {2}
    assert plan.facts.num_samples == 48


def test_data_of_one_cell_differs(grasps):
    plan = make_plan(load_table("p1-table3"), Settings(seeds=1), data={"root": str(grasps)})
    edges = {e.name: e.data.load()[0].num_edges for e in plan.experiments}
    assert edges == {"sparse": 1000, "slanted": 1184, "original": 1401, "dense": 2488}
    assert len({e.data.fingerprint for e in plan.experiments}) == 1  # the files are the same
    assert {e.measure_memory for e in plan.experiments} == {True}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seeds": 0}, r"'seeds' must be at least 1 \(got 0\)"),
        ({"epochs": 0}, r"'epochs' must be at least 1 \(got 0\)"),
        ({"threads": 0}, r"'threads' must be at least 1 \(got 0\)"),
        ({"folds": 1}, r"'folds' must be at least 2 \(got 1\)"),
        ({"accelerator": "tpu"}, r"'accelerator' must be one of \['cpu', 'gpu'\] \(got 'tpu'\)"),
    ],
)
def test_wrong_settings(settings, message):
    with pytest.raises(ValueError, match=message):
        Settings(**settings)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"selection": {"phases": ["fly"]}}, r"'phases' must be some of \['hover', 'hold'\]"),
        ({"selection": {"stride": -1}}, r"'stride' must be at least 1 \(got -1\)"),
        ({"data": {"palm": 3}}, "'palm' must be an argument of AllegroUSkin: root, task"),
        (
            {"settings": Settings(protocols=("object",))},
            r"'protocols' must be some of \['by trial', 'by frame'\] \(got 'object'\)",
        ),
        ({"settings": Settings(protocols=())}, r"'protocols' must be some of .* \(got none\)"),
    ],
)
def test_wrong_arguments_are_found_before_training(grasps, arguments, message):
    arguments = {"table": load_table("p2-table2"), "data": {}, **arguments}
    arguments["data"] = {"root": str(grasps), **arguments["data"]}
    with pytest.raises(ValueError, match=message):
        make_plan(**arguments)


def test_missing_recordings_name_the_next_step(tmp_path):
    with pytest.raises(FileNotFoundError, match=rf"tactile simulate --out '{tmp_path}/none'"):
        make_plan(load_table("p2-table2"), data={"root": str(tmp_path / "none")})


def test_data_that_cannot_be_split_is_found_before_training():
    table = replace(TABLE, protocols=(TableProtocol("many", Protocol("group", folds=9)),))
    with pytest.raises(ValueError, match=r"'folds' must be between 2 and the 4 groups .*got 9"):
        make_plan(table)


def test_more_classes_than_the_models_know(grasps):
    config = load_config("p2_table2/x_tac")
    config["model"]["num_classes"] = 2
    cell = Cell("X", "", "x", config=config)
    table = replace(TABLE, cells=(cell,), data=replace(TABLE.data, arguments={"root": str(grasps)}))
    table = replace(
        table,
        data=DataSource("torch_geometric_tactile.datasets.AllegroUSkin", {"split": None}),
        protocols=(TableProtocol("by frame", Protocol("frame")),),
    )
    message = r"the models of mine distinguish 2 classes \(got 3 in"
    with pytest.raises(ValueError, match=message):
        make_plan(table, data={"root": str(grasps)})
