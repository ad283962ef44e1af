r"""The page of an analysis: what a model has learnt, in numbers and pictures."""

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
from torch_geometric_tactile.reports._analysis_sections import Section, Subject
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
    r"""Analyses a checkpoint of ``tactile fit``, or a predictor, on the test part of its data, and
    returns the page.
    """
    predictor = open_predictor(model, config)
    data = load_data(model, config, root)
    facts = {
        **_origin(Path(model)),
        "Model": f"`{predictor.model}`".splitlines()[0].rstrip("`(") + "`",
        "Data": _source(data),
    }
    return analyze(
        predictor,
        test_part(data, predictor),
        out,
        facts=facts,
        frames=frames,
        seed=seed,
        name=_name(Path(model)),
    )


def _name(path: Path) -> str | None:
    # RUN/version_0/checkpoints/last.ckpt, as `tactile fit` names them
    if not is_checkpoint(path):
        return path.stem
    parts = path.resolve().parts
    is_of_run = len(parts) > 4 and parts[-2] == "checkpoints" and parts[-3].startswith("version_")
    return parts[-4] if is_of_run else None


def _origin(path: Path) -> dict[str, str]:
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
    r"""Analyses a predictor on labelled samples that it was not trained on, and returns the
    page.
    """
    need(frames >= 2, "'frames' must be at least 2", frames)
    if predictor.task == "regression":
        raise ValueError("'predictor' must predict classes or labels (got task='regression')")
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    index = torch.linspace(0, len(samples) - 1, min(frames, len(samples))).round().long()
    sections = list(Subject(predictor, samples, index, out, seed, name).sections())
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


def _source(data: Any) -> str:
    dataset: Any = data.dataset if data.test_dataset is None else data.test_dataset
    said = "measured or generated, the data set does not say"
    if hasattr(dataset, "synthetic"):
        said = "**simulated**, not a result of a real hand" if dataset.synthetic else "measured"
    split = getattr(dataset, "split_by", data.split if isinstance(data.split, str) else "given")
    seed = getattr(dataset, "split_seed", data.seed)
    return f"`{type(dataset).__name__}`, {said}; split by {split}, split seed {seed}"


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
