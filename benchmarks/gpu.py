r"""Layers and models on one GPU, against PyG's layers on a `Batch` on the same GPU.

Layers are timed forward and backward, models in a training step with Adam, with the data on the
device. Both sides have equal weights and are timed in turns; a ratio is the median over the rounds.
The parts run in the order of their importance, as far as the minutes reach:

* `target`: X on the hand, 128 frames: eager, CUDA graph and `torch.compile`;
* `loader`: frames per second of the loaders, and of training with them;
* `models`: II, MT-GCN and `TaxelNet` on the hand, 128 frames: eager and CUDA graph;
* `memory`: peak memory of three batches of the 18 models of P2's Table IV;
* `frame`: one frame in the processor's memory to its label;
* `batches`: all models, 1 and 1,024 frames;
* `layers`: all layers, with 1, 128 and 1,024 samples of 384, 24 and 2,048 taxels;
* `compiled`: II, MT-GCN and `TaxelNet` with `torch.compile`;
* `nodes`: all models on 24 and 2,048 taxels;
* `compiled-more`: X in the other precisions, and the layers, with `torch.compile`.

A measurement that fails is a row with its reason. Whatever does not fit is listed at the end. A
table is printed after each part, and `--out` is written after each row.

In a CUDA graph, PyG's `GCNConv` keeps its normalised edges (`cached=True`): without, it waits for
the GPU at each call and cannot be captured. TF32 and bfloat16 (autocast) are those of both sides.

Examples:
    python benchmarks/gpu.py --out gpu.json
    python benchmarks/gpu.py --only target loader
    python benchmarks/gpu.py --device cpu --quick
"""

import argparse
import gc
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import torch
from gpu_sides import (
    HAND,
    LAYERS,
    MODELS,
    Side,
    edges_kept,
    make_sides,
)
from hand_frames import LAYOUT, Frames
from plain_pyg import PlainGCN, PlainSegmentedBatch
from shared import describe_machine, in_turns, parse, table, versions, write_json
from torch import Tensor, nn
from torch_geometric.loader import DataLoader

from torch_geometric_tactile.experiments._memory import PeakMemory
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import TactileGCN
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.training._config_files import expand_template

PARTS = (
    "target",
    "loader",
    "models",
    "memory",
    "frame",
    "batches",
    "layers",
    "compiled",
    "nodes",
    "compiled-more",
)
PRECISIONS = ("float32", "TF32", "bfloat16")
MODES = ("eager", "CUDA graph", "compile")
AIM = 10.0  # times plain PyG: X on the hand, 128 frames
SECONDS_BEFORE_AND_AFTER = 20.0  # imports, the first call on a device, the last tables
ROUND_SECONDS = 0.02
EXPECTED_SECONDS = {"compile": 45.0, "memory": 10.0, "loader": 10.0, "frame": 8.0}
WIDTHS = ("3-16", "64-64")

OPTIONS = {
    "--device": ("cuda", "where to measure", ("cuda", "cpu")),
    "--minutes": (8, "after so many, nothing new begins"),
    "--rounds": (5, "rounds, the sides in turn"),
    "--only": (PARTS, "what to measure", PARTS),
    "--quick": (False, "every part once, in tiny sizes, to see that it runs"),
    "--out": (Path, "file for the figures (JSON)"),
}


@dataclass(frozen=True)
class Case:
    r"""One row: a model or layer, its size, and how it runs."""

    name: str
    num_nodes: int
    num_samples: int
    precision: str = "float32"
    mode: str = "eager"


class Budget:
    r"""The time that is left, by the longest measurement of each kind so far."""

    def __init__(self, minutes: float) -> None:
        self.end = time.monotonic() + 60 * minutes - SECONDS_BEFORE_AND_AFTER
        self.longest: dict[str, float] = {}

    def has_time_for(self, kind: str) -> bool:
        expected = self.longest.get(kind, EXPECTED_SECONDS.get(kind, 2.0))
        return time.monotonic() + expected < self.end

    @contextmanager
    def measuring(self, kind: str) -> Iterator[None]:
        start = time.monotonic()
        try:
            yield
        finally:
            self.longest[kind] = max(self.longest.get(kind, 0.0), time.monotonic() - start)


