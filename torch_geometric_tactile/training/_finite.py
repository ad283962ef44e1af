r"""Checks for NaN and infinite numbers before they reach the weights or a metric."""

import copy
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import lightning as L
import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn.models import TactileModel
from torch_geometric_tactile.nn.models._calls import input_names
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.transforms._samples import Samples

_MAX_LISTED = 5  # number of samples and trials that a message names
_MAX_FULL_CHECK_BYTES = 2**30  # reading larger parts completely would delay the start of training
_NUM_PROBE_SAMPLES = 64  # evenly spaced samples of a larger part


def model_inputs(model: Any) -> tuple[str, ...]:
    r"""Returns the names of the attributes that a model reads."""
    reads_x = "tactile" in model.inputs if isinstance(model, TactileModel) else True
    return (*(("x",) if reads_x else ()), *input_names(model))


def check_part(model: Any, data: TactileDataModule, part: SampleSet, name: str) -> None:
    r"""Checks that the inputs of a model are finite after all transforms except random transforms.
    If a part is larger than 1 GB, only 64 of its samples are checked.

    A sample is transformed for this check only if it contains a NaN or infinite number before the
    transforms.
    """
    candidates = _nonfinite_samples(part)
    nonfinite: dict[str, list[tuple[Tensor, Tensor]]] = {}
    for rows in candidates.split(_NUM_PROBE_SAMPLES) if len(candidates) else ():
        batch = data.peek(part, rows)
        for key in model_inputs(model):
            value = getattr(batch, key, None)
            if value is not None and not _is_finite(value):
                mask = _nonfinite_mask(batch, key)
                assert mask is not None
                nonfinite.setdefault(key, []).append((rows[mask], value[~value.isfinite()]))
    for key, chunks in nonfinite.items():
        index = torch.cat([rows for rows, _ in chunks])
        values = torch.cat([value for _, value in chunks])
        samples = _format_samples(index.tolist(), _trial_numbers(part.column("trial"), index))
        raise _nonfinite_error(key, f"the {name} part", values, samples)


def _nonfinite_samples(part: SampleSet) -> Tensor:
    if isinstance(part, GraphSamples):
        return _nonfinite_graphs(part)
    samples = Samples(part)
    if samples.num_samples == 0:
        return torch.empty(0, dtype=torch.long)
    index = torch.arange(samples.num_samples)
    first = samples.first
    floats = [
        key
        for key, value in first.to_dict().items()
        if isinstance(value, Tensor) and value.is_floating_point() and key != "y"
    ]
    sample_keys = [key for key in floats if not samples.is_shared(key)]
    if not all(_is_finite(first[key]) for key in floats if key not in sample_keys):
        return index  # an attribute shared by all samples
    size = sum(first[key].numel() * first[key].element_size() for key in sample_keys)
    if size * len(index) > _MAX_FULL_CHECK_BYTES:
        index = torch.linspace(0, len(index) - 1, _NUM_PROBE_SAMPLES).long().unique()
    nonfinite = [torch.empty(0, dtype=torch.long)]
    for rows in samples.parts(index):
        chunk = samples.select(rows)
        if all(_is_finite(chunk[key]) for key in sample_keys):
            continue
        finite = torch.ones(len(rows), dtype=torch.bool)
        for key in sample_keys:
            finite &= chunk[key].isfinite().view(len(rows), -1).all(dim=1).cpu()
        nonfinite.append(rows[~finite])
    return torch.cat(nonfinite)


def _nonfinite_graphs(part: GraphSamples) -> Tensor:
    untransformed = copy.copy(part)
    untransformed.transform = None
    nonfinite = []
    for i in range(len(untransformed)):
        values = [value for key, value in untransformed[i].to_dict().items() if key != "y"]
        floats = (v for v in values if isinstance(v, Tensor) and v.is_floating_point())
        if not all(map(_is_finite, floats)):
            nonfinite.append(i)
    return torch.tensor(nonfinite, dtype=torch.long)


