import json
from dataclasses import replace
from functools import partial

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
import yaml
from torch_geometric.transforms import BaseTransform, Compose
from training_fixtures import quiet_trainer

from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.nn import models
from torch_geometric_tactile.sensors import TaxelLayout, biotac_sp, grid
from torch_geometric_tactile.training import (
    TactileDataModule,
    TactileModule,
    classifier_from_config,
)
from torch_geometric_tactile.training._layout_text import layout_from_text, layout_to_text
from torch_geometric_tactile.training._sizes import DataSizes, fill_sizes
from torch_geometric_tactile.transforms import GeometricEdgeAttr, KNNGraph, ZScore


class Layered(torch.nn.Module):
    """A model with every size that can be filled in."""

    modalities = ("joint",)

    def __init__(
        self,
        layout: TaxelLayout | str,
        num_taxels: int,
        in_channels: int,
        out_channels: int,
        num_edges: int,
        num_joints: int,
        channels: dict[str, int] | None = None,
        width: int = 8,
    ):
        super().__init__()
        self.layout = layout
        self.sizes = (num_taxels, in_channels, out_channels, num_edges, num_joints, width)
        self.channels = channels
        self.lin = torch.nn.Linear(num_taxels * in_channels + num_joints, out_channels)

    def forward(self, x, edge_index, joint):
        return self.lin(torch.cat([x.flatten(1), joint], dim=1))


class HandedOn(Layered):
    """A model that takes its sizes through keywords, and has joints as a choice."""

    def __init__(self, num_joints: int = 0, **kwargs):
        super().__init__(num_joints=num_joints, **kwargs)


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "test_sizes", sys.modules[Layered.__module__])
    monkeypatch.setattr(Layered, "__module__", "test_sizes")
    monkeypatch.setattr(HandedOn, "__module__", "test_sizes")


def config(name="Layered", **init_args):
    return {"model": {"class_path": f"test_sizes.{name}", "init_args": init_args}}


def filled(data, name="Layered", **init_args):
    return fill_sizes(config(name, **init_args), data)["model"]["init_args"]


def grasps(**kwargs):
    return TactileDataModule(FakeTactileDataset(60, pre_transform=KNNGraph(2), **kwargs))


def test_every_size_is_taken_from_the_data(labelled):
    data = TactileDataModule(labelled("multiclass"))
    found = filled(data)
    layout = found.pop("layout")
    assert found == {
        "num_taxels": 4,
        "in_channels": 2,
        "out_channels": 3,
        "num_edges": 8,
        "num_joints": 3,
        "channels": {"tactile": 2, "edge": 4},
    }
    assert layout_from_text(layout).matches(data.layout)


def test_sizes_are_those_after_all_transforms(labelled):
    steps = Compose([Posed(), ZScore(attr="pos"), GeometricEdgeAttr()])
    bare = labelled("multiclass")
    del bare._data.edge_attr
    assert DataSizes.from_data(TactileDataModule(bare)).channels == {"tactile": 2}
    sizes = DataSizes.from_data(TactileDataModule(bare, transform=steps))
    assert (sizes.num_edges, sizes.channels) == (8, {"tactile": 2, "edge": 4, "position": 3})


class Posed(BaseTransform):
    supports_static = True

    def forward(self, data):
        data.pos = torch.cartesian_prod(torch.arange(2.0), torch.arange(2.0), torch.zeros(1))
        data.normal = torch.tensor([[0.0, 0.0, 1.0]]).expand(4, 3)
        return data


def test_stock_layout_is_a_name():
    data = grasps()
    assert data.layout.matches(biotac_sp())
    found = filled(data, num_joints=0)
    assert found["layout"] == "biotac_sp"


def test_joints_are_a_choice(labelled):
    data = TactileDataModule(labelled("multiclass"))
    assert "num_joints" not in filled(data, "HandedOn")
    assert filled(data, "HandedOn", num_joints=None)["num_joints"] == 3
    assert filled(data, "HandedOn", num_joints=0)["num_joints"] == 0
    assert filled(data, "HandedOn")["out_channels"] == 3  # through **kwargs
    match = "'num_joints' of HandedOn must be left out or 0, because the data has no joint angles"
    with pytest.raises(ValueError, match=match):
        filled(grasps(), "HandedOn", num_joints=None)


def test_channels_of_one_finger():
    grasp = {"model": {"class_path": "GraspGCN"}}
    assert fill_sizes(grasp, grasps())["model"]["init_args"]["in_channels"] == 1
    grasp["model"]["init_args"] = {"num_fingers": 2}
    with pytest.raises(ValueError, match=r"'num_fingers' of GraspGCN must divide the 3 .*got 2"):
        fill_sizes(grasp, grasps())


