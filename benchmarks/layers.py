r"""Graph convolutions by themselves, forward and backward, against PyG's on the same graph.

Every row is one graph, one number of samples and one pair of widths. All sides are measured in turn
in one process, by the processor time of one thread; a ratio is the median over the rounds. The
sides:

* `batch`: PyG's layer on a `Batch`, which is the common way;
* `static`: PyG's layer on (B, N, F), where it takes that;
* `adj_t`: PyG's layer on a `Batch` with a sparse matrix of its blocks;
* `linear`: the linear map alone;
* `ours`.

glibc maps each tensor above 32 MiB anew, and clears it page by page, unless the process starts with
MALLOC_MMAP_MAX_=0 and MALLOC_TRIM_THRESHOLD_=8000000000. Both states are measured, in a process of
their own.

Examples:
    python benchmarks/layers.py
    python benchmarks/layers.py --layer self --nodes 384 --samples 128
    python benchmarks/layers.py --compiled --nodes 120 384 --samples 8 128
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from shared import (
    ALLOCATOR_STATES,
    in_turns,
    parse,
    print_setting,
    run_in_each_state,
    table,
    two_nearest_edges,
    write_json,
)
from torch import Tensor, nn
from torch_geometric.nn import GCNConv, GraphConv

from torch_geometric_tactile.nn import SegmentedGCNConv, SelfGCNConv, StaticGCNConv
from torch_geometric_tactile.sensors import allegro_uskin

_LAYERS = ("gcn", "self", "segmented")
_SECONDS = 0.03  # of one measurement, at least

OPTIONS = {
    "--layer": ("gcn", "which layer", _LAYERS),
    "--nodes": ([24, 120, 384, 1024, 2048], "taxels; 384 are those of the Allegro hand"),
    "--samples": ([1, 8, 32, 128], "samples in a batch"),
    "--widths": (["3-16", "32-32", "64-64"], "input and output features"),
    "--rounds": (5, "rounds, the sides in turn"),
    "--compiled": (False, "compare the compiled layers"),
    "--states": (list(ALLOCATOR_STATES), "allocator states", tuple(ALLOCATOR_STATES)),
    "--out": (Path, "file for the figures (JSON)"),
    "--child": (False, "print the figures of this process as JSON"),
}


def edges_of(num_nodes: int) -> Tensor:
    if num_nodes == 384:
        return allegro_uskin().edge_index("original")
    return two_nearest_edges(torch.rand(num_nodes, 3, generator=torch.Generator().manual_seed(0)))


def batch_edges(edge_index: Tensor, num_nodes: int, num_samples: int) -> Tensor:
    starts = num_nodes * torch.arange(num_samples).view(1, -1, 1)
    return (edge_index.unsqueeze(1) + starts).flatten(1)


class Loop(nn.Module):
    r"""A `GCNConv` for each segment, one after the other."""

    def __init__(self, segment: Tensor, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.segment = segment
        self.convs = nn.ModuleList(GCNConv(in_channels, out_channels) for _ in segment.unique())

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        out = x.new_empty(len(x), self.convs[0].out_channels)
        segment = self.segment.repeat(len(x) // len(self.segment))
        source, target = segment[edge_index]
        for number, conv in enumerate(self.convs):
            nodes = (segment == number).nonzero().view(-1)
            place = torch.empty_like(segment).scatter_(0, nodes, torch.arange(len(nodes)))
            edges = place[edge_index[:, (source == number) & (target == number)]]
            out = out.index_copy(0, nodes, conv(x[nodes], edges))
        return out


def make_sides(
    layer: str, num_nodes: int, num_samples: int, widths: tuple[int, int], compiled: bool
) -> dict[str, tuple[nn.Module, tuple[Any, ...], Tensor]]:
    torch.manual_seed(0)
    edge_index = edges_of(num_nodes)
    joined = batch_edges(edge_index, num_nodes, num_samples)
    x = torch.randn(num_samples, num_nodes, widths[0])
    flat = x.flatten(0, 1)
    grad = torch.randn(num_samples, num_nodes, widths[1])
    if layer == "segmented":
        segment = torch.arange(num_nodes) * 24 // num_nodes
        theirs: nn.Module = Loop(segment, *widths)
        ours: nn.Module = SegmentedGCNConv(segment, *widths)
    elif layer == "self":
        theirs, ours = GraphConv(*widths), SelfGCNConv(*widths, normalize=False)
    else:
        theirs, ours = GCNConv(*widths), StaticGCNConv(*widths)
    if layer != "segmented":
        ours.load_state_dict(theirs.state_dict())
        difference = (ours(x, edge_index).flatten(0, 1) - theirs(flat, joined)).abs().max()
        assert difference < 1e-4, difference
    static = (x, edge_index)
    if compiled:
        torch.compiler.reset()
        forms = {"static": (theirs, static), "ours": (ours, static)}
        return {name: (torch.compile(m, dynamic=False), a, grad) for name, (m, a) in forms.items()}
    sides = {
        "batch": (theirs, (flat, joined), grad.flatten(0, 1)),
        "linear": (nn.Linear(*widths), (x,), grad),
        "ours": (ours, static, grad),
    }
    if layer != "segmented":
        size = (num_nodes * num_samples,) * 2
        adj_t = torch.sparse_coo_tensor(joined.flip(0), torch.ones(joined.size(1)), size)
        sides["static"] = (theirs, static, grad)
        sides["adj_t"] = (theirs, (flat, adj_t.to_sparse_csr()), grad.flatten(0, 1))
    return sides


def measure(args: Any) -> list[dict[str, Any]]:
    torch.set_num_threads(1)
    rows = []
    for num_nodes in args.nodes:
        for num_samples in args.samples:
            for text in args.widths:
                first, last = map(int, text.split("-"))
                sides = make_sides(args.layer, num_nodes, num_samples, (first, last), args.compiled)
                calls = {name: repeated(step(*side)) for name, side in sides.items()}
                times = in_turns({n: c for n, (c, _) in calls.items()}, args.rounds, process_time)
                each = {
                    name: [1e3 * t / calls[name][1] for t in values]
                    for name, values in times.items()
                }
                rows.append(
                    {
                        "nodes": num_nodes,
                        "samples": num_samples,
                        "widths": text,
                        "ms": {name: statistics.median(values) for name, values in each.items()},
                        "ratios": {
                            name: statistics.median(
                                a / b for a, b in zip(values, each["ours"], strict=True)
                            )
                            for name, values in each.items()
                            if name != "ours"
                        },
                    }
                )
                print(rows[-1], file=sys.stderr, flush=True)
    return rows


def process_time() -> float:
    return time.process_time()


def step(module: nn.Module, inputs: tuple[Any, ...], grad: Tensor) -> Callable[[], None]:
    x = inputs[0].requires_grad_()
    parameters = list(module.parameters())

    def call() -> None:
        torch.autograd.grad(module(*inputs), [x, *parameters], grad)

    return call


def repeated(call: Callable[[], None]) -> tuple[Callable[[], None], int]:
    call()
    start = time.process_time()
    call()
    number = max(1, min(200, round(_SECONDS / max(time.process_time() - start, 1e-5))))

    def calls() -> None:
        for _ in range(number):
            call()

    return calls, number


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv)
    if args.child:
        print(json.dumps(measure(args)))
        return 0
    print_setting("torch", "torch_geometric", threads=1)
    states = run_in_each_state(__file__, argv, args.states)
    for state, rows in states.items():
        names = list(rows[0]["ms"])
        others = [name for name in names if name != "ours"]
        head = ["N", "B", "widths", *(f"{n}, ms" for n in names), *(f"{n} / ours" for n in others)]
        lines = [
            [
                str(row["nodes"]),
                str(row["samples"]),
                row["widths"],
                *(f"{row['ms'][name]:.3g}" for name in names),
                *(f"{row['ratios'][name]:.2f}" for name in others),
            ]
            for row in rows
        ]
        print(f"\n{ALLOCATOR_STATES[state][0]}\n", "\n".join(table(head, lines)), sep="\n")
    if args.out:
        write_json(args.out, states)
    return 0


if __name__ == "__main__":
    sys.exit(main())