@dataclass(frozen=True)
class BatchCheck:
    r"""Checks that the inputs, loss and predictions of a batch are finite."""

    model: Any
    batch: Data
    name: str
    loader: Any = None

    @classmethod
    def from_step(cls, module: L.LightningModule, stage: str, batch: Data, batch_idx: int) -> Self:
        r"""Returns the check of a batch in a step of the trainer."""
        trainer = module._trainer
        if trainer is None:
            return cls(module.model, batch, f"batch {batch_idx}")
        loader_name = "train_dataloader" if stage == "train" else f"{stage}_dataloaders"
        epoch = f" of epoch {trainer.current_epoch}" if stage in ("train", "val") else ""
        part = "test" if stage == "predict" else stage
        name = f"batch {batch_idx}{epoch} of the {part} part"
        return cls(module.model, batch, name, getattr(trainer, loader_name))

    def inputs(self) -> None:
        r"""Checks the attributes of the batch that the model reads."""
        for key in model_inputs(self.model):
            value = getattr(self.batch, key, None)
            if isinstance(value, Tensor) and not _is_finite(value):
                samples = self._format_samples(_nonfinite_mask(self.batch, key))
                raise _nonfinite_error(key, self.name, value[~value.isfinite()], samples)

    def loss(self, loss: Tensor, out: Tensor) -> None:
        r"""Checks a loss before it reaches the weights.

        Shapes:
            - **out:** Outputs of the model :math:`(B, C)`.
        """
        if loss.isfinite():
            return
        self.inputs()
        mask = ~out.isfinite().flatten(1).all(dim=1)
        raise ValueError(
            f"the loss of {self.name} must be finite (got {loss.item()} from "
            f"{self._format_samples(mask if mask.any() else None)}); "
            f"{_cause(self.model, bool(mask.any()))}"
        )

    def scores(self, score: Tensor) -> None:
        r"""Checks that no probability or predicted number is NaN, which a metric would count as a
        class.

        Shapes:
            - **score:** Probabilities or predicted numbers :math:`(B, C)`.
        """
        is_nan = score.isnan()
        if not is_nan.any():
            return
        self.inputs()
        raise ValueError(
            f"the predictions of {self.name} must not be NaN (got NaN for "
            f"{self._format_samples(is_nan.flatten(1).any(dim=1))}); {_cause(self.model, True)}"
        )

    def warn(self, score: Tensor) -> None:
        r"""Warns if probabilities or predicted numbers are NaN.

        Shapes:
            - **score:** Probabilities or predicted numbers :math:`(B, C)`.
        """
        try:
            self.scores(score)
        except ValueError as error:
            warnings.warn(f"some predictions are NaN: {error}", stacklevel=2)

    def _format_samples(self, mask: Tensor | None) -> str:
        num_samples = getattr(self.batch, "num_graphs", 1)
        rows = torch.arange(num_samples) if mask is None else mask.nonzero().view(-1).cpu()
        trials = _trial_numbers(getattr(self.batch, "trial", None), rows)
        dataset_index = self._dataset_index()
        if len(dataset_index) == num_samples:
            return _format_samples([dataset_index[i] for i in rows.tolist()], trials)
        return f"{_format_samples(rows.tolist(), trials)}, counted in the batch"

    def _dataset_index(self) -> list[int]:
        loader = self.loader
        if isinstance(loader, list | tuple) and len(loader) == 1:
            loader = loader[0]
        return loader.last_index if isinstance(loader, StaticLoader) else []


def _is_finite(value: Tensor) -> bool:
    # The sum is much faster, but it may overflow even if all values are finite. In that case, all
    # values are checked.
    return bool(value.sum().isfinite()) or bool(value.isfinite().all())


def _nonfinite_mask(batch: Data, key: str) -> Tensor | None:
    value = batch[key]
    if isinstance(batch, StaticData):
        if not batch.is_shared(key):
            return ~value.isfinite().flatten(1).all(dim=1)
        return torch.ones(batch.num_samples, dtype=torch.bool)
    sample_of_node = getattr(batch, "batch", None)
    rows = ~value.isfinite().flatten(1).all(dim=1)
    if sample_of_node is not None and key.startswith("edge_") and len(rows) == batch.num_edges:
        sample_of_node = sample_of_node[batch.edge_index[0]]
    if sample_of_node is None or len(rows) != len(
        sample_of_node
    ):  # one row for each edge or sample
        return rows if len(rows) == getattr(batch, "num_graphs", None) else None
    mask = torch.zeros(batch.num_graphs, dtype=torch.bool, device=rows.device)
    mask[sample_of_node[rows]] = True
    return mask


def _format_samples(index: Sequence[int], trials: Sequence[int]) -> str:
    text = f"{len(index)} sample{'s' * (len(index) != 1)}: {short_list(index, _MAX_LISTED)}"
    return f"{text} of trial {short_list(trials, _MAX_LISTED)}" if trials else text


def _trial_numbers(trial: Tensor | None, rows: Tensor) -> list[int]:
    if trial is None or trial.dim() != 1 or not len(rows) or len(trial) <= int(rows.max()):
        return []
    numbers: list[int] = trial.cpu()[rows].unique().tolist()
    return numbers


def _nonfinite_error(key: str, part: str, values: Tensor, samples: str) -> ValueError:
    num_missing = int(values.isnan().sum())
    num_infinite = len(values) - num_missing
    counts = [f"{num_missing} NaN"] * (num_missing > 0) + [f"{num_infinite} infinite"] * (
        num_infinite > 0
    )
    attribute = "readings 'x'" if key == "x" else f"'{key}'"
    if not num_missing:
        advice = "correct the data, or leave these samples out"
    elif key == "x":
        advice = "add FillMissing() to the transform, after all steps that may give NaN"
    else:
        advice = (
            f"FillMissing() fills only readings: fill '{key}' in the data, or leave these samples "
            "out"
        )
    return ValueError(
        f"{attribute} of {part} must be finite after all transforms (got {' and '.join(counts)} in "
        f"{samples}); {advice}"
    )


def _cause(model: Any, outputs_nonfinite: bool) -> str:
    for name, value in model.state_dict().items():
        if value.is_floating_point() and not _is_finite(value):
            return (
                f"an earlier step has made the weights '{name}' non-finite: lower the learning "
                "rate, or set the trainer's 'gradient_clip_val'"
            )
    if outputs_nonfinite:
        return (
            "inputs and weights are finite, so the model itself produces it from large or special "
            "values"
        )
    return "inputs, weights and outputs are finite: check 'y' and 'class_weights'"
