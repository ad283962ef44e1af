r"""The analysis of a trained model, as a page of numbers and pictures."""

from pathlib import Path
from typing import Any

import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.data._torch_file import read_torch_file
from torch_geometric_tactile.predictor import Predictor, is_checkpoint
from torch_geometric_tactile.reports._analysis_sections import PredictorAnalysis, Section
from torch_geometric_tactile.reports._run_data import load_data, open_predictor, test_part


def write_analysis(
    model: PathLike,
    out: PathLike,
    *,
    config: str | None = None,
    root: PathLike | None = None,
    frames: int = 200,
    seed: int = 0,
) -> Path:
    r"""Analyses a checkpoint of ``tactile fit``, or a predictor, on the test part of its data.
    Returns the path of the page.
    """
    predictor = open_predictor(model, config)
    data = load_data(model, config, root)
    facts = {
        **_model_facts(Path(model)),
        "Model": f"`{predictor.model}`".splitlines()[0].rstrip("`(") + "`",
        "Data": _describe_data(data),
    }
    return analyze(
        predictor,
        test_part(data, predictor),
        out,
        facts=facts,
        frames=frames,
        seed=seed,
        name=_run_name(Path(model)),
    )


def _run_name(path: Path) -> str | None:
    # `tactile fit` writes checkpoints as RUN/version_0/checkpoints/last.ckpt.
    if not is_checkpoint(path):
        return path.stem
    parts = path.resolve().parts
    is_run_folder = (
        len(parts) > 4 and parts[-2] == "checkpoints" and parts[-3].startswith("version_")
    )
    return parts[-4] if is_run_folder else None


def _model_facts(path: Path) -> dict[str, str]:
    if not is_checkpoint(path):
        return {"Predictor": f"`{path.name}`"}
    epoch = read_torch_file(path, mmap=True).get("epoch")
    if not isinstance(epoch, int):
        raise ValueError(f"'{path}' must hold the number of its epoch (got {epoch!r})")
    epochs = epoch + 1
    return {"Checkpoint": f"`{path.name}`, after {epochs} epoch{'s' if epochs > 1 else ''}"}


def analyze(
    predictor: Predictor,
    samples: StaticDataset,
    out: PathLike,
    *,
    facts: dict[str, str] | None = None,
    frames: int = 200,
    seed: int = 0,
    name: str | None = None,
) -> Path:
    r"""Analyses a predictor on labelled samples that it was not trained on. Returns the path of the
    page.
    """
    need(frames >= 2, "'frames' must be at least 2", frames)
    if predictor.task == "regression":
        raise ValueError("'predictor' must predict classes or labels (got task='regression')")
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    index = torch.linspace(0, len(samples) - 1, min(frames, len(samples))).round().long()
    sections = list(PredictorAnalysis(predictor, samples, index, out, seed, name).sections())
    facts = {
        **(facts or {}),
        "Test part": f"{len(samples):,} frames; {len(index)} of them, evenly spaced, for "
        "embeddings and attribution",
        "Seed of embeddings and untrained models": str(seed),
    }
    page = out / "analysis.md"
    with atomic_path(page) as temporary:
        temporary.write_text(_markdown(facts, sections), encoding="utf-8")
    return page


def _describe_data(data: Any) -> str:
    dataset: Any = data.dataset if data.test_dataset is None else data.test_dataset
    origin = "unknown whether measured or generated"
    if hasattr(dataset, "synthetic"):
        origin = "**simulated**, not a result of a real hand" if dataset.synthetic else "measured"
    split = getattr(dataset, "split_by", data.split if isinstance(data.split, str) else "given")
    seed = getattr(dataset, "split_seed", data.seed)
    return f"`{type(dataset).__name__}`, {origin}; split by {split}, split seed {seed}"


def _markdown(facts: dict[str, str], sections: list[Section]) -> str:
    parts = [
        "# What the model has learnt",
        *(f"- {key}: {printable(text)}" for key, text in facts.items()),
    ]
    blocks = ["\n".join([parts[0], "", *parts[1:]])]
    for section in sections:
        pictures = [f"![{section.title}: {name}]({name})" for name in section.pictures]
        blocks.append("\n\n".join([f"## {section.title}", section.text, *pictures]))
    return "\n\n".join(blocks) + "\n"
