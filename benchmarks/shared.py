r"""What the benchmarks share: arguments, the machine, timing in turns, tables and files."""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import LSTM, Linear, Module

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.sensors import TaxelLayout, grid, stock_layout


class _Help(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    def _get_help_string(self, action: argparse.Action) -> str | None:
        return action.help if action.default is None else super()._get_help_string(action)


def parse(
    doc: str,
    options: Mapping[str, tuple[Any, ...]],
    argv: Sequence[str] | None = None,
    epilog: str | None = None,
) -> argparse.Namespace:
    """Reads the command line. An option is its default (`...`: it must be given, a type: None), its
    help and its choices; numbers with a default from one on must be positive."""
    parser = argparse.ArgumentParser(description=doc, epilog=epilog, formatter_class=_Help)
    for name, (default, text, *choices) in options.items():
        more: dict[str, Any] = {"choices": choices[0]} if choices else {}
        if default is False:
            parser.add_argument(name, action="store_true", help=text)
            continue
        if isinstance(default, list | tuple):
            more["nargs"] = "+"
        if default is ... and name.startswith("-"):
            more["required"] = True
        elif default is not ... and not isinstance(default, type):
            more["default"] = default
        parser.add_argument(name, type=_type_of(default), help=text, **more)
    return parser.parse_args(argv)


def _type_of(default: Any) -> Callable[[str], Any]:
    if isinstance(default, list | tuple):
        return _type_of(default[0])
    if isinstance(default, type):
        return default
    if isinstance(default, int) and default > 0:
        return positive
    return type(default) if isinstance(default, int | float | Path) else str


def positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1 (got {number})")
    return number


def describe_machine() -> str:
    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        models = [line.partition(":")[2].strip() for line in lines if "model name" in line]
        name = models[0] if models else name
    return f"{name}, {os.cpu_count()} CPUs"


def versions(*names: str) -> str:
    """Returns the versions of Python and of packages."""
    found = [f"{name} {import_module(name).__version__}" for name in names]
    return ", ".join([f"Python {platform.python_version()}", *found])


def print_setting(*packages: str, threads: int | None = None, **rows: str) -> None:
    """Prints rows, the machine and the versions."""
    for name, text in rows.items():
        print(f"{name:<10}{text}")
    used = "" if threads is None else f", {threads} threads used by torch"
    machine = platform.processor() or platform.machine()
    print(f"machine   {machine}, {os.cpu_count()} CPUs{used}")
    print(f"versions  {versions(*packages)}")


def spread(values: Sequence[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def in_turns(
    calls: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Returns the seconds of each call in each round: whatever else the machine does meets all."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = clock()
            call()
            seconds[name].append(clock() - start)
    return seconds


def memory(*keys: str) -> int:
    """Returns the bytes of this process that Linux calls so, such as RssAnon."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    values = dict(line.split(":", 1) for line in lines)
    return sum(int(values[key].split()[0]) * 1024 for key in keys)


_STATE = "BENCHMARK_ALLOCATOR"
# What is printed of a state of the allocator, and the variables that a process starts with.
ALLOCATOR_STATES = {
    "usual": ("As usually started", {}),
    "resident": (
        "Without page faults: MALLOC_MMAP_MAX_=0 MALLOC_TRIM_THRESHOLD_=8000000000",
        {"MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": "8000000000"},
    ),
}


def run_in_each_state(
    script: str, argv: Sequence[str] | None, states: Sequence[str]
) -> dict[str, Any]:
    """Returns what `script --child` prints as JSON, in a process for each allocator state."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    results = {}
    for state in states:
        child = subprocess.run(
            [sys.executable, script, *arguments, "--child"],
            env=_environment(state),
            stdout=subprocess.PIPE,
            check=True,
            text=True,
        )
        results[state] = json.loads(child.stdout)
    return results


def run_in_both_states(script: str, argv: Sequence[str] | None) -> int | None:
    """Runs a benchmark in both allocator states and returns the larger exit code; in those runs,
    prints the state and returns None."""
    state = os.environ.get(_STATE)
    if state is not None:
        print(f"\n{ALLOCATOR_STATES[state][0]}\n", flush=True)
        return None
    arguments = list(sys.argv[1:] if argv is None else argv)
    return max(
        subprocess.run([sys.executable, script, *arguments], env=_environment(state)).returncode
        for state in ALLOCATOR_STATES
    )


def _environment(state: str) -> dict[str, str]:
    base = {name: value for name, value in os.environ.items() if "MALLOC_" not in name}
    return {**base, **ALLOCATOR_STATES[state][1], _STATE: state}


def two_nearest(layout: TaxelLayout) -> Tensor:
    """Returns edges of each taxel to its two nearest, in both directions."""
    return two_nearest_edges(layout.pos)


def two_nearest_edges(pos: Tensor) -> Tensor:
    """Returns edges of each taxel to its two nearest, in both directions."""
    near = torch.cdist(pos, pos).topk(3, largest=False).indices[:, 1:].flatten()
    row = torch.arange(len(pos)).repeat_interleave(2)
    return torch.stack([torch.cat([row, near]), torch.cat([near, row])]).unique(dim=1)


class FlatLSTM(Module):
    """An LSTM of 128 cells on the readings of all taxels side by side, frame by frame."""

    def __init__(self, num_signals: int, classes: int) -> None:
        super().__init__()
        self.lstm = LSTM(num_signals, 128, batch_first=True)
        self.lin = Linear(128, classes)

    def forward(self, frames: Tensor) -> Tensor:
        return self.lin(self.lstm(frames)[0][:, -1])


def layout_or_grid(name: str) -> TaxelLayout:
    """Returns a layout of its name, or a grid of its rows and columns, such as 28x50."""
    if "x" in name and name.replace("x", "").isdigit():
        rows, cols = map(int, name.split("x"))
        return grid(rows, cols, 0.003)
    return stock_layout(name)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Returns the lines of a table in Markdown."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return [f"| {' | '.join(head)} |", "|" + "---|" * len(head), *lines]


def write(path: str | Path, text: str) -> None:
    """Writes a file as a whole."""
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | Path, content: Any, indent: int = 1) -> None:
    write(path, json.dumps(content, indent=indent) + "\n")
