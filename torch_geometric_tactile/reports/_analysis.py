r"""The analysis of a trained model as a page with numbers and pictures."""

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile import analysis
from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import markdown_text, printable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.analysis.encoder_map import encoder_blocks
from torch_geometric_tactile.analysis.roc import MACRO
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.data._torch_file import read_torch_file
from torch_geometric_tactile.nn.conv import EdgeFeatureEncoder
from torch_geometric_tactile.nn.models import MTGCN
from torch_geometric_tactile.predictor import Predictor, predictor_path
from torch_geometric_tactile.predictor._content import is_checkpoint
from torch_geometric_tactile.reports._predictions import predict_batches
from torch_geometric_tactile.reports._run_data import load_data, open_predictor, test_part
from torch_geometric_tactile.sensors import HandKinematics
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_embedding,
    plot_hand,
    plot_hand_panels,
    plot_label_confusions,
    plot_roc,
    save_figure,
)

_NUM_UNTRAINED_MODELS = 3
_NUM_STEPS = 8  # of integrated gradients; each costs a pass through the model for every frame
_EMBEDDINGS: tuple[tuple[Literal["tsne", "umap"], int], ...] = (
    ("tsne", 2),
    ("tsne", 3),
    ("umap", 2),
)
_METHOD_NAMES = {"tsne": "t-SNE", "umap": "UMAP"}


class Section(NamedTuple):
    r"""A section of the page and the names of its pictures."""

    title: str
    text: str
    pictures: tuple[str, ...] = ()


