r"""Numbers that are missing or infinite: found before they reach the weights or a metric."""

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

_LISTED = 5  # samples and trials that a message names
_LOOKED_AT = 2**30  # bytes of a part up to which all samples are looked at before a training
_SPREAD = 64  # samples of a larger one


def model_inputs(model: Any) -> tuple[str, ...]:
    r"""Returns the names of the attributes that a model reads."""
    reads_x = "tactile" in model.inputs if isinstance(model, TactileModel) else True
    return (*(("x",) if reads_x else ()), *input_names(model))


def check_part(model: Any, data: TactileDataModule, part: SampleSet, name: str) -> None:
    r"""Checks that what a model reads of a part is finite after all transforms but random ones. Of
    a part above 1 GB only some samples are looked at.

    Only samples with a number that is missing before the transforms are read again after them.
    """
    suspects = _suspects(part)
    bad: dict[str, list[tuple[Tensor, Tensor]]] = {}
    for rows in suspects.split(_SPREAD) if len(suspects) else ():
        batch = data.peek(part, rows)
        for key in model_inputs(model):
            value = getattr(batch, key, None)
            if value is not None and not _is_finite(value):
                of_samples = _bad_samples(batch, key)
                assert of_samples is not None
                bad.setdefault(key, []).append((rows[of_samples], value[~value.isfinite()]))
    for key, found in bad.items():
        index = torch.cat([rows for rows, _ in found])
        values = torch.cat([value for _, value in found])
        samples = _samples(index.tolist(), _trials(part.column("trial"), index))
        raise _not_finite(key, f"the {name} part", values, samples)


def _suspects(part: SampleSet) -> Tensor:
    if isinstance(part, GraphSamples):
        return _suspect_graphs(part)
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
    own = [key for key in floats if not samples.is_shared(key)]
    if not all(_is_finite(first[key]) for key in floats if key not in own):
        return index
    size = sum(first[key].numel() * first[key].element_size() for key in own)
    if size * len(index) > _LOOKED_AT:
        index = torch.linspace(0, len(index) - 1, _SPREAD).long().unique()
    bad = [torch.empty(0, dtype=torch.long)]
    for rows in samples.parts(index):
        chunk = samples.select(rows)
        if all(_is_finite(chunk[key]) for key in own):
            continue
        finite = torch.ones(len(rows), dtype=torch.bool)
        for key in own:
            finite &= chunk[key].isfinite().view(len(rows), -1).all(dim=1).cpu()
        bad.append(rows[~finite])
    return torch.cat(bad)


def _suspect_graphs(part: GraphSamples) -> Tensor:
    raw = copy.copy(part)
    raw.transform = None
    bad = []
    for i in range(len(raw)):
        values = [value for key, value in raw[i].to_dict().items() if key != "y"]
        floats = (v for v in values if isinstance(v, Tensor) and v.is_floating_point())
        if not all(map(_is_finite, floats)):
            bad.append(i)
    return torch.tensor(bad, dtype=torch.long)


