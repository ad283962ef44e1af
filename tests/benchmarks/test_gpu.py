import gc
import json
import subprocess
import sys
import weakref
from importlib import import_module
from itertools import product
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import torch

pytest.importorskip("jsonargparse", reason="needs the extra 'train'")

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def gpu():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        yield import_module("gpu")


def benchmark_of(gpu, *arguments):
    return gpu.Benchmark(gpu.parse("", gpu.OPTIONS, ["--device", "cpu", "--quick", *arguments]))


@pytest.mark.parametrize("num_nodes", [24, 384])
@pytest.mark.parametrize(
    "name",
    [
        "X",
        "II",
        "MT-GCN",
        "TaxelNet",
        "StaticGCNConv 3-16",
        "SelfGCNConv 3-16",
        "SegmentedGCNConv 3-16",
    ],
)
def test_both_sides_give_the_same_numbers(gpu, name, num_nodes):
    sides = gpu.make_sides(name, num_nodes, 3, "cpu")
    for side in sides.values():
        side.module.eval()
    plain, ours = (sides[key].output() for key in ("plain", "ours"))
    assert ours.abs().max() > 0.01
    torch.testing.assert_close(plain.view_as(ours), ours, atol=1e-5, rtol=1e-4)
    losses = [sides[key].loss(out) for key, out in (("plain", plain), ("ours", ours))]
    torch.testing.assert_close(*losses, atol=1e-3, rtol=1e-4)


def test_parts_hold_every_combination(gpu):
    measured = set()
    for part in set(gpu.PARTS) - {"loader", "memory", "frame"}:
        measured |= set(gpu.cases_of(part, quick=False))
    layers = [f"{layer} {widths}" for layer in gpu.LAYERS for widths in gpu.WIDTHS]
    names, modes = [*gpu.MODELS, *layers], ("eager", "CUDA graph")
    sizes = product(names, (24, 384, 2048), (1, 128, 1024), gpu.PRECISIONS, modes)
    assert {gpu.Case(*case) for case in sizes} <= measured
    assert {gpu.Case(name, 384, 128, mode="compile") for name in names} <= measured


def test_x_on_the_hand_comes_first(gpu):
    assert gpu.PARTS[0] == "target"
    assert gpu.cases_of("target", quick=False)[0] == gpu.Case("X", 384, 128, "float32", "eager")


def test_failed_side_is_a_row_with_its_reason(gpu):
    benchmark = benchmark_of(gpu)
    sides = gpu.make_sides("X", 24, 2, "cpu")

    class Broken(torch.nn.Module):
        def forward(self, *inputs):
            raise RuntimeError("out of | memory\nmore lines")

    sides["plain"] = gpu.Side(Broken(), sides["plain"].inputs, sides["plain"].loss)
    benchmark.sides = lambda *case: sides
    row = benchmark._case(gpu.Case("StaticGCNConv 3-16", 24, 2))
    assert row["reasons"] == {"plain": "RuntimeError: out of / memory"}
    assert list(row["ms"]) == ["ours"]
    assert row["frames_per_second"] > 0
    assert "ratio" not in row
    lines = gpu.case_table([row])
    assert "| RuntimeError: out of / memory |" in lines[2]


def test_sides_that_cannot_be_made_are_a_row(gpu):
    benchmark = benchmark_of(gpu)
    row = benchmark._case(gpu.Case("X", 25, 2))
    assert set(row["reasons"]) == {"plain", "ours"}
    assert "must be 384 or one of [24, 2048] (got 25)" in row["reasons"]["ours"]


def test_ratio_is_that_of_plain_to_ours(gpu, monkeypatch):
    benchmark = benchmark_of(gpu)
    monkeypatch.setattr(gpu, "in_turns", lambda *_: {"plain": [6.0, 8.0, 9.0], "ours": [2.0] * 3})
    row = benchmark._case(gpu.Case("X", 24, 4))
    assert row["ms"] == {"plain": 8000.0, "ours": 2000.0}
    assert row["ratio"] == row["ratio_to_eager"] == 4.0
    assert row["frames_per_second"] == 2.0


def test_nothing_begins_without_time_and_all_is_named(gpu):
    benchmark = benchmark_of(gpu)
    benchmark.budget.end = 0.0
    for name in gpu.PARTS:
        benchmark.run(name)
    assert not any(benchmark.parts.values())
    text = "\n".join(benchmark.left_out)
    for what in ("loader", "memory", "frame", "target: X, N = 24, B = 4, eager", "nodes: TaxelNet"):
        assert what in text


def test_figures_are_written_after_each_row(gpu, tmp_path, monkeypatch):
    out = tmp_path / "gpu.json"
    benchmark = benchmark_of(gpu, "--out", str(out))
    seen = []

    def case_or_end(case):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(case)
        return {"name": case.name}

    monkeypatch.setattr(benchmark, "_case", case_or_end)
    with pytest.raises(KeyboardInterrupt):
        benchmark.run("models")
    assert json.loads(out.read_text())["parts"]["models"] == [{"name": "II"}, {"name": "II"}]


def test_plain_layers_keep_edges_only_for_a_graph(gpu):
    module = gpu.make_sides("X", 24, 2, "cpu")["plain"].module
    conv = module.thread.convs[0]
    with gpu.edges_kept(module):
        assert conv.cached
    assert not conv.cached
    assert conv._cached_edge_index is None


def test_a_captured_step_keeps_what_it_works_on(gpu, monkeypatch):
    class Step:
        def __call__(self):
            pass

    monkeypatch.setattr(gpu, "torch", MagicMock())
    step = Step()
    memory = weakref.ref(step)  # of an optimizer, which a graph writes to and does not hold
    replay = gpu.captured(step, lambda: None)
    del step
    gc.collect()
    assert memory() is not None
    replay()
    del replay
    gc.collect()
    assert memory() is None


def test_no_device_is_said(gpu, capsys, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert gpu.main([]) == 2
    assert "--device cpu --quick" in capsys.readouterr().err


@pytest.mark.full
def test_quick_run_measures_every_part(tmp_path):
    out = tmp_path / "gpu.json"
    command = [sys.executable, str(FOLDER / "gpu.py"), "--device", "cpu", "--quick"]
    done = subprocess.run(
        [*command, "--out", str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    content = json.loads(out.read_text())
    assert content["lost"] is None
    assert set(content["left_out"]) == {
        "TF32, which needs a CUDA device",
        "CUDA graphs, which need a CUDA device",
    }
    for name, rows in content["parts"].items():
        assert rows, name
        assert f"\n## {name}\n" in done.stdout
        assert not [row for row in rows if row.get("reason") or row.get("reasons")]
