r"""NaN and infinite numbers reach neither the weights nor a metric."""

import warnings

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
from torch import nn
from torch_geometric.data import Batch
from torch_geometric.loader import DataLoader
from training_fixtures import quiet_trainer

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Split, StaticData
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.training import (
    TactileDataModule,
    TactileModule,
    classifier_from_config,
)
from torch_geometric_tactile.training._finite import BatchCheck, model_inputs
from torch_geometric_tactile.training._predictions import collect_predictions
from torch_geometric_tactile.training.module import fitted_names
from torch_geometric_tactile.transforms import DropTaxels, FillMissing, ZScore

SPLIT = Split(torch.arange(36), torch.arange(36, 48), torch.arange(48, 60))


class Net(nn.Module):
    """A linear map of readings and joints, that counts its calls in training."""

    modalities = ("joint",)

    def __init__(self):
        super().__init__()
        self.lin = nn.Linear(11, 3)
        self.steps = 0

    def forward(self, x, edge_index, joint):
        self.steps += self.training
        return self.lin(torch.cat([x.reshape(-1, 8), joint.view(-1, 3)], dim=1))


class Blind(Net):
    """Takes NaN for zero."""

    def forward(self, x, edge_index, joint):
        return super().forward(x.nan_to_num(), edge_index, joint)


def holed(labelled, rows, value=torch.nan, key="x", task="multiclass", **kwargs):
    """The data module of a data set with missing numbers in some samples: two in each."""
    dataset = labelled(task)
    attribute = dataset._data[key].clone()
    attribute.view(60, -1)[rows, :2] = value
    dataset._data[key] = attribute
    return TactileDataModule(dataset, split=SPLIT, batch_size=12, **kwargs)


def trainer(**kwargs):
    return quiet_trainer(**{"max_epochs": 2, **kwargs})


@pytest.mark.parametrize(
    ("rows", "key", "value", "match"),
    [
        (
            [13, 30],
            "x",
            torch.nan,
            r"readings 'x' of the train part must be finite after all transforms \(got 4 NaN in 2 "
            r"samples: 13, 30 of trial 2, 5\); add FillMissing\(\) to the transform",
        ),
        ([40], "x", torch.nan, r"readings 'x' of the val part .*got 2 NaN in 1 sample: 4 of tr"),
        ([7], "joint", torch.nan, r"'joint' of the train part .*FillMissing\(\) fills only read"),
        ([7], "x", -torch.inf, r"of the train part .*got 2 infinite in 1 sample.*correct the data"),
        (list(range(3, 12)), "x", torch.nan, r"in 9 samples: 3, 4, 5, 6, 7 and 4 more of trial 0"),
    ],
)
def test_training_refuses_missing_inputs_before_the_first_batch(labelled, rows, key, value, match):
    model = Net()
    with pytest.raises(ValueError, match=match):
        trainer().fit(TactileModule(model), holed(labelled, rows, value, key))
    assert model.steps == 0


def test_test_part_is_looked_at_before_a_test_and_not_before_a_training(labelled):
    data = holed(labelled, [50])
    module = TactileModule(Net())
    trainer(max_epochs=1).fit(module, data)
    with pytest.raises(ValueError, match=r"'x' of the test part .*in 1 sample: 2 of trial 8"):
        trainer().test(module, data, verbose=False)


def test_what_transforms_fill_or_a_model_does_not_read_is_no_error(labelled):
    data = holed(labelled, [13], transform=FillMissing())
    trainer(max_epochs=1).fit(TactileModule(Net()), data)
    still = TactileGCN(4, 3, inputs=("edge",), num_edges=8, widths=(4,), pools=(1,))
    assert model_inputs(still) == ("edge_attr",)
    trainer(max_epochs=1).fit(TactileModule(still), holed(labelled, [13]))


def test_a_missing_number_a_sample_that_no_model_reads_is_no_error(labelled):
    dataset = labelled("multiclass")
    dataset._data.yaw = torch.where(torch.arange(60) % 2 == 0, 0.5, torch.nan)
    data = TactileDataModule(dataset, split=SPLIT, batch_size=12)
    trainer(max_epochs=1).fit(TactileModule(Net(), num_classes=3), data)


