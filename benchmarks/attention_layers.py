r"""Times of a training step with attention layers on (B, N, F) beside PyG's on a `Batch`.

Three layers of some heads on a sensor of 120 taxels, each joined with its nearest, one thread,
processor time of a forward and a backward pass. Both nets take the same samples in turn, so that
whatever else the machine does meets both, and the median of five pairs counts. As usually started,
glibc maps, clears and gives back every tensor above 32 MiB at each operation; the same is measured
without these page faults, in a process of its own. Outputs and gradients are compared in double
precision.

Examples:
    python benchmarks/attention_layers.py
    python benchmarks/attention_layers.py --batch-sizes 8 --heads 1
"""

import json
import statistics
import sys
import time
from functools import partial
from itertools import pairwise

import torch
from shared import (
    ALLOCATOR_STATES,
    describe_machine,
    in_turns,
    parse,
    run_in_each_state,
    table,
    versions,
)
from torch import Tensor
from torch.nn import Module, ModuleList
from torch_geometric.nn import GATConv, GATv2Conv

from torch_geometric_tactile.nn import StaticGATConv, StaticGATv2Conv
from torch_geometric_tactile.sensors import grid

_PAIRS = {"GAT": (StaticGATConv, GATConv), "GATv2": (StaticGATv2Conv, GATv2Conv)}
_ALLOWED_DIFFERENCE = 1e-9
_SECONDS_OF_A_ROUND = 0.2

OPTIONS = {
    "--batch-sizes": ([1, 8, 32, 128], "samples in a batch"),
    "--neighbours": (4, "neighbours of each taxel"),
    "--heads": (4, "heads of each layer"),
    "--channels": (32, "channels of each head"),
    "--layers": (3, "layers"),
    "--rounds": (5, "pairs of timed steps"),
    "--threads": (1, "threads that torch may use"),
    "--child": (False, "print the figures of this process as JSON"),
}
EPILOG = "The exit code is 0 if outputs and gradients are those of PyG, else 1."


class Net(Module):
    """Attention layers with ReLU."""

    def __init__(self, layer: type[Module], widths: list[int], heads: int) -> None:
        super().__init__()
        self.convs = ModuleList(
            layer(before, after // heads, heads=heads) for before, after in pairwise(widths)
        )

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        for conv in self.convs:
            x = conv(x, edge_index).relu()
        return x


def _edges(num_neighbours: int) -> tuple[Tensor, int]:
    layout = grid(10, 12, 0.003)
    distance = torch.cdist(layout.pos, layout.pos).fill_diagonal_(torch.inf)
    near = distance.topk(num_neighbours, largest=False).indices.flatten()
    taxel = torch.arange(layout.num_taxels).repeat_interleave(num_neighbours)
    return torch.stack([near, taxel]), layout.num_taxels


def _step(net: Net, x: Tensor, edge_index: Tensor) -> None:
    net.zero_grad()
    net(x, edge_index).square().mean().backward()


def _repeat(call: partial[None], count: int) -> None:
    for _ in range(count):
        call()


def _worst(nets: list[Net], inputs: list[tuple[Tensor, Tensor]]) -> float:
    # The largest difference, as a part of the largest number of each tensor.
    found: list[list[Tensor]] = []
    for net, (x, edge_index) in zip(nets, inputs, strict=True):
        net.double()
        x = x.double().requires_grad_()
        out = net(x, edge_index)
        grads = torch.autograd.grad(out.square().sum(), [x, *net.parameters()])
        found.append([out.detach().flatten(), *(grad.flatten() for grad in grads)])
        net.float()
    ratios = [
        float((ours - theirs).abs().max() / theirs.abs().max())
        for ours, theirs in zip(*found, strict=True)
    ]
    return max(ratios)


def measure(args: object) -> list[dict[str, object]]:
    """Returns a row for each kind of layer and size of batch."""
    edge_index, num_taxels = _edges(args.neighbours)
    widths = [3, *[args.heads * args.channels] * args.layers]
    rows = []
    for name, layers in _PAIRS.items():
        nets = [Net(layer, widths, args.heads) for layer in layers]
        nets[1].load_state_dict(nets[0].state_dict())
        for size in args.batch_sizes:
            x = torch.randn(size, num_taxels, 3)
            shift = num_taxels * torch.arange(size).view(-1, 1, 1)
            joined = (edge_index + shift).transpose(0, 1).flatten(1)
            inputs = [(x, edge_index), (x.flatten(0, 1), joined)]
            worst = _worst(nets, inputs)
            calls = [partial(_step, net, *pair) for net, pair in zip(nets, inputs, strict=True)]
            start = time.process_time()
            _repeat(calls[1], 2)
            seconds = (time.process_time() - start) / 2
            count = max(1, int(_SECONDS_OF_A_ROUND / seconds))
            steps = {str(i): partial(_repeat, call, count) for i, call in enumerate(calls)}
            taken = in_turns(steps, args.rounds, clock=time.process_time)
            ours, theirs = ([s / count for s in taken[key]] for key in ("0", "1"))
            rows.append(
                {
                    "layer": name,
                    "batch": size,
                    "ours": statistics.median(ours),
                    "pyg": statistics.median(theirs),
                    "ratio": statistics.median(b / a for a, b in zip(ours, theirs, strict=True)),
                    "difference": worst,
                }
            )
    return rows


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    if args.child:
        print(json.dumps(measure(args)))
        return 0
    states = run_in_each_state(__file__, argv, list(ALLOCATOR_STATES))
    print(
        f"a training step, 120 taxels, {args.neighbours} neighbours each and itself, "
        f"{args.layers} layers of {args.heads} x {args.channels}, float32, processor time, "
        f"{args.threads} thread(s)"
    )
    print(f"{describe_machine()}; {versions('torch', 'torch_geometric')}")
    head = ["layer", "batch"]
    for title, _ in ALLOCATOR_STATES.values():
        head += [f"PyG, {title.partition(':')[0].lower()}", "ours", "ratio"]
    lines = []
    for rows in zip(*states.values(), strict=True):
        line = [f"`Static{rows[0]['layer']}Conv`", str(rows[0]["batch"])]
        for row in rows:
            line += [f"{row['pyg'] * 1e3:.1f} ms", f"{row['ours'] * 1e3:.1f} ms"]
            line += [f"**{row['ratio']:.1f}**"]
        lines.append(line)
    print("\n".join(table(head, lines)))
    worst = max(row["difference"] for rows in states.values() for row in rows)
    print(f"largest relative difference of outputs and gradients in float64: {worst:.1e}")
    return 0 if worst < _ALLOWED_DIFFERENCE else 1


if __name__ == "__main__":
    sys.exit(main())
