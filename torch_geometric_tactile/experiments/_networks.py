r"""Experiments with networks."""

import copy
import math
import time
from collections.abc import Sequence
from functools import cache
from typing import Any

import lightning as L
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.data import DataLoader
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments._experiment import Experiment, Fitted
from torch_geometric_tactile.experiments._memory import PeakMemory
from torch_geometric_tactile.experiments.studies import Study, Trained
from torch_geometric_tactile.nn.models._calls import is_graph_model
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._collected_metrics import predicted_classes
from torch_geometric_tactile.training._predictions import Outputs, collect_predictions
from torch_geometric_tactile.training._silent_training import silent_training
from torch_geometric_tactile.training._threshold import choose_threshold
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileModule, classifier_from_config
from torch_geometric_tactile.training.one_cycle import OneCycle
from torch_geometric_tactile.transforms import KNNGraph

_NO_EDGES = torch.zeros(2, 0, dtype=torch.long)
_BAREBONES_SETTINGS = {"accelerator", "limit_val_batches"}  # allowed in Lightning's barebones mode
_NUM_NEIGHBOURS = 6
_MEMBER_SEED_STEP = 1000  # larger than any experiment's seed, so that members never share a seed


def fit_network(
    experiment: Experiment,
    train: SampleSet,
    test: SampleSet,
    val: SampleSet | None = None,
    studies: Sequence[Study] = (),
) -> Fitted:
    r"""Trains a network, or all members of an ensemble (:obj:`experiment.choice`), and predicts the
    test part with their average.

    Args:
        experiment (Experiment): The network and its settings.
        train (StaticDataset): The samples to train on.
        test (StaticDataset): The samples to predict.
        val (StaticDataset, optional): The samples on which a decision threshold is selected.
        studies (sequence of Study): Studies with callbacks for the training.
    """
    choice = experiment.choice
    section, members, scale = dict(experiment.model), 1, None
    if choice is not None:
        members = choice.members
        if choice.is_regression:
            scale = TargetScale.from_samples(train)
        else:
            section.setdefault("num_classes", train.num_classes)
        train, test = (prepare_part(part, scale) for part in (train, test))
    data = TactileDataModule(
        train,
        test,  # a transform that scales each session adapts to the sessions of this part
        split="frame",
        val_dataset=test[:0] if val is None else val,
        transform=build_object(experiment.transform),
        train_transform=build_object(experiment.train_transform, train.layout),
        batch_size=experiment.batch_size,
    )
    data.setup()
    warm_up(experiment.accelerator)
    memory = PeakMemory("cuda" if experiment.accelerator == "gpu" else "cpu")
    settings = {"accelerator": experiment.accelerator, "limit_val_batches": 0}
    settings |= experiment.trainer
    outputs, peaks, seconds, predict_seconds, num_parameters = [], [], 0.0, 0.0, 0
    for member in range(members):
        clock, seed = Clock(), member_seed(experiment.seed, member)
        callbacks = [
            callback for study in studies if (callback := study.callback(data)) is not None
        ]
        callbacks += [] if choice is None else [OneCycle()]
        if experiment.measure_memory:
            memory.start()
        classifier = fit_classifier(
            section, data, seed, settings, experiment.epochs, clock, *callbacks
        )
        if experiment.measure_memory:
            peaks.append(memory.stop())
        seconds += clock.seconds
        num_parameters += sum(weight.numel() for weight in classifier.model.parameters())
        device = classifier.trainer.strategy.root_device if choice is None else None
        if val is not None and experiment.threshold is not None:
            val_outputs = collect_predictions(classifier, data.val_dataloader(), device)
            classifier.decision_threshold = choose_threshold(
                val_outputs.probability[:, 1].numpy(), val_outputs.y.numpy(), experiment.threshold
            )
        start = time.perf_counter()
        outputs.append(collect_predictions(classifier, data.test_dataloader(), device))
        predict_seconds += time.perf_counter() - start
    score, prediction = _average_outputs(outputs, classifier, scale)
    peak = max(peaks, default=math.nan)
    return Fitted(
        score=prediction if choice is not None else score,
        prediction=prediction,
        y=(outputs[0].y if scale is None else scale.unscale(outputs[0].y)).numpy(),
        num_parameters=num_parameters,
        seconds=seconds,
        predict_seconds=predict_seconds,
        task=classifier.task,
        threshold=classifier.decision_threshold,
        loss=_cross_entropy(outputs[0]) if choice is not None and scale is None else 0.0,
        peak_memory_mb=peak if math.isfinite(peak) else None,
        measures=memory.measure if experiment.measure_memory else None,
        label_names=data.class_names if classifier.task == "multilabel" else None,
        trained=_trained_model(classifier, data, experiment.seed) if studies else None,
        is_graph=is_graph_model(classifier.model),
    )


