r"""A model with the names and the meaning of its outputs."""

from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import NO_CONTACT, StaticData
from torch_geometric_tactile.nn.models._calls import call_model, input_names
from torch_geometric_tactile.nn.models._inputs import needed_inputs
from torch_geometric_tactile.predictor.measured_score import MeasuredScore

TASKS = ("multiclass", "multilabel", "regression")
Task = Literal["multiclass", "multilabel", "regression"]


class Network:
    r"""A model with its task and the names of its classes. It turns prepared samples into
    probabilities and labels.
    """

    def __init__(
        self,
        model: Module,
        class_names: Sequence[str] = (),
        task: str = "multiclass",
        threshold: float | None = None,
        score: MeasuredScore | None = None,
    ) -> None:
        need(task in TASKS, f"'task' must be one of {list(TASKS)} (got '{task}')")
        if threshold is not None and (task != "multiclass" or not 0 <= threshold <= 1):
            raise ValueError(
                "'threshold' must be a probability, with task='multiclass' and two classes (got "
                f"{threshold} with task='{task}')"
            )
        self.model = model
        self.class_names = tuple(class_names)
        self.task: Task = task  # type: ignore[assignment]
        self.threshold = threshold
        self.score = score
        float_parameters = [p for p in model.parameters() if p.is_floating_point()]
        self.dtype = float_parameters[0].dtype if float_parameters else torch.get_default_dtype()
        self.device = float_parameters[0].device if float_parameters else torch.device("cpu")
        self.modalities: tuple[str, ...] = input_names(model)

    def metadata(self) -> dict[str, Any]:
        r"""Returns the task, class names and threshold as JSON values, for exported models."""
        names = list(self.class_names)
        return {"task": self.task, "class_names": names, "threshold": self.threshold}

    def to(self, device: torch.device | str) -> None:
        r"""Moves the model to a device."""
        self.device = torch.device(device)
        self.model.to(self.device)

    def logits(self, data: StaticData) -> Tensor:
        r"""Returns the output of the model, as :meth:`Predictor.logits`."""
        # Users can access the model, so its mode may have changed since it was built.
        if self.model.training:
            self.model.eval()
        edges = "give 'adjacency', or add KNNGraph() to the transform"
        inputs = needed_inputs(self.model, data, lambda: "got none", edge_index=edges)
        return call_model(self.model, data, inputs)

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns probabilities or numbers, as :meth:`Predictor.probability`."""
        if self.task == "regression":
            return logits
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)

    def names(self, num_outputs: int) -> list[str]:
        r"""Returns the names of the outputs, as :meth:`Predictor.names`."""
        if self.class_names and len(self.class_names) != num_outputs:
            raise ValueError(
                f"'class_names' must have {num_outputs} names, one for each output of the model "
                f"(got {len(self.class_names)})"
            )
        return list(self.class_names) or [str(i) for i in range(num_outputs)]

    def labels(self, probability: Tensor, lacks_contact: Tensor | None = None) -> list[list[str]]:
        r"""Returns the predicted labels of each frame, as :meth:`Predictor.labels`."""
        rows = probability.view(-1, probability.size(-1)).cpu()
        if lacks_contact is not None:
            is_free_rows = lacks_contact.view(-1).tolist()
            need(
                len(is_free_rows) == len(rows),
                f"'lacks_contact' must have {len(rows)} rows",
                len(is_free_rows),
            )
            unlabelled: list[list[str]] = [[]] * len(rows)
            labels = unlabelled if self.task == "regression" else self.labels(rows)
            return [
                [NO_CONTACT] if is_free else row
                for is_free, row in zip(is_free_rows, labels, strict=True)
            ]
        need(self.task != "regression", "a regression has no labels (task='regression')")
        names = self.names(rows.size(1))
        if self.task == "multilabel":
            return [[names[i] for i in (row > 0.5).nonzero().view(-1).tolist()] for row in rows]
        missing = rows.isnan().any(dim=1).tolist()
        predicted = self._predict_classes(rows).tolist() if len(rows) else []
        return [[] if is_nan else [names[i]] for i, is_nan in zip(predicted, missing, strict=True)]

    def _predict_classes(self, rows: Tensor) -> Tensor:
        if self.threshold is None:
            return rows.argmax(dim=1)
        if rows.size(1) != 2:
            raise ValueError(
                f"'threshold' must be None unless there are two classes (got {rows.size(1)})"
            )
        return (rows[:, 1] > self.threshold).long()
