r"""What a training step of P2's models keeps in memory: weights, gradients and the state of Adam,
which do not depend on the batch, and the activations that the backward pass needs, which do.

Examples:
    PYTHONPATH=benchmarks python studies/training_memory.py --batch 32
"""

import sys

import torch
from shared import parse, table
from torch import Tensor
from torch.autograd.graph import saved_tensors_hooks

from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.sensors import stock_layout

_SEGMENTS = {"X": None, "I": "digit", "II": "patch"}


def activations(model: TactileGCN, *inputs: Tensor) -> int:
    """Returns the bytes that autograd keeps for the backward pass, without the weights."""
    kept: dict[int, int] = {}
    weights = {weight.untyped_storage().data_ptr() for weight in model.parameters()}

    def pack(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in weights:
            kept[storage.data_ptr()] = storage.nbytes()
        return tensor

    with saved_tensors_hooks(pack, lambda tensor: tensor):
        loss = model(*inputs).sum()  # whose graph keeps what was packed alive
    total = sum(kept.values())
    loss.backward()
    return total


def main() -> int:
    """Prints the table."""
    arguments = parse(__doc__, {"--batch": (32, "samples"), "--classes": (8, "objects")})
    layout = stock_layout("allegro_uskin")
    x = torch.randn(arguments.batch, layout.num_taxels, 3)
    rows, first = [], None
    for name, segments in _SEGMENTS.items():
        sizes = []
        for fast in (False, True):
            model = TactileGCN(layout, arguments.classes, segments=segments, fast=fast).train()
            sizes.append(activations(model, x, layout.edge_index("original")) / 1e6)
        first = first or sizes
        weights = sum(weight.nbytes for weight in model.parameters()) / 1e6
        shares = [size / whole for size, whole in zip(sizes, first, strict=True)]
        rows.append(
            [
                name,
                f"{4 * weights:.0f}",
                *(f"{size:.1f} ({share:.2f})" for size, share in zip(sizes, shares, strict=True)),
                f"{(4 * weights + sizes[1]):.0f}",
            ]
        )
    header = [
        "segmentation",
        "weights, gradients, Adam (MB)",
        "activations (MB), plain",
        "fast path",
        "sum (MB)",
    ]
    print("\n".join(table(header, rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