def member_seed(seed: int, member: int) -> int:
    r"""Returns the seed of a member of an average of networks."""
    return seed + _MEMBER_SEED_STEP * member


def _average_outputs(
    outputs: Sequence[Outputs], classifier: TactileModule, scale: "TargetScale | None"
) -> tuple[np.ndarray, np.ndarray]:
    # Returns the mean scores of the members, and the predictions that follow from them.
    if scale is not None:
        logits = torch.stack([member.logits for member in outputs]).mean(dim=0)
        numbers = scale.unscale(logits.view(outputs[0].y.shape)).numpy()
        return numbers, numbers
    probability = torch.stack([member.probability for member in outputs]).mean(dim=0)
    if classifier.task == "multilabel":
        return probability.numpy(), (probability > 0.5).long().numpy()
    predicted = predicted_classes(probability, classifier.decision_threshold)
    return probability.numpy(), predicted.numpy()


def _cross_entropy(outputs: Outputs) -> float:
    return float(F.cross_entropy(outputs.logits, outputs.y))


def _trained_model(classifier: TactileModule, data: TactileDataModule, seed: int) -> Trained:
    model = classifier.model.eval().cpu()
    train, test = (data.peek(part, len(part)) for part in (data.part("train"), data.part("test")))
    assert data.layout is not None  # studies need data with one layout
    return Trained(model, train, test, data.class_names, data.layout, seed)


def fit_classifier(
    model: dict[str, Any],
    data: TactileDataModule,
    seed: int,
    settings: dict[str, Any],
    epochs: int,
    *callbacks: L.Callback,
) -> TactileModule:
    r"""Trains the classifier of a configuration without output, logs or checkpoints.

    Args:
        model (dict): The section :obj:`model` of a configuration.
        data (TactileDataModule): The samples.
        seed (int): Seed of the weights and batches.
        settings (dict): Arguments of :class:`lightning.Trainer`.
        epochs (int): Number of epochs.
        *callbacks (Callback): Callbacks of the training.
    """
    L.seed_everything(seed, verbose=False)
    # A copy is used because jsonargparse changes the configuration.
    classifier = classifier_from_config(copy.deepcopy(model), data)
    with silent_training():
        trainer = _make_trainer(settings, max_epochs=epochs, callbacks=list(callbacks))
        trainer.fit(classifier, datamodule=data)
    return classifier


def _make_trainer(settings: dict[str, Any], **arguments: Any) -> L.Trainer:
    arguments = {**settings, **arguments, "devices": 1}
    # Logging would take a tenth of the training time of small models.
    if set(settings) <= _BAREBONES_SETTINGS:
        return L.Trainer(barebones=True, **arguments)
    output_options = (
        "logger",
        "enable_checkpointing",
        "enable_progress_bar",
        "enable_model_summary",
    )
    return L.Trainer(**{**arguments, **dict.fromkeys(output_options, False)})


