"""Small temporal nets of each kind, and what they are given."""

import torch
from small_models import samples

from torch_geometric_tactile.nn import TemporalTaxelNet
from torch_geometric_tactile.sensors import biotac_sp, grid

EDGES = torch.tensor([[0, 1], [1, 0]])

# 20 taxels, pooled to 6 and to 2.
SMALL = grid(4, 5, pitch=0.004)

MODELS = {
    "electrodes": {"layout": biotac_sp(), "in_channels": 3},
    "pooled": {"max_taxels": 2, "widths": (4, 6), "depth": 2},
    "self": {"conv": "self", "filter_size": 1, "kernel_size": 2, "dilation": 3},
    "difference": {"conv": "difference", "dilation": 1, "num_blocks": 3, "in_channels": 1},
    "joints": {"num_joints": 2, "num_sectors": 6, "filter_size": 4, "kernel_size": 1},
    "mixed": {"mixed_channels": 5, "max_taxels": 8, "dilation": 2},
    "readings": {"num_filters": None, "hidden_channels": None, "dilation": 2},
    "mixed_readings": {"num_filters": None, "mixed_channels": 5, "in_channels": 3},
}

# Of windows that are judged as a whole, which cannot be streamed.
POOLED = {
    "mean": {"pool": "mean", "dilation": 2},
    "mixed_mean_max": {"pool": "mean_max", "mixed_channels": 5, "filter_size": 1, "num_joints": 2},
}

FIELDS = {
    "electrodes": 9,
    "pooled": 9,
    "self": 10,
    "difference": 17,
    "joints": 4,
    "mixed": 17,
    "readings": 13,
    "mixed_readings": 9,
}


def small(name="pooled", **more):
    torch.manual_seed(0)
    arguments = {
        "in_channels": 2,
        "num_filters": 4,
        "filter_size": 3,
        "widths": (4,),
        "dilation": 1,
        "num_blocks": 2,
        "hidden_channels": 8,
        **{**MODELS, **POOLED}[name],
        **more,
    }
    return TemporalTaxelNet(**{"layout": SMALL, "out_channels": 3, **arguments})


def given(model, batch_size, num_frames=12, seed=0, dtype=torch.float):
    """The inputs, as keywords."""
    size = (batch_size, model.num_nodes, model.in_channels * num_frames)
    found = {"x": samples(*size, seed=seed, dtype=dtype)}
    if model.num_joints:
        found["joint"] = samples(batch_size, model.num_joints, seed=1, dtype=dtype)
    return found


def trained(model):
    """After some steps, with statistics that are not those of the start, in evaluation mode."""
    optimizer = torch.optim.SGD(model.parameters(), 0.01)
    for seed in range(3):
        optimizer.zero_grad()
        model(**given(model, 16, seed=seed)).square().mean().backward()
        optimizer.step()
    return model.eval()