def test_only_samples_with_missing_numbers_are_read_twice(labelled, monkeypatch):
    seen = []
    data = holed(labelled, [13, 14], transform=FillMissing())
    peek = data.peek
    monkeypatch.setattr(data, "peek", lambda part, rows: (seen.append(rows), peek(part, rows))[1])
    trainer(limit_train_batches=0).fit(TactileModule(Net()), data)
    assert [rows if isinstance(rows, int) else rows.tolist() for rows in seen] == [[13, 14], 2]


def test_of_a_large_part_some_samples_are_looked_at(labelled, monkeypatch):
    monkeypatch.setattr("torch_geometric_tactile.training._finite._MAX_FULL_CHECK_BYTES", 100)
    monkeypatch.setattr("torch_geometric_tactile.training._finite._NUM_PROBE_SAMPLES", 3)
    model = Net()
    with pytest.raises(ValueError, match=r"of the train part .*in 1 sample: 35 of trial 5"):
        trainer().fit(TactileModule(model), holed(labelled, [1, 35]))
    assert model.steps == 0
    # The others are found in their batch, before they reach the weights.
    with pytest.raises(ValueError, match=r"of batch \d of epoch 0 of the train part .*: 1 of tr"):
        trainer().fit(TactileModule(model), holed(labelled, [1]))


def test_missing_readings_of_a_random_transform_are_found_in_their_batch(labelled):
    data = holed(labelled, [], train_transform=DropTaxels(0.5, value=torch.nan))
    model = Net()
    with pytest.raises(ValueError, match=r"'x' of batch 0 of epoch 0 of the train part .*FillMiss"):
        trainer().fit(TactileModule(model), data)
    assert model.steps == 0


def test_loss_that_is_not_finite_stops_before_it_reaches_the_weights(labelled):
    data = holed(labelled, [13], 1e38)  # in float32 the output is infinite
    model = Net()
    nn.init.constant_(model.lin.weight, 10.0)
    before = model.lin.weight.detach().clone()
    match = r"loss of batch \d of epoch 0 .*\(got nan from 1 sample: 13 of trial 2\); inputs and we"
    with pytest.raises(ValueError, match=match):
        trainer(overfit_batches=0).fit(TactileModule(model, partial_sgd), data)
    assert model.lin.weight.equal(before)


def partial_sgd(parameters):
    return torch.optim.SGD(parameters, lr=0.0)


def test_weights_that_are_not_finite_are_named(labelled):
    model = Net()
    model.lin.bias.data[1] = torch.inf
    match = r"the loss of batch 0 .*from 12 samples: .*; an earlier step has made the weights 'lin"
    with pytest.raises(ValueError, match=match):
        trainer(limit_val_batches=0).fit(TactileModule(model), holed(labelled, []))


