"""Comparisons on samples of different sensors, and of networks that are called with a batch."""

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from mixed_sensors import gloves

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._compared_models import MODELS
from torch_geometric_tactile.experiments.compared_windows import FrameCut, data_source
from torch_geometric_tactile.experiments.comparison import (
    ComparisonSettings,
    comparison_plan,
    summarize,
)
from torch_geometric_tactile.experiments.deploy import deploy
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports._compare import comparison_markdown, prediction_rows
from torch_geometric_tactile.sensors import grid

ATTENTION = "own_models.Attention"


def settings(*models, **changes):
    given = {"models": models, "folds": 2, "epochs": 3, "members": 1}
    return ComparisonSettings(**given | changes)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    source = data_source("mixed_sensors.gloves", arguments={"per_subject": 8})
    plan = comparison_plan(source, settings(ATTENTION, "constant", by="group"), name="gloves")
    return run_plan(plan, tmp_path_factory.mktemp("out"), jobs=1)


def test_networks_are_compared_on_subjects_that_are_new(mixed):
    assert not mixed.failed
    comparison = summarize(mixed)
    assert comparison.units.name == "group"
    assert comparison.best_plain == "constant"
    result = comparison.of(ATTENTION)
    assert result.model.is_graph
    assert not comparison.of("constant").model.is_graph
    assert result.scores["accuracy"].mean > 0.6
    assert comparison.of("constant").scores["accuracy"].mean == 0.5
    subjects = {sample.trial: sample.group for sample in gloves(per_subject=8)}
    for experiment in mixed.plan.experiments:
        parts = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
        train, test = ({subjects[i] for i in part.column("trial").tolist()} for part in parts)
        assert not train & test


def test_page_names_what_is_left_out(mixed):
    page = comparison_markdown(summarize(mixed))
    assert "The samples have 30 to 60 taxels and share no layout" in page
    left_out = page.partition("Models that need a layout are left out: ")[2].partition(".\n")[0]
    assert left_out.replace("\\_", "_").split(", ") == [
        m.name for m in MODELS if m.name != "constant"
    ]
    assert "## Accuracy by session" in page
    assert "| day 0 |" in page
    header, *rows = prediction_rows(summarize(mixed))
    assert header[:7] == ["model", "seed", "fold", "index", "session", "group", "trial"]
    assert len(rows) == 2 * 96
    assert {row[4] for row in rows} == {"day 0", "day 1", "day 2"}


def test_all_that_run_are_compared_if_none_is_named():
    source = data_source("mixed_sensors.gloves", arguments={})
    plan = comparison_plan(source, settings(*(), by="group", models=None))
    assert [cell.experiment for cell in plan.table.cells] == ["constant"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("taxel_net", "it needs one layout, and the samples, which have 30 to 60 taxels,"),
        ("forest", "it needs one layout"),
        ("own_models.neighbours", "it reads rows of readings from one sensor"),
        ("own_models.Ring", r"it is not called as forward\(x, edge_index, batch\)"),
    ],
)
def test_models_of_one_layout_are_refused(name, reason):
    source = data_source("mixed_sensors.gloves", arguments={})
    match = rf"must fit the data \(got '{name}', but {reason}"
    with pytest.raises(ValueError, match=match):
        comparison_plan(source, settings(name, by="group"))


def test_what_needs_one_layout_is_refused(mixed):
    with pytest.raises(ValueError, match="a predictor needs one layout, and the samples"):
        deploy(summarize(mixed), ATTENTION)
    source = data_source("mixed_sensors.gloves", arguments={})
    tare = {"key": "trial", "first": 2}
    with pytest.raises(ValueError, match=r"must be left out for samples from different sensors"):
        comparison_plan(source, settings("constant", tare=tare))
    windows = data_source("mixed_sensors.gloves", arguments={}, cut=FrameCut(window=2))
    with pytest.raises(ValueError, match=r"cut only from a StaticDataset of frames.*\(got list\)"):
        comparison_plan(windows, settings("constant"))
    with pytest.raises(ValueError, match=r"'class_path' must be a StaticDataset or a PyG data set"):
        comparison_plan(data_source("mixed_sensors.texts", arguments={}), settings("constant"))


def test_fingerprint_is_of_all_samples():
    codes = set()
    for arguments in ({}, {"seed": 1}, {"edges": False}):
        codes.add(DataSource("mixed_sensors.gloves", arguments).resolve()[0].fingerprint)
    assert len(codes) == 3
    assert DataSource("mixed_sensors.gloves", {}).resolve()[0].fingerprint in codes


@pytest.mark.parametrize("metric", ["accuracy", "mae"])
def test_samples_without_edges_and_numbers(tmp_path, metric):
    path = "mixed_sensors.gloves" if metric == "accuracy" else f"{__name__}.strengths"
    source = data_source(path, arguments={"edges": False})
    plan = comparison_plan(source, settings(ATTENTION, by="group", epochs=1))
    run = run_plan(plan, tmp_path, jobs=1)
    assert not run.failed
    (result,) = summarize(run).results
    assert np.isfinite(result.scores[metric].mean)


def strengths(edges=True):
    """Samples with a number to be predicted."""
    samples = gloves(edges=edges)
    for sample in samples:
        sample.y = float(sample.x[:, 0].mean())
    return samples


def presses():
    """Static samples on which an average over neighbours tells the class."""
    draw = torch.Generator().manual_seed(0)
    y = torch.arange(48) % 2
    x = 2.0 * y[:, None, None] + torch.randn(48, 12, 1, generator=draw)
    return StaticDataset.from_arrays(x, y, trial=torch.arange(48) // 2, layout=grid(3, 4, 0.01))


@pytest.fixture(scope="module")
def static(tmp_path_factory):
    source = data_source(f"{__name__}.presses", arguments={})
    names = (ATTENTION, "own_models.Ring", "own_models.OneLayer", "constant")
    plan = comparison_plan(source, settings(*names, epochs=8, members=2))
    return run_plan(plan, tmp_path_factory.mktemp("static"), jobs=1)


def test_networks_with_message_passing_are_graph_models(static):
    assert not static.failed
    results = summarize(static).results
    assert {result.model.name: result.model.is_graph for result in results} == {
        ATTENTION: True,
        "own_models.Ring": True,
        "own_models.OneLayer": False,
        "constant": False,
    }


def test_network_of_pyg_is_saved_and_read_with_one_network_given(static, tmp_path):
    from own_models import Attention

    predictor = deploy(summarize(static), ATTENTION)
    predictor.save(tmp_path / "own.predictor")
    again = Predictor.load(tmp_path / "own.predictor", model=Attention(1, 2))
    x = presses().data.x
    assert again(x).equal(predictor(x))
    torch.testing.assert_close(torch.stack([again(one) for one in x[:4]]), predictor(x[:4]))
    assert float((predictor(x).argmax(dim=1) == presses().y).float().mean()) > 0.8
    with pytest.raises(ValueError, match="your model 'Attention"):
        Predictor.load(tmp_path / "own.predictor")
    with pytest.raises(ValueError, match=r"'model' must be of class AverageModel \(got Linear\)"):
        Predictor.load(tmp_path / "own.predictor", model=torch.nn.Linear(1, 2))
