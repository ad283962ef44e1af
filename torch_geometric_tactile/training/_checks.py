r"""Checks of the data and the model before training starts."""

import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.nn.norm import (
    BatchNorm,
    GraphNorm,
    GraphSizeNorm,
    LayerNorm,
    MeanSubtractionNorm,
    PairNorm,
)

from torch_geometric_tactile.data._graph_samples import GraphSamples
from torch_geometric_tactile.loader._random_states import preserve_random_states
from torch_geometric_tactile.nn.models._calls import takes_batch
from torch_geometric_tactile.training._collected_metrics import Task
from torch_geometric_tactile.training._finite import check_part
from torch_geometric_tactile.training._losses import balanced_weights
from torch_geometric_tactile.training.data_module import TactileDataModule

# PyG's normalisation layers that silently compute wrong numbers for stacked samples (B, N, F).
_MIXING_NORMS = (BatchNorm, GraphNorm, GraphSizeNorm, LayerNorm, MeanSubtractionNorm, PairNorm)
# Advice for samples without edges.
EDGE_SOURCE = (
    "give the data set pre_transform=KNNGraph(k=2), or the edges of an adjacency of its layout"
)


def num_outputs(data: TactileDataModule, task: Task) -> int:
    r"""Returns the number of classes, labels or targets of the data, or 0 if there are none."""
    y = data.dataset.column("y")
    if y is None:
        return 0
    if task == "multiclass":
        return data.num_classes
    return y.size(1) if y.dim() == 2 else 1


def train_weights(data: TactileDataModule | None, task: Task, num_classes: int) -> Tensor:
    r"""Returns the :func:`~torch_geometric_tactile.training._losses.balanced_weights` of the
    training part.

    Shapes:
        - **num_classes:** Number of classes or labels :math:`C`.
    """
    y = None if data is None else data.part("train").column("y")
    if y is None:
        raise ValueError(
            "'class_weights' must be numbers without a TactileDataModule that has labels "
            "(got 'balanced')"
        )
    return balanced_weights(y, task, num_classes)


def check_labels(y: Tensor, task: Task, name: str, num_classes: int = 0) -> None:
    r"""Checks the shape, type and range of the labels of a task.

    Shapes:
        - **y:** Labels of all samples :math:`(S,)` or :math:`(S, C)`.
        - **num_classes:** Number of classes, labels or targets :math:`C`; 0 if unknown.
    """
    {"multiclass": _check_classes, "multilabel": _check_flags}.get(task, _check_targets)(y, name)
    if not num_classes or not len(y):
        return
    if task == "multiclass":
        if int(y.max()) >= num_classes:
            raise ValueError(
                f"'y' of '{name}' must be classes from 0 to {num_classes - 1} (got {int(y.max())})"
            )
    elif y.view(len(y), -1).size(1) != num_classes:
        raise ValueError(
            f"'y' of '{name}' must have {num_classes} numbers per sample, one for each output of "
            f"the model (got {y.view(len(y), -1).size(1)})"
        )


def _check_classes(y: Tensor, name: str) -> None:
    if y.dim() != 1:
        raise ValueError(
            f"'y' of '{name}' must have shape (S,) for task='multiclass' (got {tuple(y.shape)}); "
            "is it task='multilabel'?"
        )
    if y.is_floating_point() or y.dtype == torch.bool:
        raise ValueError(
            f"'y' of '{name}' must be integers for task='multiclass' (got {y.dtype}); convert "
            "classes with y.long(), or is it task='regression'?"
        )
    if len(y) and int(y.min()) < 0:
        raise ValueError(
            f"'y' of '{name}' must be classes from 0 (got {int(y.min())}); leave out samples "
            "without a class"
        )


def _check_flags(y: Tensor, name: str) -> None:
    if y.dim() != 2:
        raise ValueError(
            f"'y' of '{name}' must have shape (S, C) for task='multilabel' (got "
            f"{tuple(y.shape)}); is it task='multiclass'?"
        )
    if not ((y == 0) | (y == 1)).all():
        raise ValueError(
            f"'y' of '{name}' must be 0 or 1 for task='multilabel' (got {y.min().item()} to "
            f"{y.max().item()}); is it task='regression'?"
        )


def _check_targets(y: Tensor, name: str) -> None:
    if y.dim() not in (1, 2):
        raise ValueError(
            f"'y' of '{name}' must have shape (S,) or (S, C) for task='regression' (got "
            f"{tuple(y.shape)})"
        )
    if not y.is_floating_point():
        raise ValueError(
            f"'y' of '{name}' must be floating-point numbers for task='regression' (got "
            f"{y.dtype}); convert it with y.float(), or is it task='multiclass'?"
        )
    if not y.isfinite().all():
        raise ValueError(f"'y' of '{name}' must be finite (got NaN or infinity)")


