r"""Milliseconds of one image with the models of the letters, as ONNX, eager and compiled, on one
thread, and seconds of an epoch; and one frame of the hand with MSCNN.

Images are random: no figure here depends on what they are. All models take turns in one run, such
that whatever else the machine does meets all of them. Of one image the fastest call and the median
are told, of an epoch the fastest one.

Examples:
    python benchmarks/letter_models.py
    python benchmarks/letter_models.py --only image --forms onnx --models BMF-CNN CNN
    python benchmarks/letter_models.py --out letter_models.json
"""

import argparse
import copy
import shutil
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from shared import describe_machine, in_turns, parse, write_json
from torch import Tensor, nn
from torch.nn import functional as F

from torch_geometric_tactile.nn import BMFCNN, MSCNN, TaxelNet
from torch_geometric_tactile.sensors import letter_array

_FORMS = ("onnx", "eager", "compiled")
_LETTERS = 26
_ALLOWED_DIFFERENCE = 1e-4
_TARGETS = {("BMF-CNN", "onnx"): 0.25, ("MS-CNN IV", "onnx"): 1.0}  # milliseconds
_EPOCH_TARGET = 60.0  # seconds


class Timed(NamedTuple):
    r"""A model, and the sizes of one sample of what it takes by keyword."""

    make: Callable[[], nn.Module]
    sizes: dict[str, tuple[int, ...]]
    is_trained: bool = True


_IMAGE: dict[str, tuple[int, ...]] = {"x": (1, 32, 32)}
_READINGS: dict[str, tuple[int, ...]] = {"x": (1024, 1)}
MODELS = {
    "BMF-CNN": Timed(BMFCNN, _IMAGE),
    "CNN": Timed(lambda: BMFCNN(bilinear=False), _IMAGE),
    "TaxelNet": Timed(lambda: TaxelNet(letter_array(), _LETTERS, in_channels=1), _READINGS),
    "TaxelNet without pooling": Timed(
        lambda: TaxelNet(letter_array(), _LETTERS, in_channels=1, max_taxels=1024, widths=(16,)),
        _READINGS,
    ),
    "MS-CNN IV": Timed(MSCNN, {"x": (240, 3), "joint": (16,)}, is_trained=False),
}


OPTIONS = {
    "--only": (("image", "epoch"), "what to measure", ("image", "epoch")),
    "--models": (tuple(MODELS), "which", MODELS),
    "--forms": (_FORMS, "of an image", _FORMS),
    "--rounds": (50, "of 20 images"),
    "--epochs": (3, "of each model"),
    "--images": (13_000, "of an epoch"),
    "--batch-size": (50, "images in a batch"),
    "--threads": (2, "of an epoch"),
    "--out": (Path, "JSON file of what was measured"),
}
EPILOG = "The exit code is 0 if all that was measured is fast enough, and 1 if not."


def _drawn(timed: Timed, batch_size: int) -> dict[str, Tensor]:
    return {name: torch.rand(batch_size, *size) for name, size in timed.sizes.items()}


def _onnx(model: nn.Module, timed: Timed, path: Path) -> Callable[[dict[str, Tensor]], Any]:
    import onnxruntime

    shapes = {name: {0: "batch"} for name in timed.sizes}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            model,
            (),
            path,
            kwargs=_drawn(timed, 3),
            dynamo=True,
            opset_version=18,
            dynamic_shapes=shapes,
            verbose=False,
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return lambda given: session.run(None, given)[0]


def _forms(
    timed: Timed, forms: tuple[str, ...], folder: Path
) -> tuple[nn.Module, dict[str, Callable[[], Any]]]:
    torch.manual_seed(0)
    model = timed.make().eval()
    given = _drawn(timed, 1)
    runs: dict[str, Callable[[], Any]] = {"eager": lambda: model(**given)}
    if "onnx" in forms:
        session, arrays = _onnx(model, timed, folder), {k: v.numpy() for k, v in given.items()}
        runs["onnx"] = lambda: session(arrays)
    if "compiled" in forms and any(shutil.which(name) for name in ("c++", "g++", "clang++")):
        compiled = torch.compile(copy.deepcopy(model), fullgraph=True)
        runs["compiled"] = lambda: compiled(**given)
    return model, {form: runs[form] for form in forms if form in runs}


