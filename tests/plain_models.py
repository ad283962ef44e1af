"""Small models of readings, of the papers and ours, and what they are given."""

import temporal_nets
import torch
from small_models import EDGE_INDEX, samples

from torch_geometric_tactile.nn import (
    BMFCNN,
    GraspGCN,
    GraspLSTM,
    PosedTaxelNet,
    SmallCNN,
    TaxelNet,
    TemporalCNN,
)
from torch_geometric_tactile.nn.models.bmf_cnn import _FUSIONS
from torch_geometric_tactile.sensors import biotac_sp, grid

GRID = grid(4, 5, pitch=0.004)  # 20 taxels, pooled to 6 and to 2
LETTERS = grid(20, 22, pitch=0.01)
TAXEL_NETS = {
    "flat_layout": {"layout": biotac_sp(), "out_channels": 2},
    "pooled": {"max_taxels": 2, "widths": (4, 6)},
    "self": {"conv": "self", "head": "max"},
    "difference": {"conv": "difference", "head": "mean", "depth": 1},
    "pyramid": {"max_taxels": 6, "head_taxels": 2, "depth": 1},
    "described": {"descriptor_channels": 3, "layout": biotac_sp()},
    "direct": {"direct_channels": 5, "head": "flat", "num_joints": 2, "num_sectors": 6},
}
POSED_NETS = {
    "posed": {},
    "open": {"posed": False},
    "pressure": {"in_channels": 1},
    "other": {"in_channels": 2, "posed": False},
}
GRASP_GCNS = {
    "data": {"fusion": "data"},
    "feature": {"fusion": "feature"},
    "finger": {"fusion": None, "finger": 1},
    "deep": {"fusion": "feature", "num_layers": 2, "out_channels": 4},
}
GRASP_LSTMS = {"all": {}, "finger": {"finger": 1, "num_layers": 2}}
TEMPORAL_CNNS = {"blocks": {"widths": (6, 6, 5)}, "one": {"widths": (6,), "kernel_sizes": (3,)}}


def taxel_net(name="pooled", **more):
    arguments = {"widths": (4,), "direct_channels": 0, **TAXEL_NETS[name], **more}
    return seeded(TaxelNet, **{"layout": GRID, "out_channels": 3, **arguments})


def posed_net(name="posed", **more):
    sizes = {"num_strongest": 6, "widths": (5, 7), "hidden_channels": 4}
    return seeded(PosedTaxelNet, GRID, 3, **{**sizes, **POSED_NETS[name], **more})


def bmf_cnn(fusion="bilinear(C1)+C3", layout=LETTERS, **more):
    sizes = {"in_channels": 2, "hidden_channels": 5}
    return seeded(BMFCNN, layout, 3, fusion=fusion, **{**sizes, **more})


def small_cnn(layout=GRID, **more):
    sizes = {"in_channels": 2, "widths": (4, 6), "hidden_channels": 5}
    return seeded(SmallCNN, layout, 3, **{**sizes, **more})


def seeded(make, *args, **kwargs):
    torch.manual_seed(0)
    return make(*args, **kwargs)


MODELS = {
    **{f"taxel_{name}": lambda name=name: taxel_net(name) for name in TAXEL_NETS},
    **{
        f"temporal_{n}": lambda n=n: temporal_nets.small(n)
        for n in (*temporal_nets.MODELS, *temporal_nets.POOLED)
    },
    **{f"posed_{name}": lambda name=name: posed_net(name) for name in POSED_NETS},
    **{f"bmf_{fusion}": lambda fusion=fusion: bmf_cnn(fusion) for fusion in _FUSIONS},
    **{f"gcn_{n}": lambda n=n: seeded(GraspGCN, 11, **GRASP_GCNS[n]) for n in GRASP_GCNS},
    **{
        f"lstm_{n}": lambda n=n: seeded(GraspLSTM, 4, hidden_channels=5, **GRASP_LSTMS[n])
        for n in GRASP_LSTMS
    },
    "small_cnn": small_cnn,
    **{
        f"cnn_{n}": lambda n=n: seeded(TemporalCNN, 4, 2, in_channels=3, **TEMPORAL_CNNS[n])
        for n in TEMPORAL_CNNS
    },
}


def given(model, batch_size, seed=0):
    """The inputs of a model, as keywords."""
    kind, num_taxels = type(model).__name__, model.num_nodes
    width = {"GraspGCN": 3, "GraspLSTM": 21}.get(kind, getattr(model, "in_channels", 0))
    if kind in ("TemporalCNN", "TemporalTaxelNet"):
        width *= 12
    size = (batch_size, num_taxels)
    found = {"x": samples(*size, width, seed=seed)}
    places = {
        "joint": samples(batch_size, model.num_joints or 1, seed=1),
        "pos": 0.1 * samples(*size, 3, seed=1),
        "normal": unit(*size, 3, seed=2),
        "tangent": unit(*size, 2, 3, seed=3),
    }
    found |= {name: places[name] for name in model.modalities}
    return found | ({"edge_index": EDGE_INDEX} if getattr(model, "needs_edges", False) else {})


def unit(*size, seed):
    return torch.nn.functional.normalize(samples(*size, seed=seed), dim=-1)


def trained(model):
    """After some steps, with statistics that are not those of the start, in evaluation mode."""
    optimizer = torch.optim.SGD(model.parameters(), 0.01)
    for seed in range(3):
        optimizer.zero_grad()
        model(**given(model, 16, seed)).square().mean().backward()
        optimizer.step()
    return model.eval()
