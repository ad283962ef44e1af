r"""Seconds of a training step with SectorConv, with PyG's RGCNConv, and with a loop over sectors,
on the hand with 384 taxels.

The three take the same samples in turn, so that whatever else the machine does meets all of them,
and the fastest of several rounds counts. RGCNConv gets what it takes, a block-diagonal batch. The
outputs are compared as well, with the same weights.

Examples:
    python benchmarks/sector_conv.py
    python benchmarks/sector_conv.py --widths 3 64 64 64 --rounds 10
"""

import sys
from functools import partial
from itertools import pairwise

import torch
from shared import in_turns, parse, run_in_both_states
from torch import Tensor
from torch.nn import Linear, Module, ModuleList
from torch.nn.functional import cross_entropy
from torch_geometric.nn import RGCNConv

from torch_geometric_tactile.nn import SectorConv
from torch_geometric_tactile.sensors import allegro_uskin, layout_sectors

_CLASSES = 6
_SECTORS = 8
_ALLOWED_DIFFERENCE = 1e-4
_KINDS = ("SectorConv", "RGCNConv", "loop over sectors")


OPTIONS = {
    "--widths": ([3, 32, 32, 64], "channels"),
    "--batch-size": (128, "samples in a batch"),
    "--rounds": (5, "timed steps of each"),
    "--threads": (1, "threads that torch may use"),
    "--at-least": (
        [1.5, 1.5],
        "how many times faster SectorConv must be than RGCNConv and the loop for the exit code 0",
    ),
}
EPILOG = "The exit code is 0 if SectorConv gives the same numbers and is fast enough, else 1."


class Net(Module):
    """Convolutions with ReLU, the mean over taxels, and the logits."""

    def __init__(self, kind: str, widths: list[int], batch_size: int) -> None:
        super().__init__()
        self.kind, self.batch_size = kind, batch_size
        self.convs = ModuleList(_conv(kind, *pair) for pair in pairwise(widths))
        self.lin = Linear(widths[-1], _CLASSES)

    def forward(self, x: Tensor, edge_index: Tensor, sector: Tensor) -> Tensor:
        for conv in self.convs:
            if self.kind == "loop over sectors":
                x = _loop(conv, x, edge_index, sector).relu()
            else:
                x = conv(x, edge_index, sector).relu()
        return self.lin(x.reshape(self.batch_size, -1, x.size(-1)).mean(dim=1))


def _conv(kind: str, before: int, after: int) -> Module:
    if kind == "SectorConv":
        return SectorConv(before, after, _SECTORS)
    if kind == "RGCNConv":
        return RGCNConv(before, after, _SECTORS, aggr="sum")
    return ModuleList(Linear(before, after, bias=s == 0) for s in range(1 + _SECTORS))


def _loop(lins: ModuleList, x: Tensor, edge_index: Tensor, sector: Tensor) -> Tensor:
    out = lins[0](x)
    for s in range(_SECTORS):
        source, target = edge_index[:, sector == s]
        out = out.index_add(1, target, lins[1 + s](x.index_select(1, source)))
    return out


def _same_weights(nets: dict[str, Net]) -> None:
    ours, rgcn, loop = (nets[kind] for kind in _KINDS)
    with torch.no_grad():
        for a, b, c in zip(ours.convs, rgcn.convs, loop.convs, strict=True):
            b.root.copy_(a.weight[0])
            b.weight.copy_(a.weight[1:])
            b.bias.copy_(a.bias)
            c[0].bias.copy_(a.bias)
            for lin, weight in zip(c, a.weight, strict=True):
                lin.weight.copy_(weight.t())
        for other in (rgcn, loop):
            other.lin.load_state_dict(ours.lin.state_dict())


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    status = run_in_both_states(__file__, argv)
    if status is not None:
        return status
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    layout, size = allegro_uskin(), args.batch_size
    edge_index, sector = layout_sectors(layout, _SECTORS)
    nets = {kind: Net(kind, args.widths, size) for kind in _KINDS}
    _same_weights(nets)
    x = torch.randn(size, layout.num_taxels, args.widths[0])
    y = torch.randint(_CLASSES, (size,))
    shift = layout.num_taxels * torch.arange(size).view(-1, 1, 1)
    joined = (edge_index + shift).transpose(0, 1).flatten(1), sector.repeat(size)
    inputs = dict.fromkeys(_KINDS, (x, edge_index, sector))
    inputs["RGCNConv"] = (x.flatten(0, 1), *joined)
    with torch.no_grad():
        outs = [nets[kind](*inputs[kind]) for kind in _KINDS]
    worst = max(float((out - outs[0]).abs().max()) for out in outs)

    def step(kind: str) -> None:
        nets[kind].zero_grad()
        cross_entropy(nets[kind](*inputs[kind]), y).backward()

    found = in_turns({kind: partial(step, kind) for kind in _KINDS}, args.rounds)
    seconds = {kind: min(taken) for kind, taken in found.items()}
    print(
        f"a training step, {layout.num_taxels} taxels, {len(sector)} edges, batch {size}, float32, "
        f"widths {args.widths}, {args.threads} thread(s), torch {torch.__version__}"
    )
    ratios = {kind: seconds[kind] / seconds["SectorConv"] for kind in _KINDS}
    for kind in _KINDS:
        print(f"{kind:20s} {seconds[kind] * 1e3:8.1f} ms   {ratios[kind]:5.2f}")
    print(f"largest difference of the outputs: {worst:.1e}")
    enough = all(ratios[k] >= least for k, least in zip(_KINDS[1:], args.at_least, strict=True))
    return 0 if enough and worst < _ALLOWED_DIFFERENCE else 1


if __name__ == "__main__":
    sys.exit(main())
