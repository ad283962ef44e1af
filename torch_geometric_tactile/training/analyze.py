r"""What a checkpoint has learnt, as numbers, pictures and a page."""

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import torch
from lightning.pytorch.cli import instantiate_module
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile import analysis
from torch_geometric_tactile.analysis.roc import MACRO
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.nn.conv import EdgeFeatureEncoder
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.training.config import load_config
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileClassifier
from torch_geometric_tactile.typing import PathLike
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_embedding,
    plot_hand,
    plot_hand_panels,
    plot_label_confusions,
    plot_roc,
    save_figure,
)

_NUM_UNTRAINED = 3
_METHODS = {"tsne": "t-SNE", "umap": "UMAP"}


class Section(NamedTuple):
    r"""A part of the page.

    Args:
        title (str): Its heading.
        text (str): Markdown.
        pictures (tuple of str): Names of pictures beside the page.
    """

    title: str
    text: str
    pictures: tuple[str, ...] = ()


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
    facts = {
        "Checkpoint": f"`{checkpoint.name}`, after {content['epoch'] + 1} epochs",
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
    loader = data.test_dataloader()
    num_samples = len(loader.dataset)
    index = torch.linspace(0, num_samples - 1, min(frames, num_samples)).round().long()
    batch: StaticData = loader.dataset.batch(index)
    run = _Run(classifier, data, batch, out, seed)
    sections = list(run.sections())
    classifier.train(training)
    facts = {
        **(facts or {}),
        "Data": _source(data),
        "Test part": f"{num_samples:,} frames; {len(index)} of them, evenly spaced, for "
        "embeddings and attribution",
        "Seed of embeddings and untrained models": str(seed),
    }
    page = out / "analysis.md"
    with atomic_path(page) as temporary:
        temporary.write_text(_markdown(facts, sections), encoding="utf-8")
    return page


class _Run:
    def __init__(
        self,
        classifier: TactileClassifier,
        data: TactileDataModule,
        batch: StaticData,
        out: Path,
        seed: int,
    ) -> None:
        self.classifier = classifier
        self.model: Module = classifier.model
        self.data = data
        self.batch = batch
        self.out = out
        self.seed = seed
        self.layout: TaxelLayout = data.layout
        names = data.class_names or [str(i) for i in range(classifier.num_classes)]
        self.names = [name.replace("_", " ") for name in names]

    def sections(self) -> Iterator[Section]:
        yield self.scores()
        links = set(HandKinematics.allegro().link_names)
        if not links.issuperset(self.layout.link_names):
            yield Section("Left out", "All that is drawn on a hand: the layout is of another.")
            return
        if isinstance(getattr(self.model, "encoder", None), EdgeFeatureEncoder):
            yield self.encoder()
        else:
            yield Section("Left out", "The encoder map: this model has no dense edge encoder.")
        if hasattr(self.model, "node_features"):
            yield self.features()
        else:
            yield Section("Left out", "Node features: this model has none.")
        yield self.attribution()

    def scores(self) -> Section:
        with torch.no_grad():
            batches = [(self.classifier(b), b.y) for b in self.data.test_dataloader()]
        logits, y = (torch.cat(part) for part in zip(*batches, strict=True))
        y, score = y.long(), self.classifier.probability(logits)
        curves = analysis.roc_curves(y, score, self.names)
        if self.classifier.task == "multilabel":
            prediction = (logits > 0).long()
            counts = analysis.label_confusion(y, prediction)
            right = (prediction == y).all(dim=1).double().mean()
            text = f"All labels right: {right:.1%}. Label by label: {(prediction == y).double().mean():.1%}."
            figure = plot_label_confusions(counts, self.names, "Labels of the test part")
        else:
            prediction = logits.argmax(dim=1)
            counts = analysis.class_confusion(y, prediction, len(self.names))
            text = f"Accuracy: {(prediction == y).double().mean():.1%}."
            figure = plot_confusion(counts, self.names, "Classes of the test part")
        save_figure(figure, self.out / "confusion.png")
        save_figure(
            plot_roc(curves, "Each against all others", bold=MACRO), self.out / "roc.png"
        )
        text += f" Area under the ROC curve, mean of all: {curves[MACRO].auc:.3f}."
        return Section("Confusion and ROC", text, ("confusion.png", "roc.png"))

    def encoder(self) -> Section:
        encoder = self.model.encoder
        edge_index = self.batch.edge_index
        value = analysis.encoder_map(encoder, self.layout.num_taxels, edge_index.size(1))
        size = self.batch.edge_attr.abs().mean(dim=-1)
        size = size.mean(dim=0) if size.dim() == 2 else size
        assert self.layout.link is not None
        rows = []
        for name, segment in (("patches", self.layout.patch), ("links", self.layout.link)):
            assert segment is not None
            found = analysis.edge_separation(value, edge_index, segment)
            fresh = analysis.untrained_separation(encoder, edge_index, segment, 5)
            inputs = analysis.edge_separation(size, edge_index, segment)
            rows.append(
                f"| between {name} | {found.num_between} of {len(value)} | {found.auc:.3f} | "
                f"{fresh.mean():.3f} ± {fresh.std():.3f} | {inputs.auc:.3f} |"
            )
        constant = int((size == 0).sum())
        text = "\n".join(
            [
                "One value for each edge: the first principal component of the encoder's mean "
                "absolute weights, larger for larger weights. How far it tells edges apart (AUC: "
                "0.5 is not at all, 1 is larger for all, 0 is smaller for all), against encoders "
                "with random weights, and against the size of what comes into the encoder from "
                "each edge (mean absolute edge feature, scaled as the model sees it), which "
                "decides how far training can move its weights:",
                "",
                "| edges | how many | this encoder | 5 untrained | size of the input |",
                "|---|---|---|---|---|",
                *rows,
                "",
                f"{constant} edges have features that are zero in every frame looked at; training "
                "cannot move their weights.",
            ]
        )
        figure = plot_hand(
            self.layout,
            adjacency=edge_index,
            edge_value=value,
            edge_label="first principal component of the mean |weight|",
            title="Encoder map",
        )
        save_figure(figure, self.out / "encoder_map.png")
        return Section("Encoder of edge features", text, ("encoder_map.png",))

    def features(self) -> Section:
        segments = {by: self.layout.segments(by) for by in ("patch", "digit")}
        trained = self._features(self.model)
        described = {"this model": [trained], "readings": [self.batch.x]}
        described[f"{_NUM_UNTRAINED} untrained models"] = [
            self._features(self._untrained(self.seed + i)) for i in range(_NUM_UNTRAINED)
        ]
        rows = []
        for name, features in described.items():
            cells = []
            for segment in segments.values():
                found = [analysis.segment_clustering(f, segment) for f in features]
                cells.append(f"{_mean(found, 'silhouette'):.3f}")
                cells.append(f"{_mean(found, 'neighbor_share'):.1%}")
            rows.append(f"| {name} | {' | '.join(cells)} |")
        pictures = []
        for method, name in _METHODS.items():
            for dims in (2, 3) if method == "tsne" else (2,):
                places = analysis.embed_nodes(trained, method, dims, self.seed)  # type: ignore[arg-type]
                title = f"{name} of node features in {dims} dimensions"
                figure = plot_embedding(places, self.layout, axis_name=name, title=title)
                pictures.append(f"{method}_{dims}d.png")
                save_figure(figure, self.out / pictures[-1])
        text = "\n".join(
            [
                f"Each taxel by its features ({_shape(trained)}) in all frames side by side, each "
                "channel scaled to mean zero and deviation one. Silhouette, and which part of a "
                "taxel's 10 nearest neighbours is of its own segment, both in the space of the "
                "features:",
                "",
                "| features of | silhouette by patch | neighbours in patch | silhouette by digit | "
                "neighbours in digit |",
                "|---|---|---|---|---|",
                *rows,
                "",
                "Only what differs from the untrained models was learnt.",
            ]
        )
        return Section("Node features", text, tuple(pictures))

    def attribution(self) -> Section:
        y = self.batch.y.long()
        patch = self.layout.segments("patch")
        scores, drops, agreement, lines = {}, {}, [], []
        for i, name in enumerate(self.names):
            chosen = y[:, i] == 1 if y.dim() == 2 else y == i
            if int(chosen.sum()) < 2:
                continue
            batch = self.batch.index_select(chosen)
            reference = self.batch.x.mean(dim=0)
            score = analysis.taxel_attribution(self.model, batch, i)
            drop = analysis.patch_occlusion(self.model, batch, i, patch, reference=reference)
            by_patch = torch.zeros(len(drop)).index_add(0, patch, score)
            agreement.append(float(torch.corrcoef(torch.stack([by_patch, drop]))[0, 1]))
            first = drop.topk(min(3, len(drop))).indices.tolist()
            best = ", ".join(f"{self.layout.patch_names[k]} ({drop[k]:+.2f})" for k in first)
            lines.append(f"| {name} | {int(chosen.sum())} | {best} | {agreement[-1]:.2f} |")
            scores[name], drops[name] = score, drop[patch]
        if not scores:
            return Section("Attribution", "No class has two frames among those looked at.")
        columns = 3 if len(scores) in (3, 5, 6) else 4
        for file, values, label in (
            ("attribution.png", scores, "attribution (logit)"),
            ("occlusion.png", drops, "drop of the logit without the patch"),
        ):
            figure = plot_hand_panels(self.layout, values, label=label, columns=columns)
            save_figure(figure, self.out / file)
        text = "\n".join(
            [
                "Over the frames that have a class or label: which readings raise its logit "
                "(integrated gradients from the zero of the scaled readings, mean over frames), "
                "and how far the logit drops when a patch's readings give way to their mean over "
                "all frames looked at. Correlation: of both over the patches.",
                "",
                "| class or label | frames | largest drops | correlation |",
                "|---|---|---|---|",
                *lines,
            ]
        )
        return Section("Attribution", text, ("attribution.png", "occlusion.png"))

    def _features(self, model: Module) -> Tensor:
        names = getattr(model, "modalities", ())
        inputs = {name: self.batch[name] for name in names}
        thread = {"thread": "tactile"} if "tactile" in getattr(model, "threads", ()) else {}
        with torch.no_grad():
            out: Tensor = model.node_features(  # type: ignore[operator]
                self.batch.x, self.batch.edge_index, **inputs, **thread
            )
        return out

    def _untrained(self, seed: int) -> Module:
        fresh = copy.deepcopy(self.model)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            fresh.reset_parameters()  # type: ignore[operator]
        return fresh


def _mean(found: list[analysis.SegmentClustering], name: str) -> float:
    values: list[float] = [getattr(one, name) for one in found]
    return sum(values) / len(values)


def _shape(features: Tensor) -> str:
    return f"{features.size(-1)} channels"


def _source(data: TactileDataModule) -> str:
    dataset: Any = data.dataset if data.test_dataset is None else data.test_dataset
    kind = {True: "**simulated**, never a real hand's result", False: "measured"}
    said = kind.get(getattr(dataset, "synthetic", None), "source unknown")
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