class DeviceLostError(RuntimeError):
    r"""The GPU takes no work any more."""


class Benchmark:
    r"""A run: its arguments, the time that is left, and what was measured."""

    def __init__(self, args: argparse.Namespace) -> None:
        self.args = args
        self.is_cuda = args.device == "cuda"
        self.rounds = 1 if args.quick else args.rounds
        self.budget = Budget(args.minutes)
        self.where = describe_device(args.device)
        self.versions = versions("torch", "torch_geometric", "torch_geometric_tactile")
        self.left_out: dict[str, int] = {}  # what, and how many rows
        self.lost: str | None = None
        self.parts: dict[str, list[dict[str, Any]]] = {}
        self.eager_ms: dict[tuple[Any, ...], float] = {}  # of PyG, by case without its mode
        self.sides = lru_cache(maxsize=1)(partial(make_sides, device=args.device))

    def run(self, name: str) -> None:
        rows = self.parts[name] = []
        measures = {"loader": self._loader, "memory": self._memory, "frame": self._frame}
        if name in measures:
            self.sides.cache_clear()
            if not self.budget.has_time_for(name):
                self.leave_out(f"{name}, for lack of time")
                return
            with self.budget.measuring(name):
                _, reason = self.attempt(partial(measures[name], rows))
            if reason is not None:
                self.leave_out(f"{name}, in part ({reason})")
            return
        for case in cases_of(name, self.args.quick):
            if not self.is_cuda and case.precision == "TF32":
                self.leave_out("TF32, which needs a CUDA device")
            elif not self.is_cuda and case.mode == "CUDA graph":
                self.leave_out("CUDA graphs, which need a CUDA device")
            elif not self.budget.has_time_for(case.mode):
                size = f"N = {case.num_nodes}, B = {case.num_samples}"
                self.leave_out(f"{name}: {case.name}, {size}, {case.mode}, for lack of time")
            else:
                with self.budget.measuring(case.mode):
                    rows.append(self._case(case))
                self.save()

    def leave_out(self, what: str) -> None:
        self.left_out[what] = self.left_out.get(what, 0) + 1

    def save(self) -> None:
        if self.args.out:
            content = {"where": self.where, "versions": self.versions, "quick": self.args.quick}
            content |= {"parts": self.parts, "left_out": self.left_out, "lost": self.lost}
            write_json(self.args.out, content)

    def attempt(self, call: Callable[[], Any]) -> tuple[Any, str | None]:
        r"""Returns what a call returns, or the reason why it failed."""
        try:
            return call(), None
        except Exception as error:  # whatever fails is a row, not the end of the run
            lines = str(error).strip().splitlines() or [""]
            reason = f"{type(error).__name__}: {lines[0]:.120}"
        # After the block, when the error no longer holds the tensors of the call.
        self.clean_up()
        return None, reason.replace("|", "/")

    def clean_up(self) -> None:
        r"""Frees memory, and checks that the device still takes work."""
        gc.collect()
        if not self.is_cuda:
            return
        try:
            # A failed capture leaves its own stream behind.
            torch.cuda.set_stream(torch.cuda.default_stream())
            torch.cuda.synchronize()
            torch.cuda.empty_cache()
            nn.functional.dropout(torch.ones(8, device="cuda")).sum().item()
        except Exception as error:
            raise DeviceLostError(f"the GPU takes no work any more ({error})") from error

    def clock(self) -> float:
        if self.is_cuda:
            torch.cuda.synchronize()
        return time.perf_counter()

    def _case(self, case: Case) -> dict[str, Any]:
        row: dict[str, Any] = {**vars(case), "ms": {}, "reasons": {}}
        sides, reason = self.attempt(
            partial(self.sides, case.name, case.num_nodes, case.num_samples)
        )
        if sides is None:
            row["reasons"] = {"plain": reason, "ours": reason}
            return row
        if case.mode == "compile":
            torch.compiler.reset()
        calls, numbers = {}, {}
        set_precision(case.precision)
        with edges_kept(sides["plain"].module) if case.mode == "CUDA graph" else nullcontext():
            for name, side in sides.items():
                prepared, reason = self.attempt(partial(self._prepared, side, case))
                if prepared is None:
                    row["reasons"][name] = reason
                else:
                    calls[name], numbers[name] = prepared
            times, reason = self.attempt(lambda: in_turns(calls, self.rounds, self.clock))
        set_precision("float32")
        for side in sides.values():
            clear_gradients(side)
        if times is None:
            row["reasons"] = dict.fromkeys(sides, reason)
            return row
        each = {name: [1e3 * t / numbers[name] for t in values] for name, values in times.items()}
        row["ms"] = {name: statistics.median(values) for name, values in each.items()}
        key = (case.name, case.num_nodes, case.num_samples, case.precision)
        if case.mode == "eager" and "plain" in row["ms"]:
            self.eager_ms[key] = row["ms"]["plain"]
        if "ours" in each:
            row["frames_per_second"] = 1e3 * case.num_samples / row["ms"]["ours"]
            if "plain" in each:
                pairs = zip(each["plain"], each["ours"], strict=True)
                row["ratio"] = statistics.median(a / b for a, b in pairs)
            if key in self.eager_ms:
                row["ratio_to_eager"] = self.eager_ms[key] / row["ms"]["ours"]
        return row

    def _prepared(self, side: Side, case: Case) -> tuple[Callable[[], None], int]:
        r"""Returns a call of several steps that takes a round's time, and the number of steps."""
        module = side.module
        if case.mode == "compile":
            # The compiler itself is not what a quick run tests.
            backend = "aot_eager" if self.args.quick else "inductor"
            module = torch.compile(module, dynamic=False, backend=backend)
        step = make_step(module, side, case, self.args.device)
        if case.mode == "CUDA graph":
            step = captured(step, partial(clear_gradients, side))
        for _ in range(1 if self.args.quick else 3):
            step()
        start = self.clock()
        step()
        seconds = self.clock() - start
        number = 1 if self.args.quick else max(1, min(200, round(ROUND_SECONDS / seconds)))

        def steps() -> None:
            for _ in range(number):
                step()

        return steps, number

    def _loader(self, rows: list[dict[str, Any]]) -> None:
        size = 4 if self.args.quick else 128
        device = self.args.device
        frames = Frames(size * (2 if self.args.quick else 64))
        frames.data.x.sub_(30_000).div_(100)
        on_device = frames.copy().to(device)
        samples = [frames[i] for i in range(size * (2 if self.args.quick else 8))]
        plain = DataLoader(samples, size, shuffle=True)
        static = StaticLoader(on_device, size, shuffle=True)
        ours_step, plain_step = (self._hand_step(name) for name in ("ours", "plain"))
        batch, plain_batch = next(iter(static)).to(device), next(iter(plain)).to(device)

        def indices_on_device() -> None:
            for index in torch.randperm(len(on_device), device=device).split(size):
                on_device.data.index_select(index)

        def epoch(loader: Any, step: Callable[[Any], None]) -> None:
            for loaded in loader:
                step(loaded.to(device))

        def repeat(step: Callable[[Any], None], loaded: Any) -> None:
            for _ in range(len(plain)):
                step(loaded)

        def nothing(loaded: Any) -> None:
            return None

        small = size * len(plain)
        ways: dict[str, tuple[Callable[[], None], int]] = {
            "StaticLoader, data on the device": (partial(epoch, static, nothing), len(frames)),
            "StaticLoader, data in memory, each batch moved": (
                partial(epoch, StaticLoader(frames, size, shuffle=True), nothing),
                len(frames),
            ),
            "data on the device, indices drawn there": (indices_on_device, len(frames)),
            "PyG's DataLoader, each batch moved": (partial(epoch, plain, nothing), small),
            "X, the step alone": (partial(repeat, ours_step, batch), small),
            "plain X, the step alone": (partial(repeat, plain_step, plain_batch), small),
            "X with StaticLoader, data on the device": (
                partial(epoch, static, ours_step),
                len(frames),
            ),
            "plain X with PyG's DataLoader": (partial(epoch, plain, plain_step), small),
        }
        for name, (call, num_frames) in ways.items():
            row: dict[str, Any] = {"what": name, "batch_size": size}
            times, reason = self.attempt(partial(self._warm_times, name, call))
            if times is None:
                row["reason"] = reason
            else:
                row["frames_per_second"] = num_frames / statistics.median(times)
            rows.append(row)

    def _hand_step(self, name: str) -> Callable[[Any], None]:
        torch.manual_seed(0)
        module = PlainGCN() if name == "plain" else TactileGCN(LAYOUT, 8)
        module = module.to(self.args.device)
        optimizer = adam(module, self.args.device)

        def step(batch: Any) -> None:
            optimizer.zero_grad()
            nn.functional.cross_entropy(module(batch.x, batch.edge_index), batch.y).backward()
            optimizer.step()

        return step

    def _warm_times(self, name: str, call: Callable[[], None]) -> list[float]:
        call()
        return in_turns({name: call}, self.rounds, self.clock)[name]

    def _memory(self, rows: list[dict[str, Any]]) -> None:
        sizes = (2,) if self.args.quick else (32, 512)
        experiments = expand_template("p2_table2")
        # What the first training alone allocates, such as workspaces, is not to count.
        self.attempt(partial(peak_memory, partial(TactileGCN, LAYOUT, 8), 2, self.args.device))
        for cell in load_table("p2-table4").cells:
            if self.args.quick and cell.column != "Tac":
                continue
            settings = experiments[str(cell.experiment)]["model"]["model"]["init_args"]
            num_joints = 16 if "num_joints" in settings else 0
            arguments = {**settings, "num_joints": num_joints}
            for size in sizes:
                row = {"row": cell.row, "column": cell.column, "section": cell.section}
                row |= {"side": "ours", "batch_size": size, "published": cell.published["memory"]}
                make = partial(TactileGCN, LAYOUT, 8, **arguments)
                self._peak(rows, row, make, size, is_plain=False)
                if settings["inputs"] == ["tactile"] and not num_joints:
                    make_plain = partial(plain_model, settings["segments"], self.args.device)
                    self._peak(rows, {**row, "side": "plain PyG"}, make_plain, size, is_plain=True)

    def _peak(
        self,
        rows: list[dict[str, Any]],
        row: dict[str, Any],
        make: Callable[[], nn.Module],
        size: int,
        is_plain: bool,
    ) -> None:
        peak, reason = self.attempt(partial(peak_memory, make, size, self.args.device, is_plain))
        rows.append({**row, "mb": peak} if reason is None else {**row, "reason": reason})

    def _frame(self, rows: list[dict[str, Any]]) -> None:
        num_nodes = 24 if self.args.quick else HAND
        for name in ("X", "II"):
            sides = self.sides(name, num_nodes, 1)
            plain, ours = (sides[key] for key in ("plain", "ours"))
            ways = {
                "plain PyG": (plain, self.args.device, "eager"),
                "ours": (ours, self.args.device, "eager"),
                "plain PyG, CUDA graph": (plain, self.args.device, "CUDA graph"),
                "ours, CUDA graph": (ours, self.args.device, "CUDA graph"),
                "ours, on the processor": (
                    make_sides(name, num_nodes, 1, "cpu")["ours"],
                    "cpu",
                    "eager",
                ),
            }
            for what, (side, device, mode) in ways.items():
                if mode == "CUDA graph" and not self.is_cuda:
                    self.leave_out("CUDA graphs, which need a CUDA device")
                    continue
                row: dict[str, Any] = {"model": name, "num_nodes": num_nodes, "side": what}
                num_frames = 5 if self.args.quick else 300
                kept = edges_kept(side.module) if mode == "CUDA graph" else nullcontext()
                with kept:
                    seconds, reason = self.attempt(
                        partial(frame_seconds, side, device, mode, num_frames)
                    )
                if seconds is None:
                    row["reason"] = reason
                else:
                    seconds = sorted(seconds)
                    row["p50_ms"] = 1e3 * statistics.median(seconds)
                    row["p99_ms"] = 1e3 * seconds[int(0.99 * len(seconds))]
                rows.append(row)