def check_data(module: Any, data: TactileDataModule, stage: str) -> None:
    r"""Checks the labels and the model inputs of the parts that a stage uses, and runs the model
    once on two samples. This needs no gradients and does not advance the random number generators.
    """
    names = {"fit": ("train", "val"), "validate": ("val",)}.get(stage, ("test",))
    parts = {name: part for name in names if len(part := data.part(name))}  # type: ignore[arg-type]
    if stage == "fit" and "train" not in parts:
        raise ValueError("the training part must contain samples (got none): check 'split'")
    check_takes_batch(module.model, data)
    for name, part in parts.items():
        if stage == "predict":
            break
        y = part.column("y")
        if y is None:
            raise ValueError(
                f"the {name} part must have labels 'y' (got none); return them in the data set's "
                "read()"
            )
        check_labels(y, module.task, name, module.num_classes)
        if name == "train":
            _warn_of_missing_classes(y, module.task, module.num_classes, data.class_names)
    for name, part in parts.items() if stage != "predict" else ():
        check_part(module.model, data, part, name)
    for part in list(parts.values())[:1]:
        _check_outputs(module, data.peek(part, 2))


def check_takes_batch(model: Any, data: TactileDataModule) -> None:
    r"""Checks that the model accepts :obj:`batch` if samples differ in their taxels."""
    samples = data.dataset
    if isinstance(samples, GraphSamples) and samples.is_mixed and not takes_batch(model):
        name = model.__name__ if isinstance(model, type) else type(model).__name__
        raise ValueError(
            f"'model' must accept the sample index of each taxel, forward(x, edge_index, batch), "
            f"because the samples have {samples.describe_taxels()} (got {name}, without 'batch')"
        )


def check_has_threshold(module: Any, data: Any, stage: str) -> None:
    r"""Checks that there are two classes, and a validation part to select the threshold on."""
    if module.num_classes != 2:
        raise ValueError(
            f"'threshold' must be left out unless there are 2 classes (got {module.num_classes})"
        )
    is_chosen = stage == "fit" and isinstance(module.threshold, str)
    if is_chosen and isinstance(data, TactileDataModule) and not len(data.part("val")):
        raise ValueError(
            f"'threshold' must be a number without a validation part to select it on (got "
            f"'{module.threshold}'); give a 'val' above 0, or a 'val_dataset'"
        )


def _warn_of_missing_classes(
    y: Tensor, task: Task, num_classes: int, class_names: Sequence[str]
) -> None:
    if task == "multiclass":
        missing = (torch.bincount(y, minlength=num_classes) == 0).nonzero().view(-1).tolist()
        problem = "no sample of class"
    elif task == "multilabel":
        missing = (y == y[:1]).all(dim=0).nonzero().view(-1).tolist()
        problem = "only one value of label"
    else:
        return
    if missing:
        missing_names = ", ".join(
            f"'{class_names[i]}'" if i < len(class_names) else str(i) for i in missing
        )
        warnings.warn(
            f"the training part has {problem} {missing_names}, which cannot be learnt; use another "
            "'split' or 'seed'",
            stacklevel=3,
        )


def _check_outputs(module: Any, batch: Data) -> None:
    training_modes = [(part, part.training) for part in module.modules()]
    module.eval()
    hooks = [
        part.register_forward_pre_hook(partial(_warn_of_mixed_samples, name))
        for name, part in module.named_modules()
        if isinstance(part, _MIXING_NORMS) and getattr(part, "mode", "graph") == "graph"
    ]
    try:
        with torch.no_grad(), preserve_random_states():
            # Lightning sets the device of the module before it moves the weights there.
            batch = batch.to(next(module.parameters(), torch.empty(0)).device)
            module.inputs(batch)  # raises errors that name missing attributes
            out = _run_model(module, batch)
    finally:
        for hook in hooks:
            hook.remove()
        for part, training in training_modes:  # not module.train(): some parts may be frozen
            part.training = training
    expected = (getattr(batch, "num_graphs", 1), module.num_classes)
    if tuple(out.shape) != expected:
        kind = {"multiclass": "class", "multilabel": "label"}.get(module.task, "target")
        raise ValueError(
            f"the model must return shape {expected} for {expected[0]} samples, one output for "
            f"each {kind} (got {tuple(out.shape)}); set its 'out_channels', or leave it out of the "
            "configuration to derive it from the data"
        )


def _warn_of_mixed_samples(name: str, norm: Any, inputs: tuple[Any, ...]) -> None:
    if inputs and isinstance(inputs[0], Tensor) and inputs[0].dim() == 3:
        warnings.warn(
            f"'{name}', PyG's {type(norm).__name__}, treats all samples of a batch (B, N, F) as "
            "one graph, so that predictions depend on the other samples; use "
            "LayerNorm(mode='node') or an alternative in docs/static_data.md",
            stacklevel=2,
        )


def _run_model(module: Any, batch: Data) -> Tensor:
    try:
        out: Tensor = module(batch)
    except Exception as error:
        if batch.edge_index is not None:
            raise
        raise ValueError(
            f"the model cannot be run without 'edge_index' ({type(error).__name__}: {error}): "
            f"{EDGE_SOURCE}"
        ) from error
    return out
