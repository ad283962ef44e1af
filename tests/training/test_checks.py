import warnings

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
from torch_geometric.nn import GCNConv, GraphNorm, LayerNorm, PairNorm
from training_fixtures import quiet_trainer

from torch_geometric_tactile import nn
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.training._checks import check_data, check_labels

PAD = grid(2, 2, pitch=0.01)


class Linear(torch.nn.Module):
    """A linear map of the joints with dropout, that counts its calls."""

    modalities = ("joint",)

    def __init__(self, num_outputs=3):
        super().__init__()
        self.lin = torch.nn.Linear(3, num_outputs)
        self.dropout = torch.nn.Dropout(0.5)
        self.frozen = torch.nn.BatchNorm1d(3).eval()
        self.calls = []

    def forward(self, x, edge_index, joint):
        self.calls.append((len(x), self.training, torch.is_grad_enabled()))
        return self.lin(self.dropout(joint))


def fit(module, data, **kwargs):
    trainer = quiet_trainer(**kwargs)
    trainer.fit(module, datamodule=data)
    return trainer


def changed(dataset, **attributes):
    for name, value in attributes.items():
        if value is None:
            delattr(dataset._data, name)
        else:
            dataset._data[name] = value
    return dataset


def with_labels(labelled, y):
    return TactileDataModule(changed(labelled("multiclass"), y=y), val=0.2)


@pytest.mark.parametrize(
    ("y", "match"),
    [
        (torch.zeros(60), r"'y' of 'train' must be integers .*got torch.float32.*y.long\(\).*regr"),
        (torch.arange(60) % 3 - 1, r"'y' of 'train' must be classes from 0 \(got -1\)"),
        (torch.arange(60) % 4, r"'y' of 'train' must be classes from 0 to 2 \(got 3\)"),
        (torch.zeros(60, 3), r"must have shape \(S,\) .*got \(\d+, 3\).*is it task='multilabel'"),
        (None, r"the train part must have labels 'y' \(got none\); return them in the data set's"),
    ],
)
def test_labels_that_are_no_classes(labelled, y, match):
    model = Linear()
    with pytest.raises(ValueError, match=match):
        fit(TactileModule(model, num_classes=3), with_labels(labelled, y))
    assert model.calls == []  # before the first batch


@pytest.mark.parametrize(
    ("y", "task", "match"),
    [
        (torch.zeros(4), "multilabel", r"must have shape \(S, C\) .*got \(4,\).*'multiclass'"),
        (torch.full((4, 2), 0.5), "multilabel", r"must be 0 or 1 .*got 0.5 to 0.5.*'regression'"),
        (torch.zeros(4, 2), "multilabel", r"must have 3 numbers per sample.*\(got 2\)"),
        (torch.zeros(4).long(), "regression", r"floating-point .*got torch.int64.*y.float\(\)"),
        (torch.tensor([0.0, torch.nan]), "regression", r"'y' of 'part' must be finite"),
        (torch.zeros(4, 2, 2), "regression", r"must have shape \(S,\) or \(S, C\)"),
        (torch.zeros(4), "regression", r"must have 3 numbers per sample.*\(got 1\)"),
    ],
)
def test_labels_that_do_not_fit_their_task(y, task, match):
    with pytest.raises(ValueError, match=match):
        check_labels(y, task, "part", 3)


def test_empty_parts_and_good_labels_pass():
    check_labels(torch.empty(0).long(), "multiclass", "part", 3)
    check_labels(torch.empty(0, 3), "multilabel", "part", 3)
    check_labels(torch.tensor([[0, 1, 1]]), "multilabel", "part", 3)
    check_labels(torch.tensor([2]), "multiclass", "part", 3)
    check_labels(torch.zeros(4, 3), "regression", "part", 3)


def test_wrong_number_of_outputs_is_found_before_training(labelled):
    match = r"must return shape \(2, 3\) for 2 samples, one output for each class \(got \(2, 5\)\)"
    with pytest.raises(ValueError, match=match):
        fit(TactileModule(Linear(5)), TactileDataModule(labelled("multiclass")))


