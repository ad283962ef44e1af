"""A hand of eleven taxels, and one small model of each kind for it."""

import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.nn.conv import EdgePatchEncoder
from torch_geometric_tactile.nn.models import MSCNN, MTCNN, MTGCN, HandCNN, TactileFNN, TactileGCN
from torch_geometric_tactile.sensors import HandKinematics, Joint, TaxelLayout

# Two patches of four taxels and one of three, not in a row: a ring in each, and seams between them.
PATCH = torch.tensor([0, 2, 1, 0, 1, 2, 0, 1, 1, 2, 0])
RINGS = [(0, 3), (3, 6), (6, 10), (10, 0), (2, 4), (4, 7), (7, 8), (8, 2), (1, 5), (5, 9)]
SEAMS = [(0, 2), (3, 4), (6, 1)]
PAIRS = [*RINGS, *((b, a) for a, b in RINGS), *SEAMS]
HAND = HandKinematics(
    [
        Joint("a", "base", "middle", (0.0, 0.1, 0.2), (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), -1.0, 2.0),
        Joint("b", "middle", "tip", axis=(0.0, 0.0, 1.0)),
    ],
    name="finger",
)
LAYOUT = TaxelLayout(
    name="small",
    pos=0.01 * torch.rand(11, 3, generator=torch.Generator().manual_seed(0)),
    patch=PATCH,
    digit=(PATCH == 2).long(),
    patch_names=("first", "second", "third"),
    digit_names=("finger", "thumb"),
    adjacency={"original": torch.tensor(PAIRS).t(), "sparse": torch.tensor(PAIRS[:7]).t()},
    image_map=torch.cartesian_prod(torch.arange(3), torch.arange(5))[:11],
)
# Two patches of one finger and one of the thumb, each on 4 x 4 cells of which few have a taxel.
CORNERS = torch.tensor([[0, 0], [0, 3], [3, 0], [3, 3]])
FINGERS = TaxelLayout(
    name="fingers",
    pos=LAYOUT.pos,
    patch=torch.tensor([0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2]),
    digit=torch.tensor([0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1]),
    patch_names=("index_tip", "index_1", "thumb_tip"),
    digit_names=("index", "thumb"),
    image_map=torch.cat([CORNERS, CORNERS + torch.tensor([4, 0]), CORNERS[1:] + 4]),
)
EDGE_INDEX = LAYOUT.adjacency["original"]
NUM_EDGES = EDGE_INDEX.size(1)
SIZES = {
    "edge_attr": (NUM_EDGES, 4),
    "joint": (2,),
    "absolute": (11, 4),
    "pos": (11, 3),
    "normal": (11, 3),
    "tangent": (11, 2, 3),
}
ALL = ("tactile", "edge", "absolute", "position")
HEAD = {"head_widths": (6,), "head_pools": (2,)}
NARROW = {"widths": (4, 8), "pools": (1, 4)}

