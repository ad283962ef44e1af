r"""Processor time of one frame with TemporalTaxelNet.step, and of the window computed anew for each
frame, as on a robot: what its last frame rests on, and all of its frames.

All take the same stream in turn, and the fastest of several rounds counts. Their logits are
compared as well.

Examples:
    python benchmarks/streaming.py
    python benchmarks/streaming.py --layouts allegro_uskin --streams 32
"""

import sys
import time
from argparse import Namespace
from itertools import pairwise

import torch
from shared import layout_or_grid, parse

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import TemporalTaxelNet

_CHANNELS = {"biotac": 3, "biotac_sp": 3, "allegro_uskin": 3}
_ALLOWED_DIFFERENCE = 1e-4


OPTIONS = {
    "--layouts": (
        ["biotac", "biotac_sp", "allegro_uskin", "28x50"],
        "names of layouts, or rows x columns of a grid",
    ),
    "--frames": (60, "frames of the window"),
    "--streams": ([1, 32], "samples at once"),
    "--rounds": (5, "times that the window goes by"),
    "--threads": (1, "threads that torch may use"),
    "--at-least": (5.0, "ratio, with all frames, for exit code 0"),
}
EPILOG = "The exit code is 0 if both give the same logits and a frame is fast enough, and 1 if not."


@torch.inference_mode()
def measure(name: str, streams: int, args: Namespace) -> tuple[list[float], float]:
    layout, channels = layout_or_grid(name), _CHANNELS.get(name, 1)
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
    args = parse(__doc__, OPTIONS, argv, EPILOG)
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
