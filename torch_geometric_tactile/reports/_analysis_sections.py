r"""The sections of the page of an analysis: numbers, pictures and how to read them."""

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile import analysis
from torch_geometric_tactile._texts import markdown_text
from torch_geometric_tactile.analysis.roc import MACRO
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.nn.conv import EdgeFeatureEncoder
from torch_geometric_tactile.nn.models import MTGCN
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports._predictions import predicted
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

_NUM_UNTRAINED = 3
_NUM_STEPS = 8
_PLACES: tuple[tuple[Literal["tsne", "umap"], int], ...] = (("tsne", 2), ("tsne", 3), ("umap", 2))
_METHOD_NAMES = {"tsne": "t-SNE", "umap": "UMAP"}


class Section(NamedTuple):
    r"""A part of the page."""

    title: str
    text: str
    pictures: tuple[str, ...] = ()


class Subject:
    r"""The predictor and the samples that are analysed."""

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
        self.logits, self.y = self._logits()
        self.names = [name.replace("_", " ") for name in predictor.names(self.logits.size(1))]

    def sections(self) -> Iterator[Section]:
        r"""Yields the sections that model and layout allow, and names those left out."""
        yield self.scores()
        links = set(HandKinematics.allegro().link_names)
        if not links.issuperset(self.layout.link_names):
            yield Section("Left out", "Drawings on the hand: the layout is of another sensor.")
            return
        encoder = getattr(self.model, "encoder", None)
        if isinstance(encoder, EdgeFeatureEncoder):
            yield self.encoder(encoder)
        else:
            yield Section("Left out", "The encoder map: this model has no dense edge encoder.")
        if hasattr(self.model, "node_features"):
            yield self.features()
        else:
            yield Section("Left out", "Node features: this model has none.")
        if "tactile" in getattr(self.model, "inputs", ("tactile",)):
            yield self.attribution()
        else:
            yield Section("Left out", "Attribution: this model takes no readings.")

    def scores(self) -> Section:
        r"""Counts errors on the whole test part."""
        logits, y = self.logits, self.y
        # Not probabilities: those of sure predictions all round to one.
        is_multilabel = self.predictor.task == "multilabel"
        score = logits.double() if is_multilabel else logits.double().log_softmax(dim=-1)
        curves = analysis.roc_curves(y, score, self.names)
        if is_multilabel:
            prediction = (logits > 0).long()
            counts = analysis.label_confusion(y, prediction)
            right = (prediction == y).double()
            text = f"All labels right: {right.amin(dim=1).mean():.1%}; each: {right.mean():.1%}."
            figure = plot_label_confusions(
                counts, self.names, f"{self.name}: labels of the test part"
            )
        else:
            prediction = logits.argmax(dim=1)
            counts = analysis.class_confusion(y, prediction, len(self.names))
            text = f"Accuracy: {(prediction == y).double().mean():.1%}."
            figure = plot_confusion(counts, self.names, f"{self.name}: classes of the test part")
        save_figure(figure, self.out / "confusion.png")
        kind = "each label, with it against without" if is_multilabel else "each class against all"
        figure = plot_roc(curves, f"{self.name}: ROC of {kind}", bold=MACRO)
        save_figure(figure, self.out / "roc.png")
        text += f" Area under the ROC curve, mean of all: {curves[MACRO].auc:.3f}."
        return Section("Confusion and ROC", text, ("confusion.png", "roc.png"))

    def encoder(self, encoder: EdgeFeatureEncoder) -> Section:
        r"""Draws the map of the edge encoder, and measures which edges it separates."""
        edge_index = self.batch.edge_index
        dims = (encoder.edge_dim, encoder.out_channels)
        value = analysis.encoder_map(encoder, self.layout.num_taxels, edge_index.size(1), *dims)
        blocks = analysis.encoder_blocks(encoder, edge_dim=dims[0], out_channels=dims[1])
        variance = (blocks - blocks.mean(dim=0)).square().sum()
        share = float(value.double().square().sum() / variance) if variance > 0 else 0.0
        size = self.batch.edge_attr.abs().mean(dim=-1)
        size = size.mean(dim=0) if size.dim() == 2 else size
        assert self.layout.link is not None
        rows = []
        for name, segment in (("patches", self.layout.patch), ("links", self.layout.link)):
            assert segment is not None
            found = analysis.edge_separation(value, edge_index, segment)
            fresh = analysis.untrained_separation(encoder, edge_index, segment, 5, *dims)
            inputs = analysis.edge_separation(size, edge_index, segment)
            rows.append(
                f"| between {name} | {found.num_between} of {len(value)} | {found.auc:.3f} | "
                f"{fresh.mean():.3f} ± {fresh.std():.3f} | {inputs.auc:.3f} |"
            )
        constant = int((size == 0).sum())
        text = "\n".join(
            [
                "One value for each edge: the first principal component of the encoder's mean "
                f"absolute weights ({share:.0%} of their variance), larger for larger weights. "
                "AUC says how well it separates edges (0.5: not at all, 1: larger for all, 0: "
                "smaller for all). Compare it with encoders with random weights, and with the "
                "size of the encoder's input from each edge (mean absolute edge feature, scaled "
                "as for the model), which decides how far training can move its weights:",
                "",
                "| edges | number | this encoder | 5 untrained | size of the input |",
                "|---|---|---|---|---|",
                *rows,
                "",
                f"{constant} edges have features that are zero in each of these frames; training "
                "cannot move their weights.",
            ]
        )
        # Relative, so that the maps of two models can be compared.
        figure = plot_hand(
            self.layout,
            adjacency=edge_index,
            edge_value=value / (value.abs().max() or 1.0),
            edge_limits=(-1.0, 1.0),
            edge_cmap="sequential",
            edge_label="first principal component of the mean |weight|, relative to its largest",
            title=f"Encoder map of {self.name}",
        )
        save_figure(figure, self.out / "encoder_map.png")
        return Section("Encoder of edge features", text, ("encoder_map.png",))

    def features(self) -> Section:
        r"""Embeds node features, and measures clusters by segment."""
        segments = {by: self.layout.segments(by) for by in ("patch", "digit")}
        trained = self._features(self.model)
        described = {"this model": [trained], "readings": [self.batch.x]}
        fresh = [self._features(self._untrained(self.seed + i)) for i in range(_NUM_UNTRAINED)]
        described[f"{_NUM_UNTRAINED} untrained models"] = fresh
        rows = []
        for name, features in described.items():
            cells = []
            for segment in segments.values():
                found = [analysis.segment_clustering(f, segment) for f in features]
                cells.append(f"{_mean(found, 'silhouette'):.3f}")
                cells.append(f"{_mean(found, 'neighbor_share'):.1%}")
            rows.append(f"| {name} | {' | '.join(cells)} |")
        pictures = []
        for method, dims in _PLACES:
            places, twin = (
                analysis.embed_nodes(features, method, dims, self.seed)
                for features in (trained, fresh[0])
            )
            name = _METHOD_NAMES[method]
            title = f"{self.name}: {name} of node features in {dims} dimensions"
            figure = plot_embedding(
                places, self.layout, axis_name=name, title=title, untrained=twin
            )
            pictures.append(f"{method}_{dims}d.png")
            save_figure(figure, self.out / pictures[-1])
        text = "\n".join(
            [
                f"Each taxel is described by its features ({trained.size(-1)} channels) in all "
                "frames, each channel scaled to mean zero and standard deviation one. The table "
                "has the silhouette, and the share of a taxel's 10 nearest neighbours that belong "
                "to its segment, both in the space of the features:",
                "",
                "| features of | silhouette by patch | neighbours in patch | silhouette by digit | "
                "neighbours in digit |",
                "|---|---|---|---|---|",
                *rows,
                "",
                "Only the difference from the untrained models was learnt.",
            ]
        )
        return Section("Node features", text, tuple(pictures))

    def attribution(self) -> Section:
        r"""Draws how much taxels and patches contribute to each class or label."""
        y = self.batch.y.long()
        patch = self.layout.segments("patch")
        scores, drops, agreement, lines = {}, {}, [], []
        for i, name in enumerate(self.names):
            chosen = y[:, i] == 1 if y.dim() == 2 else y == i
            if int(chosen.sum()) < 2:
                continue
            batch = self.batch.index_select(chosen)
            reference = self.batch.x.mean(dim=0)
            algorithm = analysis.IntegratedGradients(_NUM_STEPS)
            score = analysis.taxel_attribution(self.model, batch, i, algorithm=algorithm)
            drop = analysis.patch_occlusion(self.model, batch, i, patch, reference=reference)
            by_patch = torch.zeros(len(drop)).index_add(0, patch, score)
            agreement.append(float(torch.corrcoef(torch.stack([by_patch, drop]))[0, 1]))
            first = drop.topk(min(3, len(drop))).indices.tolist()
            patches = [markdown_text(self.layout.patch_names[k]) for k in first]
            best = ", ".join(f"{p} ({drop[k]:+.2f})" for p, k in zip(patches, first, strict=True))
            cells = [markdown_text(name), str(int(chosen.sum())), best, f"{agreement[-1]:.2f}"]
            lines.append(f"| {' | '.join(cells)} |")
            scores[name], drops[name] = score, drop[patch]
        if not scores:
            return Section("Attribution", "No class has two of the frames.")
        columns = 3 if len(scores) in (3, 5, 6) else 4
        for file, values, label in (
            ("attribution.png", scores, "attribution (logit)"),
            ("occlusion.png", drops, "drop of the logit without the patch"),
        ):
            # A few taxels must not take the colour from all others.
            limit = float(torch.cat(list(values.values())).abs().quantile(0.99)) or None
            figure = plot_hand_panels(
                self.layout,
                values,
                label=label,
                columns=columns,
                limit=limit,
                title=f"{self.name}: what speaks for each class or label",
            )
            save_figure(figure, self.out / file)
        text = "\n".join(
            [
                "Attribution shows which readings raise the logit of a class or label (integrated "
                "gradients from the zero of the scaled readings, mean over the frames that have "
                "it). Occlusion shows how far the logit drops when a patch's readings are replaced "
                "by their mean over these frames. The correlation of both is over the patches.",
                "",
                "| class or label | frames | largest drops | correlation |",
                "|---|---|---|---|",
                *lines,
            ]
        )
        return Section("Attribution", text, ("attribution.png", "occlusion.png"))

    def _logits(self) -> tuple[Tensor, Tensor]:
        found = [(logits, data.y) for logits, data in predicted(self.predictor, self.samples)]
        logits, y = (torch.cat(parts) for parts in zip(*found, strict=True))
        return logits, y.long()

    def _features(self, model: Module) -> Tensor:
        names = getattr(model, "modalities", ())
        inputs = {name: self.batch[name] for name in names}
        is_tactile = isinstance(model, MTGCN) and "tactile" in model.threads
        thread = {"thread": "tactile"} if is_tactile else {}
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
