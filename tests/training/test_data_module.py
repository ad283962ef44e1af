import pytest
import torch
from torch.utils.data import Subset
from torch_geometric.transforms import BaseTransform, Compose

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L

from torch_geometric_tactile.data import Protocol, Split, StaticDataset
from torch_geometric_tactile.data.splits import SharedDataWarning
from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.sensors import biotac, grid
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.transforms import DropTaxels, KNNGraph, SessionZScore, Tare, ZScore


def fake(split="train", **kwargs):
    kwargs.setdefault("pre_transform", KNNGraph(2))
    return FakeTactileDataset(90, split, **kwargs)


def test_scaling_is_fitted_on_the_training_part_only():
    dataset = fake()
    split = Split(torch.arange(60), torch.arange(60, 75), torch.arange(75, 90))
    data = TactileDataModule(dataset, split=split, transform=ZScore())
    data.setup()
    seen = dataset.data.x[:60]
    torch.testing.assert_close(data.transform.center[0].float(), seen.mean(0), rtol=1e-5, atol=1e-3)
    loaded = torch.cat([batch.x for batch in data.train_dataloader()])
    torch.testing.assert_close(loaded.mean(0), torch.zeros(24, 3), rtol=0, atol=1e-4)
    assert len(next(iter(data.val_dataloader())).y) == 15


@pytest.mark.parametrize(("count", "size", "expected"), [(33, 16, [16, 16]), (34, 16, [16, 16, 2])])
def test_no_training_batch_is_a_single_sample(count, size, expected):
    split = Split(torch.arange(count), torch.arange(count, count + 17), torch.arange(70, 90))
    data = TactileDataModule(fake(), split=split, batch_size=size)
    data.setup()
    assert [len(batch.y) for batch in data.train_dataloader()] == expected
    assert sum(len(batch.y) for batch in data.val_dataloader()) == 17  # nothing else is left out


@pytest.mark.parametrize("size", [1, 16])
def test_batches_of_one_sample_stay_where_there_are_no_others(size):
    split = Split(torch.arange(1), torch.arange(1, 3), torch.arange(3, 5))
    data = TactileDataModule(fake(), split=split, batch_size=size)
    data.setup()
    assert [len(batch.y) for batch in data.train_dataloader()] == [1]


