r"""Processor time of one frame with TemporalTaxelNet.step, and of the window computed anew for each
frame, as on a robot: what its last frame rests on, and all of its frames.

All take the same stream in turn, and the fastest of several rounds counts. Their logits are
compared as well.

Examples:
    python benchmarks/streaming.py
    python benchmarks/streaming.py --layouts allegro_uskin --streams 32
"""

import argparse
import sys
import time
from itertools import pairwise

import torch

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import TemporalTaxelNet
from torch_geometric_tactile.sensors import TaxelLayout, grid, stock_layout

_CHANNELS = {"biotac": 3, "biotac_sp": 3, "allegro_uskin": 3}
_ALLOWED_DIFFERENCE = 1e-4


def parse(argv: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Measures a frame of a stream against the window computed anew.",
        epilog=(
            "The exit code is 0 if both give the same logits and a frame is fast enough, and 1 if "
            "not."
        ),
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument(
        "--layouts",
        nargs="+",
        default=["biotac", "biotac_sp", "allegro_uskin", "28x50"],
        help="names of layouts, or rows x columns of a grid",
    )
    parser.add_argument("--frames", type=int, default=60, help="frames of the window")
    parser.add_argument("--streams", type=int, nargs="+", default=[1, 32], help="samples at once")
    parser.add_argument("--rounds", type=int, default=5, help="times that the window goes by")
    parser.add_argument("--threads", type=int, default=1, help="threads that torch may use")
    parser.add_argument(
        "--at-least", type=float, default=5.0, help="ratio, with all frames, for exit code 0"
    )
    return parser.parse_args(argv)


def _layout(name: str) -> TaxelLayout:
    if "x" in name and name.replace("x", "").isdigit():
        rows, cols = map(int, name.split("x"))
        return grid(rows, cols, 0.003)
    return stock_layout(name)


@torch.inference_mode()
def measure(name: str, streams: int, args: argparse.Namespace) -> tuple[list[float], float]:
    layout, channels = _layout(name), _CHANNELS.get(name, 1)
    torch.manual_seed(0)
    model = TemporalTaxelNet(layout, 2, in_channels=channels).eval()
    frames = torch.randn(streams, layout.num_taxels, args.frames, channels)
    window = join_frames(frames)
    best = [float("inf")] * 3
    for _ in range(args.rounds):
        state = model.initial_state(streams)
        times = [time.process_time()]
        for t in range(args.frames):
            out, state = model.step(frames[:, :, t], None, state)
        times.append(time.process_time())
        last = model(window)
        times.append(time.process_time())
        every = model(window, per_frame=True)
        times.append(time.process_time())
        taken = [after - before for before, after in pairwise(times)]
        taken[0] /= args.frames
        best = [min(pair) for pair in zip(best, taken, strict=True)]
    return best, max(float((out - other).abs().max()) for other in (last, every[:, -1]))


def main(argv: list[str] | None = None) -> int:
    args = parse(argv)
    torch.set_num_threads(args.threads)
    print(
        f"a window of {args.frames} frames, float32, {args.threads} thread(s), torch "
        f"{torch.__version__}"
    )
    is_good = True
    for name in args.layouts:
        for streams in args.streams:
            (step, last, every), worst = measure(name, streams, args)
            print(
                f"{name:14s} {streams:3d} stream(s): {step * 1e3:7.2f} ms a frame; a window "
                f"{last * 1e3:7.2f} ms, {last / step:4.1f} times; with all frames "
                f"{every * 1e3:8.2f} ms, {every / step:5.1f} times; difference {worst:.0e}"
            )
            is_good &= every / step >= args.at_least and worst < _ALLOWED_DIFFERENCE
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