MODELS = {
    "gcn": lambda **more: TactileGCN(
        11, 3, inputs=ALL, num_edges=NUM_EDGES, num_joints=2, **NARROW, **HEAD, **more
    ),
    "gcn_message": lambda **more: TactileGCN(
        11, 3, inputs=ALL, encoder="message", **NARROW, **HEAD, **more
    ),
    "gcn_attention": lambda **more: TactileGCN(
        11,
        3,
        inputs=("edge", "tactile"),
        num_joints=2,
        encoder="attention",
        **NARROW,
        **HEAD,
        **more,
    ),
    "gcn_patch": lambda **more: TactileGCN(
        11, 3, inputs=("edge", "tactile"), encoder=EdgePatchEncoder(PATCH), **NARROW, **HEAD, **more
    ),
    "mt_gcn": lambda **more: MTGCN(
        11,
        3,
        inputs=("tactile", "edge"),
        threads={"tactile": NARROW, "edge": NARROW},
        num_edges=NUM_EDGES,
        num_joints=2,
        **HEAD,
        **more,
    ),
    "mt_gcn_adjacency": lambda **more: MTGCN(
        LAYOUT,
        3,
        inputs=("absolute", "tactile"),
        threads={"tactile": NARROW, "absolute": {"adjacency": "sparse", **NARROW}},
        **HEAD,
        **more,
    ),
    "whole": lambda **more: TactileGCN(LAYOUT, 3, **NARROW, **HEAD, **more),
    "digits": lambda **more: TactileGCN(
        LAYOUT, 3, segments="digit", inputs=("tactile", "position"), **NARROW, **HEAD, **more
    ),
    "patches": lambda **more: TactileGCN(
        LAYOUT,
        3,
        segments="patch",
        inputs=("tactile", "edge"),
        num_edges=NUM_EDGES,
        num_joints=2,
        **NARROW,
        **HEAD,
        **more,
    ),
    "fnn": lambda **more: TactileFNN(
        11, 3, inputs=("tactile", "absolute"), num_joints=2, widths=(8, 4), pools=(2, 1), **more
    ),
    "cnn": lambda **more: HandCNN(
        LAYOUT, 3, inputs=("tactile", "position"), num_joints=2, **NARROW, **HEAD, **more
    ),
    "mt_cnn": lambda **more: MTCNN(
        LAYOUT, 3, threads={"tactile": NARROW, "absolute": NARROW}, **HEAD, **more
    ),
    "ms_cnn": lambda **more: MSCNN(
        FINGERS, 3, pattern="VI", num_joints=2, hidden_channels=5, **more
    ),
    "ms_cnn_normal": lambda **more: MSCNN(
        FINGERS,
        3,
        pattern="VI",
        share_weights=True,
        channels=1,
        num_joints=0,
        hidden_channels=4,
        **more,
    ),
}
GRAPH_MODELS = [
    name
    for name in MODELS
    if name not in ("fnn", "cnn", "mt_cnn") and not name.startswith("ms_cnn")
]
EDGE_MODELS = [name for name in GRAPH_MODELS if "edge" in MODELS[name]().inputs]


def small_model(name, dtype=torch.float, seed=0, **more):
    torch.manual_seed(seed)
    return MODELS[name](**more).to(dtype)


def samples(*size, dtype=torch.float, seed=0):
    return torch.randn(size, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def inputs(model, batch_size, dtype=torch.float, shared=False, seed=0):
    """The inputs of a model, as keywords; with edge features of all samples if shared."""
    given = {"x": samples(batch_size, 11, 3, dtype=dtype, seed=seed), "edge_index": EDGE_INDEX}
    for i, name in enumerate(model.modalities):
        size = SIZES[name]
        if not (shared and name == "edge_attr"):
            size = (batch_size, *size)
        given[name] = samples(*size, dtype=dtype, seed=seed + 1 + i)
    return given


def sample(given, i):
    """One of the samples, as PyG's data."""
    one = {}
    for name, value in given.items():
        own = name != "edge_index" and not (name == "edge_attr" and value.dim() == 2)
        one[name] = (value[i : i + 1] if name == "joint" else value[i]) if own else value
    return Data.from_dict(one)


def loop(given):
    """The samples, one by one."""
    return [sample(given, i).to_dict() for i in range(len(given["x"]))]


def block_diagonal(given):
    """The samples as PyG's batch."""
    batch = Batch.from_data_list([sample(given, i) for i in range(len(given["x"]))])
    return {name: batch[name] for name in given}


def gradients(model, given, forms=None):
    """Outputs, and gradients of all parameters and of the inputs that were given."""
    leaves = {k: v.clone().requires_grad_() for k, v in given.items() if k != "edge_index"}
    rows = forms({"edge_index": given["edge_index"], **leaves}) if forms else None
    if rows is None:
        out = model(edge_index=given["edge_index"], **leaves)
    elif isinstance(rows, dict):
        out = model(**rows)
    else:
        out = torch.cat([model(**row) for row in rows])
    weight = samples(*out.shape, dtype=out.dtype, seed=9)
    tensors = {**leaves, **dict(model.named_parameters())}
    grads = torch.autograd.grad((out * weight).sum(), list(tensors.values()))
    return {"out": out.detach(), **dict(zip(tensors, grads, strict=True))}


def assert_close(found, expected, rtol=1e-9, atol=1e-11):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        torch.testing.assert_close(
            found[name], value, rtol=rtol, atol=atol, msg=lambda text, name=name: f"{name}: {text}"
        )
