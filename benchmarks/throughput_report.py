r"""The page of `throughput.py`."""

import os
import platform
import statistics
from pathlib import Path
from typing import Any

_TARGETS = {
    "X against plain PyG": 5.0,
    "II against X": 1.5,
    "plain PyG against ours": 3.0,
    "list of Data against StaticDataset, private memory": 10.0,
}


def lines_of(found: dict[str, Any]) -> list[str]:
    lines = []
    if "train" in found:
        train = found["train"]
        lines += [
            f"## Training, batch {train['batch_size']}, {train['threads']} threads, "
            f"{train['device']}",
            "",
            "| model | frames/s (median) | min | max |",
            "|---|---|---|---|",
        ]
        for name, value in train["frames_per_second"].items():
            cells = " | ".join(f"{value[key]:.0f}" for key in ("median", "min", "max"))
            lines.append(f"| {name} | {cells} |")
        lines += ["", f"Largest difference of the logits: {train['largest_difference']:.1e}.", ""]
    if "precision" in found:
        lines += _precision_lines(found["precision"])
    if "latency" in found:
        latency = found["latency"]
        lines += [
            "## One frame, 1 thread: segmentation II with edge features and joints, reading to "
            "label",
            "",
            "| side | p50 (ms) | p99 (ms) |",
            "|---|---|---|",
        ]
        for name, value in latency["milliseconds"].items():
            lines.append(f"| {name} | {value['p50']:.2f} | {value['p99']:.2f} |")
        lines += ["", f"Largest difference of the logits: {latency['largest_difference']:.1e}.", ""]
    if "data" in found:
        data = found["data"]
        lines += [f"## {data['frames']} frames in memory, with edge features by pose", ""]
        listed, static = data["mib"]["list of Data"], data["mib"]["StaticDataset"]
        lines += [
            f"* list of `Data`, edge features stored, edges shared: {listed['private']:.0f} MiB "
            f"(from {listed['measured_frames']:.0f} frames)",
            f"* `StaticDataset` after a pass over it, edge features on the fly: "
            f"{static['private']:.0f} MiB of its own, and {static['mapped']:.0f} MiB of its file, "
            "which the system may take back",
            "",
        ]
    if "memory" in found:
        lines += [
            "## Peak memory of training (MiB)",
            "",
            "*activations*: above weights, gradients and the optimizer's state; *all*: with them.",
            "",
            "| batch | model | activations | all |",
            "|---|---|---|---|",
        ]
        for size, values in found["memory"]["mib"].items():
            for name, value in values.items():
                lines.append(
                    f"| {size} | {name} | {value['activations']:.0f} | {value['all']:.0f} |"
                )
        lines.append("")
    lines += ["## Ratios", "", "| what | ratio | at least |", "|---|---|---|"]
    for part in found.values():
        for name, value in part.get("ratios", {}).items():
            target = _TARGETS.get(name)
            lines.append(f"| {name} | {value:.2f} | {'' if target is None else target} |")
    return lines


def _precision_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        "## Optimizer and precision",
        "",
        "Ours, with Adam of PyTorch tensor by tensor, fused, and under autocast to bfloat16 (the "
        "fully connected part; graph convolutions stay in full precision).",
        "",
        "| model | optimizer, precision | frames/s (median) | min | max |",
        "|---|---|---|---|---|",
    ]
    for model, ways in found["frames_per_second"].items():
        for way, value in ways.items():
            cells = " | ".join(f"{value[key]:.0f}" for key in ("median", "min", "max"))
            lines.append(f"| {model} | {way} | {cells} |")
    if "accuracy" in found:
        lines += [
            "",
            "Accuracy of objects by trial (70 % to train, 30 % of the trials to test), 30 epochs, "
            "mean ± standard deviation over seeds 0 to 4, in %:",
            "",
            "| model | float32 | bfloat16 |",
            "|---|---|---|",
        ]
        for model, ways in found["accuracy"].items():
            cells = " | ".join(
                f"{100 * statistics.fmean(v):.1f} ± {100 * statistics.stdev(v):.1f}"
                for v in ways.values()
            )
            lines.append(f"| {model} | {cells} |")
    return [*lines, ""]


def describe_machine() -> str:
    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        models = [line.partition(":")[2].strip() for line in lines if "model name" in line]
        name = models[0] if models else name
    return f"{name}, {os.cpu_count()} CPUs"