@pytest.mark.parametrize("name", ["TaxelNet", "PosedTaxelNet"])
def test_sizes_of_our_own_models(labelled, name):
    data = TactileDataModule(labelled("multiclass"))
    config = fill_sizes({"model": {"class_path": name}}, data)
    arguments = config["model"]["init_args"]
    assert set(arguments) == {"layout", "in_channels", "out_channels"}
    model = getattr(models, name)(**{**arguments, "layout": layout_from_text(arguments["layout"])})
    assert model.num_nodes == 4
    sample = data.example()
    assert (model.in_channels, model.out_channels) == (sample.x.size(-1), 3)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"num_edges": 9}, r"'num_edges' of Layered must be 8, as in the data \(got 9\); leave it"),
        ({"num_taxels": 24}, r"'num_taxels' of Layered must be 4"),
        ({"out_channels": 2}, r"'out_channels' of Layered must be 3"),
        ({"num_joints": 16}, r"'num_joints' of Layered must be 3"),
        (
            {"layout": "biotac"},
            r"'layout' of Layered must be 'grid_2x2' with 4 taxels.*got .*'biotac'",
        ),
        ({"channels": {"edge": 3}}, r"'channels' of Layered for 'edge' must be 4"),
    ],
)
def test_wrong_size_is_named(labelled, given, match):
    with pytest.raises(ValueError, match=match):
        filled(TactileDataModule(labelled("multiclass")), **given)


def test_more_classes_than_seen_are_no_error_without_names(labelled):
    data = TactileDataModule(labelled("multiclass", names=()))
    assert filled(data, out_channels=5)["out_channels"] == 5
    with pytest.raises(ValueError, match="'out_channels' of Layered must be at least 3"):
        filled(data, out_channels=2)


def test_given_sizes_and_the_configuration_stay(labelled):
    data = TactileDataModule(labelled("multiclass"))
    given = config(num_edges=8, width=5)
    before = json.dumps(given)
    found = fill_sizes(given, data)
    assert (found["model"]["init_args"]["width"], found["num_classes"]) == (5, 3)
    assert json.dumps(given) == before


@pytest.mark.parametrize("model", [{"class_path": "nowhere.Net"}, {"class_path": "Nothing"}, None])
def test_unknown_classes_are_left_to_their_builder(labelled, model):
    assert fill_sizes({"model": model}, TactileDataModule(labelled()))["model"] == model


def test_module_of_an_own_model_is_loaded_again(labelled, tmp_path):

    data = TactileDataModule(labelled("multiclass"))
    classifier = classifier_from_config(config(), data)
    assert classifier.model.sizes == (4, 2, 3, 8, 3, 8)
    assert classifier.num_classes == 3
    trainer = quiet_trainer()
    trainer.strategy.connect(classifier)
    trainer.save_checkpoint(tmp_path / "one.ckpt")
    own = classifier_from_config(config(), data).model
    again = TactileModule.load_from_checkpoint(tmp_path / "one.ckpt", model=own)
    assert again.model.sizes == classifier.model.sizes
    assert again.model.layout.matches(data.layout)
    for name, value in classifier.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value, rtol=0, atol=0)


def test_filling_uses_up_no_random_number(labelled):
    draw = partial(torch.rand, 3)
    data = TactileDataModule(labelled("multiclass"), transform=Noise())
    torch.manual_seed(0)
    expected = draw()
    torch.manual_seed(0)
    fill_sizes(config(), data)
    assert draw().equal(expected)


class Noise(BaseTransform):
    supports_static = True

    def forward(self, data):
        data.x = data.x + torch.randn_like(data.x)
        return data


def test_filled_configuration_is_plain_data(labelled):
    found = fill_sizes(config(), TactileDataModule(labelled("multiclass")))
    assert yaml.safe_load(yaml.safe_dump(found)) == json.loads(json.dumps(found)) == found


def test_layout_may_be_a_file(tmp_path, labelled):
    path = str(tmp_path / "pad.json")
    data = TactileDataModule(labelled("multiclass"))
    data.layout.save(path)
    assert filled(data, layout=path)["layout"] == path
    module = classifier_from_config(config(layout=path), data)
    assert module.model.layout.matches(data.layout)
    with pytest.raises((ValueError, OSError), match=r"nowhere\.json"):
        filled(data, layout="nowhere.json")


class Strict(torch.nn.Module):
    def __init__(self, layout: TaxelLayout):
        super().__init__()


def test_layout_that_no_configuration_can_hold(labelled):
    with pytest.raises(ValueError, match=r"'layout' of Strict must accept text.*Layout \| str"):
        filled(TactileDataModule(labelled("multiclass")), "Strict")


def test_content_of_a_layout_is_one_text_for_the_parser():
    layout = grid(2, 2, pitch=0.01)
    layout = replace(layout, name="my pad: v2 # {old}", source='said: "so", it is')
    text = layout_to_text(layout)
    assert yaml.safe_load(text) == text  # no mapping, no comment
    again = layout_from_text(text)
    assert again.to_dict() == layout.to_dict()
    with pytest.raises(FileNotFoundError, match="nowhere"):
        layout_from_text("nowhere.json")


@pytest.mark.parametrize(
    ("encoder", "filled"),
    [
        ("my_nets.MyEncoder", {"class_path": "my_nets.MyEncoder"}),
        ({"class_path": "my_nets.MyEncoder"}, {"class_path": "my_nets.MyEncoder"}),
        ("message", "message"),
    ],
    ids=["path", "class", "name"],
)
def test_a_module_as_an_argument_may_be_named_by_its_path(encoder, filled):
    init_args = {"inputs": ["tactile", "edge"], "encoder": encoder}
    data = TactileDataModule(FakeTactileDataset(20, pre_transform=KNNGraph(2)))
    section = fill_sizes({"model": {"class_path": "TactileGCN", "init_args": init_args}}, data)
    assert section["model"]["init_args"]["encoder"] == filled
    assert init_args["encoder"] == encoder