def cases_of(part: str, quick: bool) -> list[Case]:
    r"""Returns the rows of a part, those of one model and size one after the other."""
    layers = [f"{layer} {widths}" for layer in LAYERS for widths in WIDTHS]
    others, steps = MODELS[1:], MODES[:2]
    hand, small, large = HAND, 24, 2048
    if part == "target":
        cases = [*_crossed(["X"], [(hand, 128)], steps), Case("X", hand, 128, mode="compile")]
    elif part == "models":
        cases = _crossed(others, [(hand, 128)], steps)
    elif part == "batches":
        cases = _crossed(MODELS, [(hand, 1), (hand, 1024)], steps)
    elif part == "layers":
        sizes = [(n, b) for n in (hand, small, large) for b in (128, 1, 1024)]
        cases = _crossed(layers, sizes, steps)
    elif part == "compiled":
        cases = [Case(name, hand, 128, mode="compile") for name in others]
    elif part == "nodes":
        sizes = [(n, b) for b in (128, 1, 1024) for n in (small, large)]
        cases = _crossed(MODELS, sizes, steps)
    else:
        cases = [Case("X", hand, 128, p, "compile") for p in PRECISIONS[1:]]
        cases += [Case(name, hand, 128, mode="compile") for name in layers]
    if not quick:
        return cases
    found = {(case.name, case.precision, case.mode): case for case in cases}
    first_compiled = next((case.name for case in cases if case.mode == "compile"), "")
    return [
        Case(name, small, 4, precision, mode)
        for name, precision, mode in found
        if not name.endswith(WIDTHS[1]) and (mode != "compile" or name == first_compiled)
    ]


