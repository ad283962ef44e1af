r"""The page of `throughput.py`."""

import statistics
from typing import Any

from shared import table

_SPEED = ("frames/s (median)", "min", "max")

_TARGETS = {
    "X against plain PyG": 5.0,
    "X against plain PyG, without page faults": 3.5,
    "II against X": 1.5,
    "plain PyG against ours": 3.0,
    "list of Data against StaticDataset, private memory": 10.0,
}


def page_lines(found: dict[str, Any], where: str) -> list[str]:
    r"""Returns the page of what was measured, by part; :obj:`where` is the machine and versions of
    the parts that do not say otherwise.
    """
    others = {name: part["where"] for name, part in found.items() if part["where"] != where}
    kept = [
        f"From an earlier run ({other}): {', '.join(n for n in others if others[n] == other)}."
        for other in dict.fromkeys(others.values())
    ]
    return [
        "# Throughput",
        "",
        "This page compares the speed and memory of training and inference with plain PyG "
        "([the fast path](../models.md#the-fast-path)).",
        "",
        f"Random readings in the shape of the hand (384 taxels, 1401 edges); {where}. *Plain* is "
        "the same model in plain PyG, measured alternately in the same run. Written by "
        "`benchmarks/throughput.py`.",
        *(line for text in kept for line in ("", text)),
        "",
        *_lines_of(found),
    ]


_ON_A_GPU = [
    "## On a GPU",
    "",
    "`benchmarks/gpu.py` compares layers, models, loaders and memory with PyG's on one GPU: "
    "[figures of an H200](gpu.md).",
]

ROUNDED = (
    " In the rows with bfloat16, inputs and outputs of linear layers are rounded in both passes, "
    "and sums are in float32, as in processors with bfloat16 instructions."
)


def merged(kept: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    r"""Returns what was measured now, and before what was not measured now."""
    out = {**kept, **found}
    precision, before = out.get("precision"), kept.get("precision", {})
    if precision is not None and "accuracy" in before:  # takes long, and no quiet machine
        precision.setdefault("accuracy", before["accuracy"])
    return out


def _lines_of(found: dict[str, Any]) -> list[str]:
    lines = []
    if "train" in found:
        train = found["train"]
        lines += [
            f"## Training, batch {train['batch_size']}, {train['threads']} threads, "
            f"{train['device']}",
            "",
            *table(["model", *_SPEED], _speeds(train["frames_per_second"])),
        ]
        if "frames_per_second_resident" in train:
            lines += [
                "",
                "Without page faults (`MALLOC_MMAP_MAX_=0 MALLOC_TRIM_THRESHOLD_=8000000000`, see "
                "[two variables](../layers.md#two-variables-that-make-large-batches-faster)):",
                "",
                *table(["model", *_SPEED], _speeds(train["frames_per_second_resident"])),
            ]
        lines += ["", f"Largest difference of the logits: {train['largest_difference']:.1e}.", ""]
    if "precision" in found:
        lines += _precision_lines(found["precision"])
    if "latency" in found:
        latency = found["latency"]
        lines += [
            "## One frame, 1 thread: segmentation II with edge features and joints, reading to "
            "label",
            "",
            *table(
                ["side", "p50 (ms)", "p99 (ms)"],
                [
                    [name, f"{value['p50']:.2f}", f"{value['p99']:.2f}"]
                    for name, value in latency["milliseconds"].items()
                ],
            ),
        ]
        lines += ["", f"Largest difference of the logits: {latency['largest_difference']:.1e}.", ""]
    if "data" in found:
        data = found["data"]
        lines += [f"## {data['frames']} frames in memory, with edge features by pose", ""]
        listed, static = data["mib"]["list of Data"], data["mib"]["StaticDataset"]
        lines += [
            "* list of `Data` with stored edge features and shared edges: "
            f"{listed['private']:.0f} MiB (from {listed['measured_frames']:.0f} frames)",
            "* `StaticDataset` after a pass over it, with edge features computed on the fly: "
            f"{static['private']:.0f} MiB of private memory, and {static['mapped']:.0f} MiB of its "
            "file, which the system can reclaim",
            "",
        ]
    if "memory" in found:
        lines += [
            "## Peak memory of training (MiB)",
            "",
            "*Activations* excludes weights, gradients and the optimizer's state; *all* includes "
            "them.",
            "",
            *table(
                ["batch", "model", "activations", "all"],
                [
                    [size, name, f"{value['activations']:.0f}", f"{value['all']:.0f}"]
                    for size, values in found["memory"]["mib"].items()
                    for name, value in values.items()
                ],
            ),
            "",
        ]
    ratios = [
        [name, f"{value:.2f}", str(_TARGETS.get(name, ""))]
        for part in found.values()
        for name, value in part.get("ratios", {}).items()
    ]
    table_of_ratios = table(["what", "ratio", "at least"], ratios)
    return [*lines, "## Ratios", "", *table_of_ratios, "", *_ON_A_GPU]


def _speeds(found: dict[str, Any]) -> list[list[str]]:
    return [
        [name, *(f"{value[key]:.0f}" for key in ("median", "min", "max"))]
        for name, value in found.items()
    ]


def _precision_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"## Optimizer and precision, batch {found['batch_size']}, {found['threads']} thread(s)",
        "",
        "Our models were trained with PyTorch's Adam tensor by tensor (*loop*), fused, and under "
        "autocast to bfloat16. Autocast affects only the fully connected part; graph convolutions "
        "stay in full precision. The load average of the machine before the run was "
        f"{found['load']:.1f}.",
        "",
        *table(
            ["model", "optimizer, precision", *_SPEED],
            [
                [model, *row]
                for model, ways in found["frames_per_second"].items()
                for row in _speeds(ways)
            ],
        ),
    ]
    if not found["has_bfloat16"]:
        lines += [
            "",
            "bfloat16 was not timed: this processor has no instructions for it and would be far "
            "slower.",
        ]
    if "accuracy" in found:
        lines += _accuracy_lines(found["accuracy"])
    return [*lines, ""]


def _accuracy_lines(found: dict[str, Any]) -> list[str]:
    seeds = len(next(iter(found["models"]["X"].values())))
    rounded = ROUNDED * (found["bfloat16"] == "rounded")
    lines = [
        "",
        "The next table shows the accuracy of object recognition by trial in percent, on "
        f"{found['num_trials']} simulated trials of eight objects. Every {found['stride']}th frame "
        "of squeeze, lift and hold is used, tared by hover, with one scale per channel: "
        f"{found['num_train']} training frames, and {found['num_test']} test frames of other "
        f"trials. Models were trained for {found['epochs']} epochs with seeds 0 to {seeds - 1} "
        "(of splits, weights and batches). Accuracies are means ± standard deviation. Differences "
        f"are to the first row of the model on the same seed, ± standard error.{rounded}",
        "",
    ]
    rows = []
    for model, ways in found["models"].items():
        first = next(iter(ways.values()))
        for way, values in ways.items():
            cell = f"{100 * statistics.fmean(values):.1f} ± {100 * statistics.stdev(values):.1f}"
            apart = [100 * (a - b) for a, b in zip(values, first, strict=True)]
            error = statistics.stdev(apart) / len(apart) ** 0.5
            rest = "" if values is first else f"{statistics.fmean(apart):+.1f} ± {error:.1f}"
            rows.append([model, way, cell, rest])
    return lines + table(["model", "optimizer, precision", "accuracy", "difference"], rows)