class Normalized(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.lin, self.norm = torch.nn.Linear(24 * 3, 2), torch.nn.BatchNorm1d(2)

    def forward(self, x, edge_index):
        return self.norm(self.lin(x.flatten(1)))


def test_batch_normalisation_trains_whatever_the_number_of_samples():
    split = Split(torch.arange(17), torch.arange(17, 20), torch.arange(20, 25))
    data = TactileDataModule(fake(), split=split, batch_size=16)
    module = TactileModule(Normalized(), lambda weights: torch.optim.SGD(weights, lr=0.1))
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    trainer = L.Trainer(max_epochs=2, accelerator="cpu", **dict.fromkeys(off, False))
    trainer.fit(module, data)
    assert trainer.global_step == 2


def test_session_scaling_measures_new_sessions_without_touching_the_others():
    data = TactileDataModule(fake(), fake("test"), val=0.0, transform=SessionZScore())
    data.setup()
    assert data.transform.key_values.tolist() == [0, 1, 2, 3, 4, 5]
    assert data.test_sessions == {
        3: "palm_down_test",
        4: "palm_side_test",
        5: "palm_45_test",
    }
    held_out = torch.cat([batch.x for batch in data.test_dataloader()])
    torch.testing.assert_close(held_out.mean(0), torch.zeros(24, 3), rtol=0, atol=1e-3)


def test_transforms_are_fitted_one_after_the_other_and_the_callers_stay_unfitted():
    transform = Compose([Tare(), ZScore()])
    data = TactileDataModule(fake(), val=0.0, transform=transform)
    data.setup()
    assert transform.transforms[0].center is None
    assert data.transform.transforms[1].center.abs().max() < 1e-2


def test_augmentation_is_for_training_batches_only(labelled):
    data = TactileDataModule(
        labelled(transform=Shift(10.0)),
        labelled(seed=1),
        val=0.2,
        transform=ZScore(),
        train_transform=DropTaxels(taxels=[1], value=7.0),
        batch_size=64,
    )
    data.setup()
    (train,) = data.train_dataloader()
    assert (train.x[:, 1] == 7).all()  # after scaling, which would have moved it
    assert "dropped" in train
    rest = train.x[:, [0, 2, 3]]
    torch.testing.assert_close(rest.mean(0), torch.zeros(3, 2), rtol=0, atol=1e-5)
    plain = data.part("train").data.x + 10  # scaling has measured all taxels, after the data set's
    torch.testing.assert_close(data.transform.center[0].float(), plain.mean(0))
    for loader in (data.val_dataloader(), data.test_dataloader(), data.predict_dataloader()):
        (batch,) = loader
        assert "dropped" not in batch
        assert not (batch.x == 7).any()
    assert "dropped" not in data.example()


def test_augmentation_is_not_fitted(labelled):
    match = r"'train_transform' must not have fitted parts \(got ZScore\); put them into"
    with pytest.raises(ValueError, match=match):
        TactileDataModule(labelled(), train_transform=Compose([DropTaxels(), ZScore()]))


class Shift(BaseTransform):
    supports_static = True

    def __init__(self, by):
        self.by = by

    def forward(self, data):
        data.x = data.x + self.by
        return data


def test_example_has_the_shapes_of_a_batch_but_no_scaling(labelled):
    data = TactileDataModule(labelled(transform=Shift(1.0)), transform=ZScore(), val=0.0)
    example = data.example(3)  # before it is set up
    torch.testing.assert_close(example.x, data.dataset.data.x[[0, 29, 59]] + 1)
    data.setup()
    assert data.peek(data.part("train"), 60).x.mean(0).abs().max() < 1e-5  # scaled
    assert len(data.peek(data.part("test"), 2).x) == 0


@pytest.mark.parametrize("fold", [0, 2])
def test_protocol_says_what_is_held_out(fold):
    dataset = fake()
    protocol = Protocol("group", folds=3, val=0.2)
    data = TactileDataModule(dataset, split=protocol, seed=4, fold=fold)
    data.setup()
    loaders = (data.val_dataloader(), data.test_dataloader())
    held_out = [torch.cat([batch.trial for batch in loader]) for loader in loaders]
    expected = protocol.split(dataset, 4, fold)
    assert held_out[0].equal(expected.val)
    assert held_out[1].equal(expected.test)


def test_given_parts_are_those_of_two_data_sets():
    both = TactileDataModule(fake(None), split=Protocol("given"), transform=SessionZScore())
    two = TactileDataModule(fake(), fake("test"), val=0.0, transform=SessionZScore())
    for data in (both, two):
        data.setup()
    for a, b in zip(both.test_dataloader(), two.test_dataloader(), strict=True):
        assert a.x.equal(b.x)
        assert a.group.equal(b.group)


def test_protocol_leaves_no_other_fraction():
    with pytest.raises(ValueError, match=r"'val' must be left out with a protocol \(got 0.2\)"):
        TactileDataModule(fake(), split=Protocol("trial"), val=0.2)
    message = r"'test_dataset' must be left out .* test part \(got '3 folds by group'\)"
    with pytest.raises(ValueError, match=message):
        TactileDataModule(fake(), fake("test"), split=Protocol("group", folds=3))


def test_groups_are_not_torn_apart():
    data = TactileDataModule(fake(), split="group", val=0.3)
    data.setup()
    seen = {g for batch in data.train_dataloader() for g in batch.group.tolist()}
    held_out = {g for batch in data.val_dataloader() for g in batch.group.tolist()}
    assert len(held_out) == 3
    assert not seen & held_out


def test_state_is_taken_over():
    data = TactileDataModule(fake(), val=0.0, transform=SessionZScore())
    data.setup()
    other = TactileDataModule(fake(seed=3), val=0.0, transform=SessionZScore())
    other.load_state_dict(data.state_dict())
    torch.testing.assert_close(other.transform.center, data.transform.center)


def test_no_validation_part_gives_no_validation_batches():
    data = TactileDataModule(fake(), val=0.0)
    data.setup()
    assert len(data.val_dataloader()) == 0


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match=r"'split' must be a unit .*'session' \(got 'object'\)"):
        TactileDataModule(fake(), split="object")
    with pytest.raises(ValueError, match="'test' must be 0 if 'test_dataset' is given"):
        TactileDataModule(fake(), fake("test"), test=0.1)
    with pytest.raises(ValueError, match="'test_dataset' must have the layout 'biotac_sp'"):
        TactileDataModule(fake(), fake("test", layout=biotac()))
    data = TactileDataModule(fake())
    data.setup()
    with pytest.raises(ValueError, match="there is no test part"):
        data.test_dataloader()


def given_parts(labelled, **kwargs):
    parts = {name: labelled(seed=seed) for seed, name in enumerate(("train", "val", "test"))}
    data = TactileDataModule(
        parts["train"], parts["test"], val_dataset=parts["val"], batch_size=64, **kwargs
    )
    return parts, data