def _crossed(
    names: Sequence[str], sizes: Sequence[tuple[int, int]], modes: Sequence[str]
) -> list[Case]:
    return [
        Case(name, *size, precision, mode)
        for size in sizes
        for name in names
        for mode in modes
        for precision in PRECISIONS
    ]


def set_precision(precision: str) -> None:
    r"""Sets how float32 matrices are multiplied on a GPU."""
    torch.set_float32_matmul_precision("high" if precision == "TF32" else "highest")


def autocast(precision: str, device: str) -> AbstractContextManager[Any]:
    return torch.autocast(device, torch.bfloat16, enabled=precision == "bfloat16")


def adam(module: nn.Module, device: str) -> torch.optim.Optimizer:
    # `capturable`: the count of the steps is on the GPU, as a CUDA graph needs it.
    return torch.optim.Adam(module.parameters(), fused=True, capturable=device == "cuda")


def clear_gradients(side: Side) -> None:
    for leaf in side.leaves():
        leaf.grad = None


def make_step(module: nn.Module, side: Side, case: Case, device: str) -> Callable[[], None]:
    r"""Returns a training step of a model, or the forward and backward pass of a layer."""
    optimizer = adam(side.module, device) if case.name in MODELS else None
    leaves = side.leaves()

    def step() -> None:
        for leaf in leaves:
            leaf.grad = None
        with autocast(case.precision, device):
            loss = side.loss(module(*side.inputs, **side.keywords))
        loss.backward()
        if optimizer is not None:
            optimizer.step()

    return step


