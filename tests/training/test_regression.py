import csv

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
from sklearn.metrics import mean_absolute_error, r2_score, root_mean_squared_error
from training_fixtures import quiet_trainer

from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports._predictions import write_samples
from torch_geometric_tactile.training import TactileDataModule, TactileModule, regression_metrics
from torch_geometric_tactile.training._collected_metrics import make_metrics, read_metrics


def trained(numbered, model, tmp_path, targets, loss=None, **kwargs):
    L.seed_everything(0, verbose=False)
    data = TactileDataModule(
        numbered(targets, **kwargs), numbered(targets, seed=1, **kwargs), val=0.2, batch_size=16
    )
    module = TactileModule(
        model(targets), lambda p: torch.optim.Adam(p, 0.1), task="regression", loss=loss
    )
    quiet_trainer(tmp_path, max_epochs=40).fit(module, datamodule=data)
    return module, data


@pytest.mark.parametrize("targets", [1, 3])
@pytest.mark.parametrize("loss", [None, "l1", "huber"])
def test_module_learns_numbers(numbered, joint_model, tmp_path, targets, loss):
    module, data = trained(numbered, joint_model, tmp_path, targets, loss)
    assert module.num_classes == targets
    (tested,) = quiet_trainer(tmp_path).test(module, data, verbose=False)
    assert set(tested) == {"test/loss", "test/mae", "test/rmse", "test/r2"}
    assert tested["test/r2"] > 0.95
    score = torch.cat(quiet_trainer(tmp_path).predict(module, data))
    assert score.shape == (60, targets)
    expected = regression_metrics(score, data.test_dataset.column("y"))
    for name, value in expected.items():
        assert tested[f"test/{name}"] == pytest.approx(value, rel=1e-5), name


@pytest.mark.parametrize("shape", [(50,), (50, 1), (50, 3)])
@pytest.mark.parametrize("offset", [0.0, 1e5])  # sums of squares in float would be lost
def test_as_scikit_learn(shape, offset):
    draw = np.random.default_rng(0)
    y = draw.normal(size=shape) + offset
    found = regression_metrics(y + draw.normal(size=shape), y)
    prediction = y + np.random.default_rng(0).normal(size=(2, *shape))[1]
    assert found["mae"] == pytest.approx(mean_absolute_error(y, prediction))
    assert found["rmse"] == pytest.approx(np.sqrt(np.mean((y - prediction) ** 2)))
    assert found["r2"] == pytest.approx(r2_score(y, prediction), rel=1e-4)
    if len(shape) == 1:
        assert found["rmse"] == pytest.approx(root_mean_squared_error(y, prediction))


def test_batches_give_the_same():
    y, prediction = torch.randn(2, 40, 3, dtype=torch.double).unbind()
    metrics = make_metrics(3, "regression")
    for part in torch.arange(40).split(16):
        metrics.update(prediction[part], y[part])
    found = {name: float(value) for name, value in read_metrics(metrics).items()}
    assert found == pytest.approx(regression_metrics(prediction, y))


def test_one_sample_has_no_r2():
    found = regression_metrics(torch.ones(1), torch.zeros(1))
    assert (found["mae"], found["rmse"]) == (1.0, 1.0)
    assert np.isnan(found["r2"])


@pytest.mark.parametrize(
    ("prediction", "y"), [((3,), (4,)), ((3, 2), (3,)), ((0,), (0,)), ((2, 2, 2), (2, 2, 2))]
)
def test_shapes_must_fit(prediction, y):
    with pytest.raises(ValueError, match=r"'prediction' and 'y' must have the same shape"):
        regression_metrics(torch.zeros(prediction), torch.zeros(y))


@pytest.mark.parametrize(
    ("targets", "names", "header"),
    [
        (1, (), ["index", "0"]),
        (3, (), ["index", "0", "1", "2"]),
        (2, ("mass", "friction"), ["index", "mass", "friction"]),
    ],
)
def test_numbers_are_written(numbered, joint_model, tmp_path, targets, names, header):
    parts = (numbered(targets, names=names) for _ in range(2))
    data = TactileDataModule(*parts, val=0.0)
    module = TactileModule(joint_model(targets), task="regression")
    quiet_trainer(tmp_path, max_epochs=1).fit(module, data)
    predictor = Predictor.from_dataset(module.model, data.test_dataset, task="regression")
    write_samples(predictor, data.test_dataset, tmp_path / "predictions.csv")
    with (tmp_path / "predictions.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == header
    expected = module.eval()(data.test_dataset.batch([7]))[0]
    assert [float(value) for value in rows[8][1:]] == pytest.approx(expected.tolist(), rel=1e-4)


def test_sessions_have_their_own_error(numbered, joint_model, tmp_path):
    test = numbered(1, seed=1)
    test._data.session = (torch.arange(60) >= 20).long()
    data = TactileDataModule(numbered(1), test, val=0.0)
    module = TactileModule(joint_model(1), task="regression")
    (tested,) = quiet_trainer(tmp_path).test(module, data, verbose=False)
    with torch.no_grad():
        error = (module.eval()(test.batch(range(60))) - test.y.view(60, 1)).abs().view(60)
    assert tested["test/mae_0"] == pytest.approx(error[:20].mean().item(), rel=1e-4)
    assert tested["test/mae_1"] == pytest.approx(error[20:].mean().item(), rel=1e-4)
    assert tested["test/mae_0"] != pytest.approx(tested["test/mae_1"], rel=1e-2)
    assert "test/accuracy_0" not in tested