def test_missing_attribute_is_found_before_training(labelled):
    dataset = changed(labelled("multiclass"), joint=None)
    with pytest.raises(ValueError, match=r"the model needs 'joint' .*: use a data set with joint"):
        fit(TactileModule(Linear()), TactileDataModule(dataset))


def without_edges(labelled):
    return changed(labelled("multiclass"), edge_index=None, edge_attr=None)


EDGE_MODELS = {
    "GraspGCN": lambda: nn.GraspGCN(4, 3, in_channels=2, num_fingers=1),
    "TactileGCN": lambda: nn.TactileGCN(4, 3, channels={"tactile": 2}),
    "MTGCN": lambda: nn.MTGCN(4, 3, inputs=("tactile",), channels={"tactile": 2}),
}


@pytest.mark.parametrize("name", EDGE_MODELS)
def test_missing_edges_are_found_before_training(name, labelled):
    match = r"the model needs 'edge_index' \(the batch has \['joint', .*\): .*KNNGraph.*adjacency"
    with pytest.raises(ValueError, match=match):
        fit(TactileModule(EDGE_MODELS[name]()), TactileDataModule(without_edges(labelled)))


def test_missing_edges_of_a_model_that_does_not_declare_them(labelled):
    class Pyg(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.conv = GCNConv(2, 3)

        def forward(self, x, edge_index):
            return self.conv(x, edge_index).mean(dim=-2)

    class Hidden(Pyg):  # whose edges have a default
        def forward(self, x, edge_index=None):
            return super().forward(x, edge_index)

    for kind, match in (
        (Pyg, r"the model needs 'edge_index' \(the batch has .*\): .*KNNGraph\(k=2\)"),
        (Hidden, r"cannot be run without 'edge_index' \(\w+: .*\): .*KNNGraph\(k=2\), or .* adja"),
    ):
        with pytest.raises(ValueError, match=match):
            fit(TactileModule(kind()), TactileDataModule(without_edges(labelled)))
    fit(TactileModule(Pyg()), TactileDataModule(labelled("multiclass")))


def test_error_of_a_model_with_edges_stays_as_it_is(labelled):
    class Broken(Linear):
        def forward(self, x, edge_index, joint):
            raise KeyError("broken")

    with pytest.raises(KeyError, match="broken"):
        fit(TactileModule(Broken()), TactileDataModule(labelled("multiclass")))


PLAIN_MODELS = {
    "own": Linear,
    "TaxelNet": lambda: nn.TaxelNet(PAD, 3, in_channels=2),
    "PosedTaxelNet": lambda: nn.PosedTaxelNet(PAD, 3, in_channels=2, posed=False),
    "TemporalTaxelNet": lambda: nn.TemporalTaxelNet(PAD, 3),
    "TemporalCNN": lambda: nn.TemporalCNN(PAD, 3),
    "SmallCNN": lambda: nn.SmallCNN(PAD, 3, in_channels=2),
    "TactileFNN": lambda: nn.TactileFNN(4, 3, channels={"tactile": 2}, widths=(4,), pools=(2,)),
    "HandCNN": lambda: nn.HandCNN(PAD, 3, channels={"tactile": 2}),
    "MTCNN": lambda: nn.MTCNN(PAD, 3, inputs=("tactile",), channels={"tactile": 2}),
    "MTGCN of own edges": lambda: nn.MTGCN(
        4,
        3,
        inputs=("tactile",),
        channels={"tactile": 2},
        threads={"tactile": {"adjacency": [[0, 1], [1, 0]]}},
    ),
}


@pytest.mark.parametrize("name", PLAIN_MODELS)
def test_model_without_edges_is_trained_on_data_without(name, labelled):
    module = TactileModule(PLAIN_MODELS[name]())
    data = TactileDataModule(without_edges(labelled), val=0.2, test=0.2)
    trainer = fit(module, data)
    assert trainer.global_step > 0
    (metrics,) = trainer.test(module, datamodule=data, verbose=False)
    assert 0 <= metrics["test/accuracy"] <= 1
    (probabilities,) = trainer.predict(module, datamodule=data)
    assert probabilities.shape == (12, 3)


def test_one_look_without_gradients_that_leaves_all_as_it_was(labelled):
    model = Linear()
    module, data = TactileModule(model), TactileDataModule(labelled("multiclass"))
    trainer = fit(module, data, limit_train_batches=0, limit_val_batches=0)
    assert trainer.global_step == 0
    assert model.calls == [(2, False, False)]
    assert model.training
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    module.setup("fit")
    assert torch.rand(3).equal(expected)
    model.frozen.eval()
    module.setup("fit")
    assert (model.frozen.training, model.dropout.training) == (False, True)


def test_looks_where_the_weights_are_not_where_lightning_will_move_them(labelled):
    module, data = TactileModule(Linear(), num_classes=3), TactileDataModule(labelled("multiclass"))
    data.setup("fit")
    module._device = torch.device("meta")  # as Lightning names a GPU before the set-up
    check_data(module, data, "fit")
    assert module.model.calls == [(2, False, False)]


@pytest.mark.parametrize(
    ("task", "y", "match"),
    [
        ("multiclass", torch.arange(60) % 2, r"no sample of class 'slippery', which cannot be"),
        ("multilabel", torch.eye(3)[torch.arange(60) % 2], "only one value of label 'slippery'"),
    ],
)
def test_class_that_training_lacks_is_a_warning(labelled, task, y, match):
    data = TactileDataModule(changed(labelled(task), y=y))
    with pytest.warns(UserWarning, match=match):
        fit(TactileModule(Linear(), task=task), data, limit_train_batches=1)


def test_good_data_gives_no_warning(labelled):
    module = TactileModule(Linear())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = TactileDataModule(labelled("multiclass"))
        data.setup()
        module._set_num_classes(3)
        check_data(module, data, "fit")


def test_prediction_needs_no_labels(labelled):
    test = changed(labelled("multiclass"), y=None)
    data = TactileDataModule(labelled("multiclass"), test, val=0.0)
    (out,) = quiet_trainer().predict(TactileModule(Linear(), num_classes=3), datamodule=data)
    assert out.shape == (60, 3)


def test_empty_training_part(labelled):
    data = TactileDataModule(labelled("multiclass")[:0], val=0.0)
    with pytest.raises(ValueError, match="the training part must contain samples"):
        fit(TactileModule(Linear(), num_classes=3), data)


class Normed(torch.nn.Module):
    def __init__(self, norm, is_flat=False):
        super().__init__()
        self.norm, self.is_flat = norm, is_flat
        self.lin = torch.nn.Linear(2, 3)

    def forward(self, x, edge_index):
        batch = torch.arange(len(x), device=x.device).repeat_interleave(x.size(1))
        x = self.norm(x.flatten(0, 1), batch).view_as(x) if self.is_flat else self.norm(x)
        return self.lin(x.mean(dim=1))


@pytest.mark.parametrize("norm", [GraphNorm(2), LayerNorm(2), PairNorm()])
def test_norm_that_mixes_samples_is_noticed(labelled, norm):
    data = TactileDataModule(labelled("multiclass"), val=0.2)
    module = TactileModule(Normed(norm), num_classes=3)
    match = rf"'model.norm', PyG's {type(norm).__name__}, treats all samples .*mode='node'"
    with pytest.warns(UserWarning, match=match):
        fit(module, data, max_steps=1)
    assert not module.model.norm._forward_pre_hooks


@pytest.mark.parametrize("model", [Normed(LayerNorm(2, mode="node")), Normed(GraphNorm(2), True)])
def test_norm_that_keeps_samples_apart_is_not_warned_of(labelled, model):
    data = TactileDataModule(labelled("multiclass"), val=0.2)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fit(TactileModule(model, num_classes=3), data, max_steps=1)
    assert not [str(one.message) for one in caught if "treats all samples" in str(one.message)]