def captured(step: Callable[[], Any], clear: Callable[[], None]) -> Callable[[], Any]:
    r"""Returns the replay of a step that was captured in a CUDA graph."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):  # what is made at the first calls is no part of the graph
            step()
    torch.cuda.current_stream().wait_stream(stream)
    torch.cuda.synchronize()
    # A capture that fails may leave the random generators unusable, and most fail since an
    # operation waits for the GPU: PyTorch tells so of a step that is not captured.
    torch.cuda.set_sync_debug_mode("error")
    try:
        step()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    clear()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()

    def replay(graph: Any = graph, step: Any = step) -> None:
        # The graph does not keep the memory it works on alive, such as the optimizer's state, which
        # the step holds.
        graph.replay()

    return replay


def plain_model(segments: str | None, device: str) -> nn.Module:
    r"""Returns X, I or II on a PyG batch."""
    if segments is None:
        return PlainGCN()
    segment, edge_index = LAYOUT.segments(segments), LAYOUT.edge_index("original")
    return PlainSegmentedBatch(segment.to(device), edge_index.to(device))


def peak_memory(
    make: Callable[[], nn.Module], size: int, device: str, is_plain: bool = False
) -> float:
    r"""Returns the peak memory of training on three batches in megabytes, with the weights, the
    state of the optimizer and the batch.
    """
    memory = PeakMemory(device)
    memory.start()
    torch.manual_seed(0)
    module = make().to(device)
    optimizer = adam(module, device)
    frames = Frames(size)
    frames.data.x.sub_(30_000).div_(100)
    batch: Any = frames.batch(range(size))
    batch.pos = LAYOUT.pos.expand(size, -1, -1).clone()
    batch = (batch.to_batch() if is_plain else batch).to(device)
    keywords = {}
    if not is_plain:
        keywords = {key: batch[key] for key in getattr(module, "modalities", ())}
    for _ in range(3):
        optimizer.zero_grad()
        logits = module(batch.x, batch.edge_index, **keywords)
        nn.functional.cross_entropy(logits, batch.y).backward()
        optimizer.step()
    return memory.stop()


def frame_seconds(side: Side, device: str, mode: str, num_frames: int) -> list[float]:
    r"""Returns the seconds from each of many frames in memory to its label."""
    module = side.module.eval()
    shape = side.inputs[0].shape
    frames = torch.randn(num_frames, *shape)
    if device == "cuda":
        frames = frames.pin_memory()
    x = torch.zeros(shape, device=device)
    # Not in inference mode: its tensors cannot be told from those of another frame.
    with torch.no_grad():

        def predict() -> Tensor:
            return module(x, *side.inputs[1:], **side.keywords).argmax(dim=-1)

        call = predict
        if mode == "CUDA graph":
            labels: list[Tensor] = []

            def keep() -> None:
                labels[:] = [predict()]

            replay = captured(keep, labels.clear)

            def call() -> Tensor:
                replay()
                return labels[0]

        seconds = []
        for number in range(num_frames + num_frames // 10 + 1):
            start = time.perf_counter()
            x.copy_(frames[number % num_frames], non_blocking=True)
            call().item()
            seconds.append(time.perf_counter() - start)
    module.train()
    return seconds[-num_frames:]


def case_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    head = ["", "N", "B", "precision", "mode", "plain PyG, ms", "ours, ms", "ours, frames/s"]
    head += ["plain / ours", "plain eager / ours"]
    lines = []
    for row in rows:
        cells = [row["name"], str(row["num_nodes"]), str(row["num_samples"])]
        cells += [row["precision"], row["mode"]]
        for side in ("plain", "ours"):
            ms = row["ms"].get(side)
            cells.append(row["reasons"].get(side, "") if ms is None else f"{ms:.3g}")
        cells += [_number(row.get("frames_per_second"), ".0f"), _number(row.get("ratio"), ".2f")]
        lines.append([*cells, _number(row.get("ratio_to_eager"), ".2f")])
    return table(head, lines)


def loader_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    head = ["", "batch", "frames/s"]
    lines = [
        [
            row["what"],
            str(row["batch_size"]),
            row.get("reason") or f"{row['frames_per_second']:.0f}",
        ]
        for row in rows
    ]
    return table(head, lines)


def memory_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    sizes = list(dict.fromkeys(row["batch_size"] for row in rows))
    keys = ("side", "section", "column", "row")
    found: dict[tuple[str, ...], dict[int, dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), {})[row["batch_size"]] = row
    head = ["side", "joint angles", "inputs", "segmentation", "published, MB", "of X"]
    head += [text for size in sizes for text in (f"batch {size}, MB", "of X")]
    lines = []
    for key, by_size in found.items():
        side, section, column, name = key
        of_x = found[side, section, column, "X"]
        first = next(iter(by_size.values()))
        published = first["published"], next(iter(of_x.values()))["published"]
        line = [side, section, column, name, f"{published[0]:.0f}", _ratio_of(*published)]
        for size in sizes:
            row = by_size[size]
            mb, mb_of_x = row.get("mb"), of_x[size].get("mb")
            line += [row["reason"] if mb is None else f"{mb:.0f}", _ratio_of(mb, mb_of_x)]
        lines.append(line)
    return table(head, lines)


def frame_table(rows: Sequence[dict[str, Any]]) -> list[str]:
    head = ["model", "N", "side", "p50, ms", "p99, ms"]
    lines = [
        [
            row["model"],
            str(row["num_nodes"]),
            row["side"],
            row.get("reason") or f"{row['p50_ms']:.3f}",
            _number(row.get("p99_ms"), ".3f"),
        ]
        for row in rows
    ]
    return table(head, lines)


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _ratio_of(value: float | None, of: float | None) -> str:
    return f"{value / of:.2f}" if value is not None and of else ""


TABLES = {"loader": loader_table, "memory": memory_table, "frame": frame_table}


def verdict(parts: dict[str, list[dict[str, Any]]]) -> list[str]:
    r"""Returns lines on what was aimed at: X, and the loader."""
    lines = []
    ratios = {
        (row["precision"], row["mode"]): row["ratio_to_eager"]
        for row in parts.get("target", [])
        if "ratio_to_eager" in row
    }
    best = max(ratios, key=lambda kind: ratios[kind], default=None)
    for kind in dict.fromkeys((("float32", "eager"), best)):
        if kind in ratios:
            lines.append(
                f"* X, {', '.join(kind)}, against eager PyG of the same precision, without "
                f"loaders: {ratios[kind]:.1f} times (aim: {AIM:.0f})."
            )
    speed = {
        row["what"]: row["frames_per_second"]
        for row in parts.get("loader", [])
        if "frames_per_second" in row
    }
    pairs = (
        (
            "Training X against plain PyG, with their loaders",
            "X with StaticLoader, data on the device",
            "plain X with PyG's DataLoader",
        ),
        (
            "The loader against the step of X",
            "StaticLoader, data on the device",
            "X, the step alone",
        ),
    )
    for text, first, second in pairs:
        if first in speed and second in speed:
            lines.append(f"* {text}: {speed[first] / speed[second]:.1f} times (float32, eager).")
    return lines


def describe_device(device: str) -> str:
    if device == "cpu":
        return describe_machine()
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, check=True, timeout=20)
        driver = done.stdout.splitlines()[0].strip()
    except (OSError, subprocess.SubprocessError, IndexError):
        driver = "unknown"
    size = torch.cuda.get_device_properties(0).total_memory / 2**30
    name = f"{torch.cuda.get_device_name()}, {size:.0f} GiB, driver {driver}"
    return f"{name}, CUDA {torch.version.cuda}; {describe_machine()}"


def main(argv: list[str] | None = None) -> int:
    args = parse(__doc__, OPTIONS, argv)
    if args.device == "cuda" and not torch.cuda.is_available():
        print("there is no CUDA device; try --device cpu --quick", file=sys.stderr)
        return 2
    benchmark = Benchmark(args)
    sizes = "tiny sizes, no figures to go by" if args.quick else "data on the device"
    print(f"# On a GPU\n\n{benchmark.where}; {benchmark.versions}; {sizes}.", flush=True)
    for name in (part for part in PARTS if part in args.only):
        if benchmark.lost is not None:
            benchmark.leave_out(f"{name}, since {benchmark.lost}")
            continue
        try:
            benchmark.run(name)
        except DeviceLostError as error:
            benchmark.lost = str(error)
        benchmark.save()
        if rows := benchmark.parts[name]:
            lines = TABLES.get(name, case_table)(rows)
            print(f"\n## {name}\n", *lines, sep="\n", flush=True)
    print("\n## Summary\n", *verdict(benchmark.parts), sep="\n")
    if benchmark.left_out:
        print("\nLeft out:\n")
        print(*(f"* {what} ({n})" for what, n in benchmark.left_out.items()), sep="\n")
    return 0 if benchmark.lost is None else 1


if __name__ == "__main__":
    sys.exit(main())
