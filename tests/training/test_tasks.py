import csv
import math

import pytest
import torch
from torch_geometric.data import Batch

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
from training_fixtures import quiet_trainer

from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports._predictions import write_samples
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.training.metrics import classification_metrics

NAMES = ("hard", "heavy", "slippery")


def trainer(tmp_path, **kwargs):
    return quiet_trainer(tmp_path, **{"max_epochs": 30, **kwargs})


def trained(labelled, model, task, tmp_path, **kwargs):
    L.seed_everything(0, verbose=False)
    data = TactileDataModule(
        labelled(task, **kwargs), labelled(task, seed=1, **kwargs), val=0.2, batch_size=16
    )
    classifier = TactileModule(model, optimizer=lambda p: torch.optim.Adam(p, 0.1), task=task)
    fitter = trainer(tmp_path)
    fitter.fit(classifier, datamodule=data)
    return classifier, data, dict(fitter.callback_metrics)


@pytest.mark.parametrize("task", ["multiclass", "multilabel"])
def test_classifier_learns_and_logs_what_a_table_would_say(task, labelled, joint_model, tmp_path):
    classifier, data, logged = trained(labelled, joint_model(), task, tmp_path)
    assert classifier.num_classes == 3  # told by the data
    names = {"accuracy", "f1", "auroc", "loss"}
    if task == "multilabel":
        names |= {"label_accuracy", *(f"label_accuracy_{name}" for name in NAMES)}
    assert {key.removeprefix("val/") for key in logged if key.startswith("val/")} == names
    (tested,) = trainer(tmp_path).test(classifier, data, verbose=False)
    assert {key.removeprefix("test/") for key in tested} == names
    assert tested["test/accuracy"] > 0.8
    score = torch.cat(trainer(tmp_path).predict(classifier, data))
    by_number = {f"label_accuracy_{i}": f"label_accuracy_{name}" for i, name in enumerate(NAMES)}
    expected = classification_metrics(score, data.test_dataset.column("y"), task)
    for name, value in expected.items():
        assert tested[f"test/{by_number.get(name, name)}"] == pytest.approx(value), name


def test_multilabel_loss_is_the_binary_cross_entropy(labelled, joint_model):
    classifier = TactileModule(joint_model(), task="multilabel")
    logits, y = torch.tensor([[0.0, 2.0]]), torch.tensor([[1, 0]])
    expected = (math.log(2) + math.log(1 + math.exp(2))) / 2
    assert float(classifier.loss(logits, y)) == pytest.approx(expected)
    assert classifier.probability(logits).tolist() == [[0.5, pytest.approx(1 / (1 + math.exp(-2)))]]
    batch = labelled().batch([0, 1])
    assert classifier.predict_step(batch, 0).equal(classifier(batch).sigmoid())


def test_batches_of_both_kinds_reach_the_model(labelled, joint_model):
    dataset, classifier = labelled(), TactileModule(joint_model(), task="multilabel")
    static = dataset.batch([0, 1, 2])
    batch = Batch.from_data_list([dataset[0], dataset[1], dataset[2]])
    torch.testing.assert_close(classifier(batch), classifier(static))
    torch.testing.assert_close(
        classifier.training_step(batch, 0), classifier.training_step(static, 0)
    )


def test_labels_without_names_are_numbered(labelled, joint_model, tmp_path):
    classifier, data, logged = trained(labelled, joint_model(), "multilabel", tmp_path, names=())
    assert classifier.num_classes == 3
    assert "val/label_accuracy_2" in logged
    (predicted,) = written(classifier, data, tmp_path)[:1]
    assert list(predicted) == ["index", "prediction", "p_0", "p_1", "p_2"]


def written(classifier, data, tmp_path):
    test = data.test_dataset
    predictor = Predictor.from_dataset(classifier.model, test, data.transform, classifier.task)
    write_samples(predictor, test, tmp_path / "predictions.csv")
    with (tmp_path / "predictions.csv").open() as file:
        return list(csv.DictReader(file))


def test_predictions_of_labels_are_written(labelled, joint_model, tmp_path):
    classifier, data, _ = trained(labelled, joint_model(), "multilabel", tmp_path)
    rows = written(classifier, data, tmp_path)
    assert len(rows) == 60
    for row in rows:
        likely = [name for name in NAMES if float(row[f"p_{name}"]) > 0.5]
        assert row["prediction"] == ";".join(likely)
    assert {row["prediction"].count(";") for row in rows} == {0, 1, 2}
    assert "" in {row["prediction"] for row in rows}


def test_class_missing_in_the_test_part_breaks_nothing(labelled, joint_model, tmp_path):
    classifier, data, _ = trained(labelled, joint_model(), "multiclass", tmp_path)
    y = data.test_dataset.column("y")
    for keep, lacks_all in ((y != 1, False), (y == 1, True)):
        part = TactileDataModule(data.dataset, data.test_dataset[keep], val=0.0)
        (tested,) = trainer(tmp_path).test(classifier, part, verbose=False)
        assert math.isnan(tested["test/auroc"]) == lacks_all
        assert tested["test/accuracy"] > 0.7


def test_checkpoint_keeps_the_arguments(tmp_path):
    given = {"task": "multilabel", "num_classes": 6, "class_weights": (1, 2, 3, 4, 5, 6)}
    fitter = trainer(tmp_path)
    fitter.strategy.connect(TactileModule(torch.nn.Identity(), **given))
    fitter.save_checkpoint(tmp_path / "new.ckpt")
    again = TactileModule.load_from_checkpoint(tmp_path / "new.ckpt", model=torch.nn.Identity())
    assert (again.task, again.num_classes) == ("multilabel", 6)
    assert again.class_weight.tolist() == [1, 2, 3, 4, 5, 6]
    assert again.arguments() == {
        "num_classes": 6,
        "task": "multilabel",
        "loss": None,
        "class_weights": [1, 2, 3, 4, 5, 6],
        "label_smoothing": 0.0,
        "threshold": None,
    }


def test_bad_input_is_named(labelled, joint_model):
    with pytest.raises(ValueError, match=r"'task' must be one of .* \(got 'binary'\)"):
        TactileModule(joint_model(), task="binary")
    batch = labelled().batch([0, 1])
    del batch.edge_attr
    match = (
        r"the model needs 'edge_attr' \(the batch has \[.*'joint'.*\): add GeometricEdgeAttr\(\)"
    )
    with pytest.raises(ValueError, match=match):
        TactileModule(joint_model())(batch)
    batch = labelled().batch([0, 1])
    match = r"'y' must have shape \(2,\) for task='multiclass' \(got \(2, 3\)\); is it task='multil"
    with pytest.raises(ValueError, match=match):
        TactileModule(joint_model()).training_step(batch, 0)
    with pytest.raises(ValueError, match=r"'y' must have shape \(2, 5\) for task='multilabel'"):
        TactileModule(joint_model(5), task="multilabel").validation_step(batch, 0)