def test_parts_that_are_given_stay_apart(labelled):
    parts, data = given_parts(labelled, transform=ZScore())
    data.setup()
    mean = parts["train"].data.x.mean(0)
    torch.testing.assert_close(data.transform.center[0].float(), mean)
    for name, loader in (("val", data.val_dataloader()), ("test", data.test_dataloader())):
        (batch,) = loader
        expected = data.transform(parts[name].data)
        torch.testing.assert_close(batch.x, expected.x, rtol=0, atol=0)
        assert batch.x.mean(0).abs().max() > 0.05  # not scaled by itself
    assert len(next(iter(data.train_dataloader())).y) == 60


def test_parts_that_are_given_may_be_selections(labelled):
    dataset = labelled()
    data = TactileDataModule(
        dataset[:30], dataset[40:], split="group", val=0, val_dataset=dataset[30:40]
    )  # nothing is split, so that no group is needed
    data.setup()
    assert data.dataset.column("group") is None
    sizes = [
        sum(len(batch.y) for batch in loader())
        for loader in (data.train_dataloader, data.val_dataloader, data.test_dataloader)
    ]
    assert sizes == [30, 10, 20]


def test_classes_and_sessions_of_the_data(labelled):
    _, data = given_parts(labelled)
    assert data.test_sessions == {}  # before it is set up
    data.setup()
    assert data.test_sessions == {}  # there are none
    assert data.class_names == ["hard", "heavy", "slippery"]
    assert data.num_classes == TactileDataModule(labelled(names=())).num_classes == 3


def test_sessions_without_names_are_numbered(labelled):
    dataset = labelled()
    dataset._data.session = torch.arange(60) // 30 + 4
    data = TactileDataModule(labelled(), dataset)
    data.setup()
    assert data.test_sessions == {4: "4", 5: "5"}


def test_bad_validation_parts_are_named(labelled):
    with pytest.raises(ValueError, match=r"'val' must be 0 if 'val_dataset' is given \(got 0"):
        TactileDataModule(labelled(), val=0.1, val_dataset=labelled())
    with pytest.raises(ValueError, match=r"'val_dataset' must have the layout .*got 'biotac_sp'"):
        TactileDataModule(labelled(), val_dataset=fake())


@pytest.mark.parametrize("name", ["val_dataset", "test_dataset"])
def test_parts_that_number_their_names_otherwise_are_refused(name):
    def named(y, session):
        x = torch.rand(4, 4, 1)
        return StaticDataset.from_arrays(x, y * 2, session=session * 2, layout=grid(2, 2, 0.01))

    train, others = named(["cube", "ball"], ["a", "b"]), named(["cup", "ball"], ["a", "b"])
    match = (
        rf"'{name}' must have the class_names .*, \['ball', 'cube'\], .* \(got \['ball', 'cup'\]"
    )
    with pytest.raises(ValueError, match=match):
        TactileDataModule(train, split="frame", **{name: others})
    later = named(["cube", "ball"], ["b", "c"])
    TactileDataModule(train, split="frame", transform=ZScore(), **{name: later})
    with pytest.raises(ValueError, match=rf"'{name}' must have the session_names .*, \['a', 'b'\]"):
        TactileDataModule(train, split="frame", transform=SessionZScore(), **{name: later})


def test_data_sets_of_other_kinds_are_refused():
    with pytest.raises(TypeError, match=r"'dataset' must be a data set .*\(got StaticData\): give"):
        TactileDataModule(fake().data)
    with pytest.raises(TypeError, match=r"'dataset' must be a data set of PyG, .*\(got NoneType\)"):
        TactileDataModule(None)
    with pytest.raises(TypeError, match=r"'test_dataset' must be a StaticDataset, .*\(got list\)"):
        TactileDataModule(fake(), list(fake()))
    with pytest.raises(TypeError, match=r"'val_dataset' must be a PyG data set, like 'dataset' "):
        TactileDataModule(list(fake()), val_dataset=fake())
    with pytest.raises(ValueError, match=r"'test_dataset' must hold at least one sample"):
        TactileDataModule(list(fake()), [])


def test_subset_of_a_data_set_is_a_part_of_it():
    dataset = fake()
    data = TactileDataModule(Subset(dataset, [4, 2]), split="frame", val=0.0)
    assert data.layout is dataset.layout
    assert data.part("train")[0].x.equal(dataset[4].x)


def test_split_of_nothing_is_refused():
    with pytest.raises(ValueError, match=r"'split' must be a unit, .* \(got None\)"):
        TactileDataModule(FakeTactileDataset(4), split=None)


def test_given_indices_that_share_a_trial_are_told():
    x, trial = torch.randn(40, 6, 1), torch.arange(40) // 4
    dataset = StaticDataset.from_arrays(x, trial % 2, layout=grid(2, 3, pitch=0.01), trial=trial)
    even, odd = torch.arange(0, 40, 2), torch.arange(1, 40, 2)
    with pytest.warns(SharedDataWarning, match="10 trials are in more than one part"):
        TactileDataModule(dataset, split=Split(even, even[:0], odd)).setup()
