r"""What a checkpoint has learnt, as numbers, pictures and a page."""

from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.cli import instantiate_module

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.reports.analysis_sections import Section, Subject
from torch_geometric_tactile.training.config import load_config
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileClassifier
from torch_geometric_tactile.typing import PathLike


def main(
    checkpoint: PathLike,
    out: PathLike,
    config: str | None = None,
    root: PathLike | None = None,
    frames: int = 200,
    seed: int = 0,
) -> Path:
    r"""Analyses a checkpoint of ``tactile fit`` on its test part, and returns the page.

    Args:
        checkpoint (str or PathLike): The checkpoint.
        out (str or PathLike): Folder of page and pictures.
        config (str, optional): The configuration whose :obj:`data` it was trained on, a file or a
            shipped one; the :obj:`config.yaml` of the run if left out.
        root (str or PathLike, optional): Folder of the data, instead of the configuration's.
        frames (int): How many frames of the test part, evenly spaced, are embedded and explained.
        seed (int): Seed of embeddings and of untrained models.

    Raises:
        FileNotFoundError: If there is no checkpoint or no configuration.
        ValueError: If the checkpoint is of another layout than the data, or there is no test part.
    """
    checkpoint = Path(checkpoint)
    if not checkpoint.is_file():
        raise FileNotFoundError(f"there is no checkpoint '{checkpoint}'")
    settings = load_config(config or _run_config(checkpoint))["data"]
    if root is not None:
        for key in ("dataset", "val_dataset", "test_dataset"):
            if settings.get(key):
                settings[key].setdefault("init_args", {})["root"] = str(root)
    data: TactileDataModule = instantiate_module(TactileDataModule, settings)
    data.setup()
    content = torch.load(checkpoint, map_location="cpu", weights_only=True, mmap=True)
    data.load_state_dict(content[TactileDataModule.__qualname__])
    classifier = TactileClassifier.load_from_checkpoint(
        checkpoint, map_location="cpu", weights_only=True
    )
    if classifier.layout is not None and not classifier.layout.matches(data.layout):
        raise ValueError(
            f"the checkpoint must be of layout '{data.layout.name}', as the data "
            f"(got '{classifier.layout.name}')"
        )
    epochs = content["epoch"] + 1
    facts = {
        "Checkpoint": f"`{checkpoint.name}`, after {epochs} epoch{'s' if epochs > 1 else ''}",
        "Model": f"`{classifier.model}`".splitlines()[0].rstrip("`(") + "`",
    }
    return analyze(classifier, data, out, facts, frames, seed)


def _run_config(checkpoint: Path) -> str:
    path = checkpoint.parent.parent / "config.yaml"
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no '{path}', which a run has beside its checkpoints: give '--config'"
        )
    return str(path)


def analyze(
    classifier: TactileClassifier,
    data: TactileDataModule,
    out: PathLike,
    facts: dict[str, str] | None = None,
    frames: int = 200,
    seed: int = 0,
) -> Path:
    r"""Analyses a classifier on the test part of its data, and returns the page.

    Args:
        classifier (TactileClassifier): The classifier.
        data (TactileDataModule): Its data, set up.
        out (str or PathLike): Folder of page and pictures.
        facts (dict, optional): What to say first on the page.
        frames (int): How many frames of the test part, evenly spaced, are embedded and explained.
        seed (int): Seed of embeddings and of untrained models.

    Raises:
        ValueError: If :obj:`frames` is below two, or there is no test part.
    """
    if frames < 2:
        raise ValueError(f"'frames' must be at least 2 (got {frames})")
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    training = classifier.training
    classifier.eval()
    part: Any = data.test_dataloader().dataset
    index = torch.linspace(0, len(part) - 1, min(frames, len(part))).round().long()
    batch: StaticData = part.__getitems__(index.tolist())  # as a loader asks for a batch
    subject = Subject(classifier, data, batch, out, seed)
    sections = list(subject.sections())
    classifier.train(training)
    facts = {
        **(facts or {}),
        "Data": _source(data),
        "Test part": f"{len(part):,} frames; {len(index)} of them, evenly spaced, for "
        "embeddings and attribution",
        "Seed of embeddings and untrained models": str(seed),
    }
    page = out / "analysis.md"
    with atomic_path(page) as temporary:
        temporary.write_text(_markdown(facts, sections), encoding="utf-8")
    return page


def _source(data: TactileDataModule) -> str:
    dataset: Any = data.dataset if data.test_dataset is None else data.test_dataset
    said = "measured or generated, the data set does not say"
    if hasattr(dataset, "synthetic"):
        said = "**simulated**, never a real hand's result" if dataset.synthetic else "measured"
    split = getattr(dataset, "split_by", data.split if isinstance(data.split, str) else "given")
    seed = getattr(dataset, "split_seed", data.seed)
    return f"`{type(dataset).__name__}`, {said}; split by {split}, split seed {seed}"


def _markdown(facts: dict[str, str], sections: list[Section]) -> str:
    parts = ["# What the model has learnt", *(f"- {key}: {text}" for key, text in facts.items())]
    blocks = ["\n".join([parts[0], "", *parts[1:]])]
    for section in sections:
        pictures = [f"![{section.title}: {name}]({name})" for name in section.pictures]
        blocks.append("\n\n".join([f"## {section.title}", section.text, *pictures]))
    return "\n\n".join(blocks) + "\n"