@cache
def warm_up(accelerator: str) -> None:
    r"""Trains a tiny model, once per process. The imports of the first training then do not count
    towards the memory or time of a compared model.
    """
    batch = StaticData(x=torch.zeros(2, 1, 2), y=torch.tensor([0, 1]), edge_index=_NO_EDGES)
    classifier = TactileModule(_TinyModel())
    with silent_training():
        trainer = _make_trainer({"accelerator": accelerator}, max_epochs=1)
        batches: Any = [batch]
        trainer.fit(classifier, DataLoader(batches, batch_size=None))


class _TinyModel(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.lin = torch.nn.Linear(2, 2)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        logits: Tensor = self.lin(x).mean(dim=1)
        return logits


class Clock(L.Callback):
    r"""Measures the duration of a training in seconds, as :obj:`seconds`."""

    seconds = math.nan

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        r"""Starts the clock."""
        self._start = time.perf_counter()

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        r"""Stops the clock. On a GPU, waits until all operations are finished."""
        if trainer.strategy.root_device.type == "cuda":
            torch.cuda.synchronize()
        self.seconds = time.perf_counter() - self._start


class TargetScale(BaseTransform):
    r"""Shifts and scales regression targets to mean zero and standard deviation one over the
    training part.

    Args:
        center (torch.Tensor): Mean of each target :math:`(C,)`, or of a single target.
        scale (torch.Tensor): Standard deviation of each target, with the same shape.
    """

    supports_static = True

    def __init__(self, center: Tensor, scale: Tensor) -> None:
        self.center = center
        self.scale = scale

    @classmethod
    def from_samples(cls, train: SampleSet) -> "TargetScale":
        r"""Computes the mean and the standard deviation of a training part."""
        labels = train.column("y")
        assert labels is not None
        y = labels.double()
        scale = y.std(dim=0, correction=0)
        return cls(y.mean(dim=0), torch.where(scale > 0, scale, 1.0))

    def forward(self, data: Data) -> Data:
        r"""Replaces :obj:`y` by scaled targets."""
        y = torch.as_tensor(data.y)  # PyG samples may have a plain number
        data.y = ((y.double() - self.center) / self.scale).float()
        return data

    def unscale(self, y: Tensor) -> Tensor:
        r"""Returns scaled targets in their original unit."""
        return y.double() * self.scale + self.center


class _AddEdges(BaseTransform):
    supports_static = True

    def __init__(self, edge_index: Tensor) -> None:
        self.edge_index = edge_index

    def forward(self, data: Data) -> Data:
        data.edge_index = self.edge_index
        return data


def layout_edges(layout: TaxelLayout) -> Tensor:
    r"""Returns the edges for samples without edges: the adjacency :obj:`"original"` of the layout,
    else its first adjacency, else the six nearest neighbours of each taxel.
    """
    if layout.adjacency:
        names = list(layout.adjacency)
        return layout.edge_index("original" if "original" in names else names[0])
    if layout.num_taxels == 1:
        return torch.zeros(2, 0, dtype=torch.long)
    k = min(_NUM_NEIGHBOURS, layout.num_taxels - 1)
    edges: Tensor = KNNGraph(k)(Data(pos=layout.pos)).edge_index
    return edges


def prepare_part(part: SampleSet, scale: TargetScale | None) -> SampleSet:
    r"""Returns a copy of a part in which samples have edges and targets are scaled."""
    steps: list[BaseTransform] = [] if part.transform is None else [part.transform]
    if isinstance(part, GraphSamples):
        if part.first().edge_index is None:
            steps.append(KNNGraph(min(_NUM_NEIGHBOURS, part.num_taxels[0] - 1)))
    elif part[:1].batch([0]).edge_index is None:
        steps.append(_AddEdges(layout_edges(part.layout)))
    if scale is not None:
        steps.append(scale)
    prepared = copy.copy(part)
    prepared.transform = Compose(steps) if steps else None
    return prepared