def test_loss_without_a_cause_in_the_model(labelled):
    data = holed(labelled, [])
    module = TactileModule(Net(), class_weights=[0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"got nan from 12 samples.*outputs are finite: check"):
        trainer(limit_val_batches=0).fit(module, data)


@pytest.mark.parametrize("task", ["multiclass", "multilabel"])
def test_nan_is_never_counted_as_a_class(labelled, task):
    dataset = holed(labelled, [14], task=task).dataset
    module = TactileModule(Net(), num_classes=3, task=task)
    match = r"readings 'x' of batch 1 of the test part .*2 NaN in 1 sample: 14 of trial 2"
    loaders = TactileDataModule(dataset, split=SPLIT, batch_size=12)
    loaders.setup()
    loader = loaders._loader("train")
    with pytest.raises(ValueError, match=match):
        trainer().test(module, loader, verbose=False)
    match = r"'x' of batch 1 of epoch 0 of the val part .*1 sample: 2 of trial 2, counted in the b"
    with pytest.raises(ValueError, match=match):
        trainer().validate(module, DataLoader(dataset, 12), verbose=False)
    match = r"readings 'x' of batch 1 must be finite .*1 sample: 14 of trial 2\)"
    with pytest.raises(ValueError, match=match):
        collect_predictions(module, loader)


def test_model_that_makes_nan_is_named(labelled):
    class Odd(Net):
        def forward(self, x, edge_index, joint):
            out = super().forward(x, edge_index, joint)
            return torch.where(joint[:, :1] < 0, torch.nan, out)

    data = holed(labelled, [])
    match = r"the predictions of batch 0 of the test part must not be NaN .*inputs and weights"
    with pytest.raises(ValueError, match=match):
        trainer().test(TactileModule(Odd()), data, verbose=False)


def test_model_that_copes_with_missing_inputs_may_be_tested(labelled):
    data = holed(labelled, [13])
    data.setup()
    loader = data._loader("train")
    metrics = trainer().test(TactileModule(Blind(), num_classes=3), loader, verbose=False)
    assert 0 <= metrics[0]["test/accuracy"] <= 1
    assert collect_predictions(TactileModule(Blind(), num_classes=3), loader).logits.shape == (
        36,
        3,
    )


def test_prediction_of_missing_readings_is_nan_with_a_warning(labelled):
    data = holed(labelled, [50])
    module = TactileModule(Net(), num_classes=3)
    with pytest.warns(UserWarning, match=r"some predictions are NaN: readings 'x' of batch 0"):
        (found,) = trainer().predict(module, data)
    assert found.isnan().any(dim=1).nonzero().tolist() == [[2]]


def test_samples_of_a_pyg_batch(labelled):
    dataset = labelled("multiclass")
    samples = [dataset[i] for i in (3, 4, 5)]
    samples[1].x = samples[1].x * torch.nan
    samples[2].edge_attr = samples[2].edge_attr * torch.nan
    batch = Batch.from_data_list(samples)
    with pytest.raises(ValueError, match=r"readings 'x' of it .*8 NaN in 1 sample: 1 of trial 0"):
        BatchCheck(Net(), batch, "it").inputs()
    net = Net()
    net.modalities = ("edge_attr",)
    batch.x = torch.zeros(12, 2)
    with pytest.raises(ValueError, match=r"'edge_attr' of it .*\(got 32 NaN in 1 sample: 2 of"):
        BatchCheck(net, batch, "it").inputs()


def test_large_sums_are_no_infinite_numbers():
    x = torch.full((2, 2, 2), 3e38)
    batch = StaticData(x=x, edge_index=torch.zeros(2, 0).long(), joint=torch.zeros(2, 3))
    BatchCheck(Net(), batch, "it").inputs()


def test_command_line_explains_missing_readings(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    package = "torch_geometric_tactile"
    (tmp_path / "fit.yaml").write_text(
        f"""
        model: {{model: {{class_path: {package}.nn.models.GraspGCN}}}}
        data:
          dataset:
            class_path: {package}.datasets.FakeTactileDataset
            init_args:
              num_samples: 20
              pre_transform: {{class_path: {package}.transforms.KNNGraph, init_args: {{k: 2}}}}
          transform:
            class_path: {package}.transforms.DropTaxels
            init_args: {{taxels: [3], value: .nan}}
        trainer: {{accelerator: cpu, logger: false, enable_progress_bar: false}}
        """
    )
    assert main(["fit", "--config", "fit.yaml", "--trainer.max_epochs", "1"]) == 1
    said = capsys.readouterr().err
    assert "tactile: error: readings 'x' of batch 0 of epoch 0 of the " in said
    assert "Traceback" not in said


@pytest.mark.parametrize("transform", [None, ZScore()])
def test_bare_model_of_scaled_data_warns(labelled, tmp_path, transform):
    name = "torch_geometric_tactile.nn.models.TactileFNN"
    sizes = {"inputs": ["tactile"], "widths": [4], "pools": [1]}
    config = {"model": {"class_path": name, "init_args": sizes}}
    data = TactileDataModule(labelled("multiclass"), transform=transform, val=0.2)
    data.setup()
    module = classifier_from_config(config, data)
    fitter = trainer(max_epochs=1)
    fitter.fit(module, data)
    path = tmp_path / "model.ckpt"
    fitter.save_checkpoint(path)
    names = fitted_names(torch.load(path, weights_only=True))
    if transform is None:
        assert names == []
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            TactileModule.load_from_checkpoint(path, weights_only=True)
        return
    assert names == ["ZScore"]
    with pytest.warns(UserWarning, match=r"transformed by ZScore, .*Predictor.from_checkpoint"):
        bare = TactileModule.load_from_checkpoint(path, weights_only=True).eval()
    with warnings.catch_warnings():  # a trainer restores the scaling
        warnings.filterwarnings("error", message="this model was trained on readings")
        trainer().validate(classifier_from_config(config, data), data, ckpt_path=path)
    part = data.part("val")
    predictor = Predictor.from_checkpoint(path)
    scaled = torch.cat([bare(batch) for batch in data.val_dataloader()]).detach()
    torch.testing.assert_close(predictor(part.data.x), scaled.softmax(1))
    assert not bare(part.data).allclose(scaled, atol=1e-3)