@dataclass(frozen=True)
class BatchCheck:
    r"""What must be finite of a batch."""

    model: Any
    batch: Data
    name: str
    loader: Any = None

    @classmethod
    def of_step(cls, module: L.LightningModule, stage: str, batch: Data, batch_idx: int) -> Self:
        r"""Returns the check of a batch of a trainer."""
        trainer = module._trainer
        if trainer is None:
            return cls(module.model, batch, f"batch {batch_idx}")
        name = "train_dataloader" if stage == "train" else f"{stage}_dataloaders"
        epoch = f" of epoch {trainer.current_epoch}" if stage in ("train", "val") else ""
        part = "test" if stage == "predict" else stage
        text = f"batch {batch_idx}{epoch} of the {part} part"
        return cls(module.model, batch, text, getattr(trainer, name))

    def inputs(self) -> None:
        r"""Checks what the model reads."""
        for key in model_inputs(self.model):
            value = getattr(self.batch, key, None)
            if isinstance(value, Tensor) and not _is_finite(value):
                samples = self._samples(_bad_samples(self.batch, key))
                raise _not_finite(key, self.name, value[~value.isfinite()], samples)

    def loss(self, loss: Tensor, out: Tensor) -> None:
        r"""Checks a loss, before it reaches the weights.

        Shapes:
            - **out:** What the model returned :math:`(B, C)`.
        """
        if loss.isfinite():
            return
        self.inputs()
        bad = ~out.isfinite().flatten(1).all(dim=1)
        raise ValueError(
            f"the loss of {self.name} must be finite (got {loss.item()} from "
            f"{self._samples(bad if bad.any() else None)}); {_cause(self.model, bool(bad.any()))}"
        )

    def scores(self, score: Tensor) -> None:
        r"""Checks probabilities or predicted numbers, of which a metric would count NaN as a class.

        Shapes:
            - **score:** They :math:`(B, C)`.
        """
        bad = score.isnan()
        if not bad.any():
            return
        self.inputs()
        raise ValueError(
            f"the predictions of {self.name} must not be NaN (got NaN for "
            f"{self._samples(bad.flatten(1).any(dim=1))}); {_cause(self.model, True)}"
        )

    def warn(self, score: Tensor) -> None:
        r"""Warns of probabilities or predicted numbers that are NaN.

        Shapes:
            - **score:** They :math:`(B, C)`.
        """
        try:
            self.scores(score)
        except ValueError as error:
            warnings.warn(f"some predictions are NaN: {error}", stacklevel=2)

    def _samples(self, bad: Tensor | None) -> str:
        number = getattr(self.batch, "num_graphs", 1)
        rows = torch.arange(number) if bad is None else bad.nonzero().view(-1).cpu()
        trials = _trials(getattr(self.batch, "trial", None), rows)
        index = self._index()
        if len(index) == number:
            return _samples([index[i] for i in rows.tolist()], trials)
        return f"{_samples(rows.tolist(), trials)}, counted in the batch"

    def _index(self) -> list[int]:
        loader = self.loader
        if isinstance(loader, list | tuple) and len(loader) == 1:
            loader = loader[0]
        return loader.last_index if isinstance(loader, StaticLoader) else []


def _is_finite(value: Tensor) -> bool:
    # A sum is much faster, and wrong only where it overflows.
    return bool(value.sum().isfinite()) or bool(value.isfinite().all())


def _bad_samples(batch: Data, key: str) -> Tensor | None:
    value = batch[key]
    if isinstance(batch, StaticData):
        if not batch.is_shared(key):
            return ~value.isfinite().flatten(1).all(dim=1)
        return torch.ones(batch.num_samples, dtype=torch.bool)
    of = getattr(batch, "batch", None)
    rows = ~value.isfinite().flatten(1).all(dim=1)
    if of is not None and key.startswith("edge_") and len(rows) == batch.num_edges:
        of = of[batch.edge_index[0]]
    if of is None or len(rows) != len(of):  # of edges, or of the samples themselves
        return rows if len(rows) == getattr(batch, "num_graphs", None) else None
    bad = torch.zeros(batch.num_graphs, dtype=torch.bool, device=rows.device)
    bad[of[rows]] = True
    return bad


def _samples(index: Sequence[int], trials: Sequence[int]) -> str:
    text = f"{len(index)} sample{'s' * (len(index) != 1)}: {short_list(index, _LISTED)}"
    return f"{text} of trial {short_list(trials, _LISTED)}" if trials else text


def _trials(trial: Tensor | None, rows: Tensor) -> list[int]:
    if trial is None or trial.dim() != 1 or not len(rows) or len(trial) <= int(rows.max()):
        return []
    listed: list[int] = trial.cpu()[rows].unique().tolist()
    return listed


def _not_finite(key: str, where: str, values: Tensor, samples: str) -> ValueError:
    missing = int(values.isnan().sum())
    infinite = len(values) - missing
    counts = [f"{missing} NaN"] * (missing > 0) + [f"{infinite} infinite"] * (infinite > 0)
    what = "readings 'x'" if key == "x" else f"'{key}'"
    if not missing:
        advice = "correct them in the data, or leave these samples out"
    elif key == "x":
        advice = "add FillMissing() to the transform, behind all that can give NaN"
    else:
        advice = (
            f"FillMissing() fills readings only: fill '{key}' in the data, or leave these samples "
            "out"
        )
    return ValueError(
        f"{what} of {where} must be finite after all transforms (got {' and '.join(counts)} in "
        f"{samples}); {advice}"
    )


def _cause(model: Any, of_model: bool) -> str:
    for name, value in model.state_dict().items():
        if value.is_floating_point() and not _is_finite(value):
            return (
                f"the weights '{name}' are not finite since an earlier step: lower the learning "
                "rate, or set the trainer's 'gradient_clip_val'"
            )
    if of_model:
        return "inputs and weights are finite: the model makes it of large or special values"
    return "inputs, weights and outputs are finite: look at 'y' and 'class_weights'"