class PredictorAnalysis:
    r"""The analysis of a predictor on labelled samples, section by section."""

    def __init__(
        self,
        predictor: Predictor,
        samples: StaticDataset,
        index: Tensor,
        out: Path,
        seed: int,
        name: str | None = None,
    ) -> None:
        self.name = name or type(predictor.model).__name__
        self.predictor = predictor
        self.model: Module = predictor.model
        self.samples = samples
        self.batch = predictor.prepare_samples(samples.batch(index))
        self.out = out
        self.seed = seed
        self.layout = predictor.layout
        self.logits, self.y = self._predict()
        self.names = [name.replace("_", " ") for name in predictor.names(self.logits.size(1))]

    def sections(self) -> Iterator[Section]:
        r"""Yields the sections that the model and the layout support, and notes on sections that
        are left out.
        """
        yield self.scores()
        links = set(HandKinematics.allegro().link_names)
        if not links.issuperset(self.layout.link_names):
            yield Section(
                "Left out", "Drawings on the hand: the layout is not a layout of the Allegro hand."
            )
            return
        encoder = getattr(self.model, "encoder", None)
        if isinstance(encoder, EdgeFeatureEncoder):
            yield self.encoder(encoder)
        else:
            yield Section("Left out", "The encoder map: this model has no dense edge encoder.")
        if hasattr(self.model, "node_features"):
            yield self.features()
        else:
            yield Section("Left out", "Node features: this model does not compute them.")
        if "tactile" in getattr(self.model, "inputs", ("tactile",)):
            yield self.attribution()
        else:
            yield Section("Left out", "Attribution: this model has no tactile input.")

    def scores(self) -> Section:
        r"""Returns the confusion matrices and ROC curves of the full test part."""
        logits, y = self.logits, self.y
        # Logits or log-probabilities are used because confident probabilities all round to one.
        is_multilabel = self.predictor.task == "multilabel"
        score = logits.double() if is_multilabel else logits.double().log_softmax(dim=-1)
        curves = analysis.roc_curves(y, score, self.names)
        if is_multilabel:
            prediction = (logits > 0).long()
            counts = analysis.label_confusion(y, prediction)
            is_correct = (prediction == y).double()
            text = (
                f"All labels correct: {is_correct.amin(dim=1).mean():.1%}; single labels: "
                f"{is_correct.mean():.1%}."
            )
            figure = plot_label_confusions(
                counts, self.names, f"{self.name}: labels of the test part"
            )
        else:
            prediction = logits.argmax(dim=1)
            counts = analysis.class_confusion(y, prediction, len(self.names))
            text = f"Accuracy: {(prediction == y).double().mean():.1%}."
            figure = plot_confusion(counts, self.names, f"{self.name}: classes of the test part")
        save_figure(figure, self.out / "confusion.png")
        contrast = (
            "each label, samples with it against samples without it"
            if is_multilabel
            else "each class against all"
        )
        figure = plot_roc(curves, f"{self.name}: ROC of {contrast}", bold=MACRO)
        save_figure(figure, self.out / "roc.png")
        text += f" Mean area under the ROC curves: {curves[MACRO].auc:.3f}."
        return Section("Confusion and ROC", text, ("confusion.png", "roc.png"))

    def encoder(self, encoder: EdgeFeatureEncoder) -> Section:
        r"""Draws the map of the edge encoder, and measures how well it separates edges."""
        edge_index = self.batch.edge_index
        widths = (encoder.edge_dim, encoder.out_channels)
        edge_value = analysis.encoder_map(
            encoder, self.layout.num_taxels, edge_index.size(1), *widths
        )
        blocks = encoder_blocks(encoder, edge_dim=widths[0], out_channels=widths[1])
        variance = (blocks - blocks.mean(dim=0)).square().sum()
        explained = float(edge_value.double().square().sum() / variance) if variance > 0 else 0.0
        input_size = self.batch.edge_attr.abs().mean(dim=-1)
        input_size = input_size.mean(dim=0) if input_size.dim() == 2 else input_size
        assert self.layout.link is not None
        rows = []
        for name, segment in (("patches", self.layout.patch), ("links", self.layout.link)):
            assert segment is not None
            separation = analysis.edge_separation(edge_value, edge_index, segment)
            random_aucs = analysis.untrained_separation(encoder, edge_index, segment, 5, *widths)
            input_separation = analysis.edge_separation(input_size, edge_index, segment)
            rows.append(
                f"| between {name} | {separation.num_between} of {len(edge_value)} | "
                f"{separation.auc:.3f} | {random_aucs.mean():.3f} ± {random_aucs.std():.3f} | "
                f"{input_separation.auc:.3f} |"
            )
        num_constant = int((input_size == 0).sum())
        text = "\n".join(
            [
                "Each edge has one value: the first principal component of the encoder's mean "
                f"absolute weights ({explained:.0%} of their variance). It is larger for larger "
                "weights. The AUC measures how well this value separates edges between segments "
                "from edges within them (0.5: not at all, 1: larger between, 0: smaller between). "
                "Compare it with encoders with random weights, and with the size of the encoder's "
                "input from each edge (mean absolute edge feature, scaled as for the model). The "
                "input size limits how far training can move the weights:",
                "",
                "| edges | number | this encoder | 5 untrained | input size |",
                "|---|---|---|---|---|",
                *rows,
                "",
                f"{num_constant} edges have zero features in all of these frames. Training cannot "
                "change their weights.",
            ]
        )
        # Normalized, so that the maps of two models can be compared.
        figure = plot_hand(
            self.layout,
            adjacency=edge_index,
            edge_value=edge_value / (edge_value.abs().max() or 1.0),
            edge_limits=(-1.0, 1.0),
            edge_cmap="sequential",
            edge_label="first principal component of the mean |weight|, relative to its largest",
            title=f"Encoder map of {self.name}",
        )
        save_figure(figure, self.out / "encoder_map.png")
        return Section("Encoder of edge features", text, ("encoder_map.png",))

    def features(self) -> Section:
        r"""Draws embeddings of the node features, and measures their clustering by segment."""
        segments = {by: self.layout.segments(by) for by in ("patch", "digit")}
        trained = self._node_features(self.model)
        compared_features = {"this model": [trained], "readings": [self.batch.x]}
        untrained = [
            self._node_features(self._untrained_model(self.seed + i))
            for i in range(_NUM_UNTRAINED_MODELS)
        ]
        compared_features[f"{_NUM_UNTRAINED_MODELS} untrained models"] = untrained
        rows = []
        for name, features in compared_features.items():
            cells = []
            for segment in segments.values():
                clusterings = [analysis.segment_clustering(f, segment) for f in features]
                cells.append(f"{_mean(clusterings, 'silhouette'):.3f}")
                cells.append(f"{_mean(clusterings, 'neighbor_share'):.1%}")
            rows.append(f"| {name} | {' | '.join(cells)} |")
        pictures = []
        for method, dims in _EMBEDDINGS:
            trained_points, untrained_points = (
                analysis.embed_nodes(features, method, dims, self.seed)
                for features in (trained, untrained[0])
            )
            name = _METHOD_NAMES[method]
            title = f"{self.name}: {name} of node features in {dims} dimensions"
            figure = plot_embedding(
                trained_points, self.layout, axis_name=name, title=title, untrained=untrained_points
            )
            pictures.append(f"{method}_{dims}d.png")
            save_figure(figure, self.out / pictures[-1])
        text = "\n".join(
            [
                f"Each taxel is represented by its features ({trained.size(-1)} channels) in all "
                "frames. Each channel is scaled to mean zero and standard deviation one. The table "
                "gives the silhouette and the share of a taxel's 10 nearest neighbours that "
                "belong to its segment, both in feature space:",
                "",
                "| features of | silhouette by patch | neighbours in patch | silhouette by digit | "
                "neighbours in digit |",
                "|---|---|---|---|---|",
                *rows,
                "",
                "Only the difference from the untrained models is due to training.",
            ]
        )
        return Section("Node features", text, tuple(pictures))

    def attribution(self) -> Section:
        r"""Draws the contributions of taxels and patches to each class or label."""
        y = self.batch.y.long()
        patch = self.layout.segments("patch")
        scores, drops, correlations, rows = {}, {}, [], []
        for i, name in enumerate(self.names):
            in_class = y[:, i] == 1 if y.dim() == 2 else y == i
            if int(in_class.sum()) < 2:
                continue
            batch = self.batch.index_select(in_class)
            reference = self.batch.x.mean(dim=0)
            algorithm = analysis.IntegratedGradients(_NUM_STEPS)
            score = analysis.taxel_attribution(self.model, batch, i, algorithm=algorithm)
            drop = analysis.patch_occlusion(self.model, batch, i, patch, reference=reference)
            patch_score = torch.zeros(len(drop)).index_add(0, patch, score)
            correlations.append(float(torch.corrcoef(torch.stack([patch_score, drop]))[0, 1]))
            top = drop.topk(min(3, len(drop))).indices.tolist()
            top_names = [markdown_text(self.layout.patch_names[k]) for k in top]
            top_drops = ", ".join(
                f"{p} ({drop[k]:+.2f})" for p, k in zip(top_names, top, strict=True)
            )
            cells = [
                markdown_text(name),
                str(int(in_class.sum())),
                top_drops,
                f"{correlations[-1]:.2f}",
            ]
            rows.append(f"| {' | '.join(cells)} |")
            scores[name], drops[name] = score, drop[patch]
        if not scores:
            return Section("Attribution", "No class has at least two of the frames.")
        columns = 3 if len(scores) in (3, 5, 6) else 4  # with few empty panels
        for file_name, values, label in (
            ("attribution.png", scores, "attribution (logit)"),
            ("occlusion.png", drops, "drop of the logit without the patch"),
        ):
            # The 99 % quantile, so that a few taxels do not determine the colour scale.
            limit = float(torch.cat(list(values.values())).abs().quantile(0.99)) or None
            figure = plot_hand_panels(
                self.layout,
                values,
                label=label,
                columns=columns,
                limit=limit,
                title=f"{self.name}: evidence for each class or label",
            )
            save_figure(figure, self.out / file_name)
        text = "\n".join(
            [
                "Attribution shows which readings raise the logit of a class or label (integrated "
                "gradients from the zero of the scaled readings, averaged over the frames with "
                "this class or label). Occlusion shows how far the logit drops when a patch's "
                "readings are replaced by their mean over these frames. The correlation between "
                "attribution and occlusion is computed over the patches.",
                "",
                "| class or label | frames | largest drops | correlation |",
                "|---|---|---|---|",
                *rows,
            ]
        )
        return Section("Attribution", text, ("attribution.png", "occlusion.png"))

    def _predict(self) -> tuple[Tensor, Tensor]:
        batches = [
            (logits, data.y) for logits, data in predict_batches(self.predictor, self.samples)
        ]
        logits, y = (torch.cat(parts) for parts in zip(*batches, strict=True))
        return logits, y.long()

    def _node_features(self, model: Module) -> Tensor:
        names = getattr(model, "modalities", ())
        inputs = {name: self.batch[name] for name in names}
        has_tactile_thread = isinstance(model, MTGCN) and "tactile" in model.threads
        arguments = {"thread": "tactile"} if has_tactile_thread else {}
        with torch.no_grad():
            features: Tensor = model.node_features(  # type: ignore[operator]
                self.batch.x, self.batch.edge_index, **inputs, **arguments
            )
        return features

    def _untrained_model(self, seed: int) -> Module:
        model = copy.deepcopy(self.model)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            model.reset_parameters()  # type: ignore[operator]
        return model


def _mean(clusterings: list[analysis.SegmentClustering], name: str) -> float:
    values: list[float] = [getattr(clustering, name) for clustering in clusterings]
    return sum(values) / len(values)


def write_analysis(
    model: PathLike,
    out: PathLike,
    *,
    config: str | None = None,
    root: PathLike | None = None,
    frames: int = 200,
    seed: int = 0,
) -> Path:
    r"""Analyses a checkpoint from ``tactile fit``, or a predictor, on the test part of its data.
    Returns the path of the page.
    """
    model = predictor_path(model)
    predictor = open_predictor(model, config)
    data = load_data(model, config, root)
    facts = {
        **_model_facts(Path(model)),
        # The first line of a long representation ends with an open bracket.
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
    r"""Analyses a predictor on labelled samples that were not used for training. Returns the path
    of the page.
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