@torch.inference_mode()
def measure_image(args: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    runs: dict[tuple[str, str], Callable[[], Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for i, name in enumerate(args.models):
            model, forms = _forms(MODELS[name], args.forms, Path(folder) / f"{i}.onnx")
            found[name] = {"weights": sum(weight.numel() for weight in model.parameters())}
            outs = [torch.as_tensor(run()) for run in forms.values()]
            worst = max(float((out - outs[0]).abs().max()) for out in outs)
            if worst > _ALLOWED_DIFFERENCE:
                raise SystemExit(f"the forms of {name} differ by {worst:.0e}")
            runs |= {(name, form): run for form, run in forms.items()}
        seconds: dict[tuple[str, str], list[float]] = {key: [] for key in runs}
        for _ in range(args.rounds):
            for key, run in runs.items():
                for _ in range(3):
                    run()
                for _ in range(20):
                    start = time.perf_counter()
                    run()
                    seconds[key].append(time.perf_counter() - start)
    for (name, form), taken in seconds.items():
        found[name][form] = {
            "fastest_ms": 1e3 * min(taken),
            "median_ms": 1e3 * statistics.median(taken),
        }
    return found


def _train(model: nn.Module, given: dict[str, Tensor], y: Tensor, batch_size: int) -> None:
    optimizer = torch.optim.Adam(model.parameters(), 0.001, fused=True)
    for rows in torch.randperm(len(y)).split(batch_size):
        optimizer.zero_grad()
        out = model(**{name: value[rows] for name, value in given.items()})
        F.cross_entropy(out, y[rows]).backward()
        optimizer.step()


def measure_epoch(args: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(args.threads)
    torch.manual_seed(0)
    names = [name for name in args.models if MODELS[name].is_trained]
    models = {name: MODELS[name].make() for name in names}
    models |= {
        f"{name}, channels last": MODELS[name].make().to(memory_format=torch.channels_last)
        for name in names
        if MODELS[name].sizes == _IMAGE
    }
    given, y = torch.rand(args.images, 1024, 1), torch.randint(_LETTERS, (args.images,))
    seconds = in_turns(
        {
            name: partial(_train, model, {"x": given}, y, args.batch_size)
            for name, model in models.items()
        },
        args.epochs,
    )
    return {name: {"fastest_s": min(taken), "all_s": taken} for name, taken in seconds.items()}


def _print_image(found: dict[str, Any]) -> bool:
    is_good = True
    for name, forms in found.items():
        texts = [f"{forms['weights']:9,d} weights"]
        for form in _FORMS:
            if form in forms:
                fastest, median = forms[form]["fastest_ms"], forms[form]["median_ms"]
                texts.append(f"{form} {fastest:6.3f} ms (median {median:6.3f})")
                is_good &= fastest <= _TARGETS.get((name, form), float("inf"))
        print(f"{name:26s} {', '.join(texts)}")
    return is_good


def _print_epoch(found: dict[str, Any], args: argparse.Namespace) -> bool:
    print(f"an epoch of {args.images} images, batch {args.batch_size}, {args.threads} thread(s):")
    for name, taken in found.items():
        print(f"{name:26s} {taken['fastest_s']:6.1f} s")
    times = [taken["fastest_s"] for name, taken in found.items() if name.startswith("BMF-CNN")]
    return not times or min(times) <= _EPOCH_TARGET


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv, EPILOG)
    where = f"{describe_machine()}, torch {torch.__version__}"
    found: dict[str, Any] = {"where": where}
    print(f"one image or frame, 1 thread; {where}")
    is_good = True
    if "image" in args.only:
        found["image"] = measure_image(args)
        is_good &= _print_image(found["image"])
    if "epoch" in args.only:
        found["epoch"] = measure_epoch(args)
        is_good &= _print_epoch(found["epoch"], args)
    if args.out is not None:
        write_json(args.out, found)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
