"""The sizes of layers and models: each must be a whole number from one on."""

import inspect

import pytest
import torch
from small_models import FINGERS, LAYOUT

from torch_geometric_tactile import nn
from torch_geometric_tactile.sensors import grid

# What else they need, and what may be zero or is no size.
NEEDED = {
    "CNNThread": {"in_channels": 3, "image_map": torch.zeros(1, 2, dtype=torch.long)},
    "CausalTemporalConv": {"in_channels": 1, "out_channels": 1},
    "EdgeFeatureEncoder": {"num_nodes": 3, "num_edges": 2},
    "EdgePatchEncoder": {"segment": [0, 0, 1]},
    "GCNThread": {"in_channels": 3},
    "HandCNN": {"layout": LAYOUT},
    "MSCNN": {"layout": FINGERS, "pattern": "VI"},
    "MTCNN": {"layout": LAYOUT},
    "MTGCN": {"num_edges": 3},
    "PooledMLP": {"in_channels": 2, "out_channels": 2},
    "PosedTaxelNet": {"layout": LAYOUT, "out_channels": 2},
    "SectorConv": {"in_channels": 3, "out_channels": 5},
    "SegmentedGCNConv": {"segment": [0], "in_channels": 1, "out_channels": 1},
    "SegmentedThread": {"in_channels": 3, "segment": [0, 0, 1]},
    "SelfGCNConv": {"in_channels": 3, "out_channels": 5},
    "SmallCNN": {"layout": grid(4, 5, 0.01), "out_channels": 2},
    "TactileGCN": {"inputs": ("edge",), "num_edges": 3},
    "TactileModel": {"layout": 3, "out_channels": 2, "inputs": ("tactile",)},
    "TaxelNet": {"layout": LAYOUT, "out_channels": 2},
    "TemporalCNN": {"layout": LAYOUT, "out_channels": 2},
    "TemporalTaxelNet": {"layout": LAYOUT, "out_channels": 2},
    "TouchEncoder": {"layout": LAYOUT},
    "Thread": {"in_channels": 3, "widths": (4,), "pools": (1,), "conv": torch.nn.Linear},
}
# No sizes, and PyG's own.
OTHERS = {"BilinearFeature", "StaticGATConv", "StaticGATv2Conv", "StaticGCNConv", "TaxelPool"}
NO_SIZES = ("layout", "finger", "dim", "pool_dim", "channels", "conv")
NOT_NEGATIVE = {"num_joints", "direct_channels", "descriptor_channels", "mixed_channels"}


def arguments():
    """Of each class, its arguments that are whole numbers."""
    for name in sorted({*nn.__all__} - OTHERS):
        for parameter in inspect.signature(getattr(nn, name)).parameters.values():
            kind = str(parameter.annotation)
            if "int" in kind and "Sequence" not in kind and parameter.name not in NO_SIZES:
                yield name, parameter.name


def parameters_named(key):
    """The classes with an argument of that name."""
    return [name for name in nn.__all__ if key in inspect.signature(getattr(nn, name)).parameters]


def test_all_classes_have_sizes():
    assert {name for name, _ in arguments()} == {*nn.__all__} - OTHERS


@pytest.mark.parametrize(("name", "size"), list(arguments()))
def test_size_is_checked(name, size):
    value, least = (-1, "not be negative") if size in NOT_NEGATIVE else (0, "be at least 1")
    with pytest.raises(ValueError, match=rf"'{size}' must {least} \(got {value}\)"):
        getattr(nn, name)(**{**NEEDED.get(name, {}), size: value})


@pytest.mark.parametrize("name", parameters_named("widths"))
@pytest.mark.parametrize("widths", [(), (4, 0)])
def test_widths_are_checked(name, widths):
    match = r"'widths' must (hold at least one width|be 1 to 8 positive numbers).*\(got \("
    with pytest.raises(ValueError, match=match):
        getattr(nn, name)(**{**NEEDED.get(name, {}), "widths": widths})


@pytest.mark.parametrize("name", parameters_named("taxel_dropout"))
def test_taxel_dropout_is_checked(name):
    match = r"'taxel_dropout' must be at least 0 and below 1 \(got 1.0\)"
    with pytest.raises(ValueError, match=match):
        getattr(nn, name)(**NEEDED[name], taxel_dropout=1.0)
