r"""A model with the layout and the transforms that it was trained with."""

from typing import Any, Literal, Self

import torch
from torch import Tensor

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.predictor._window_cut import WindowCut
from torch_geometric_tactile.predictor.content import TASKS, Content
from torch_geometric_tactile.sensors import TaxelLayout

Task = Literal["multiclass", "multilabel", "regression"]

# What gives a sample the attributes that models ask for.
_SOURCES = {
    "edge_index": "give 'adjacency', or add KNNGraph() to the transform",
    "edge_attr": "add GeometricEdgeAttr() to the transform",
    "absolute": "add AbsoluteMorphology() to the transform",
}


class TrainedModel:
    r"""A model in evaluation mode, with the layout and the transforms that it was trained with and
    the names of its classes: from the samples of a data set to probabilities and labels.

    Args:
        parts (Content): What it is made of.

    Raises:
        ValueError: If the task is unknown.
    """

    def __init__(self, parts: Content) -> None:
        if parts.task not in TASKS:
            raise ValueError(f"'task' must be one of {list(TASKS)} (got '{parts.task}')")
        threshold = parts.threshold
        if threshold is not None and (parts.task != "multiclass" or not 0 <= threshold <= 1):
            raise ValueError(
                "'threshold' must be a probability, with task='multiclass' and two classes (got "
                f"{threshold} with task='{parts.task}')"
            )
        self.preparation, self.model, self.class_names, _, self.threshold = parts
        self.task = parts.task
        self.model.eval()
        numbers = [p for p in self.model.parameters() if p.is_floating_point()]
        self._dtype = numbers[0].dtype if numbers else torch.get_default_dtype()
        self._names = tuple(getattr(self.model, "modalities", ()))
        if "joint" in self._names:
            self.preparation.needs_joint = True
        self.to(numbers[0].device if numbers else "cpu")

    @property
    def layout(self) -> TaxelLayout:
        r"""The layout of the sensor."""
        return self.preparation.layout

    @property
    def transform(self) -> Transform | None:
        r"""What the samples of a data set go through, with its fitted state."""
        return self.preparation.transform

    @property
    def read_options(self) -> dict[str, Any]:
        r"""The options of :func:`~torch_geometric_tactile.io.read_recording` that read a file as
        those of the training: the names of the columns, the number of channels, and the like;
        empty if the predictor does not know them.
        """
        return dict(self.preparation.read_options)

    @property
    def window(self) -> WindowCut | None:
        r"""How windows are cut from the frames of a recording; :obj:`None` for single frames."""
        return self.preparation.window

    @property
    def causal(self) -> bool:
        r"""Whether an answer could be given with the last frame of its window: whether no transform
        looks at frames to come. One that needs the whole window first, such as
        :class:`~torch_geometric_tactile.transforms.Resample` of whole trials, says so by its
        attribute :obj:`causal`.
        """
        return self.preparation.causal

    def to(self, device: torch.device | str) -> Self:
        r"""Moves model and preparation to a device.

        Args:
            device (torch.device or str): The device.
        """
        self._device = torch.device(device)
        self.model.to(self._device)
        self.preparation.to(self._device)
        return self

    def prepare_samples(self, data: StaticData) -> StaticData:
        r"""Returns samples of a data set as the model takes them.

        Args:
            data (StaticData): The samples, after the :obj:`pre_transform` of the data set and
                before its :obj:`transform`.
        """
        return self.preparation.prepared_samples(data)

    def logits(self, data: StaticData) -> Tensor:
        r"""Returns what the model makes of prepared data :math:`(B, C)`, with gradients.

        Args:
            data (StaticData): What :meth:`prepare_samples` or :meth:`Predictor.prepare` returned.
        """
        if self.model.training:
            self.model.eval()
        inputs = {name: getattr(data, name, None) for name in self._names}
        lacking = [name for name, value in inputs.items() if value is None]
        if data.edge_index is None and getattr(self.model, "needs_edges", False):
            lacking.insert(0, "edge_index")
        if lacking:
            source = _SOURCES.get(lacking[0], "add a transform that sets it")
            raise ValueError(f"the model needs '{lacking[0]}' (got none): {source}")
        out: Tensor = self.model(data.x, data.edge_index, **inputs)
        return out

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes or labels, or for a regression the numbers.

        Args:
            logits (torch.Tensor): What the model returned :math:`(B, C)`.
        """
        if self.task == "regression":
            return logits
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)

    def names(self, num_outputs: int) -> list[str]:
        r"""Returns the names of the outputs: of the classes or labels, or their numbers.

        Args:
            num_outputs (int): Number of outputs :math:`C`.

        Raises:
            ValueError: If there are names, but not as many.
        """
        if self.class_names and len(self.class_names) != num_outputs:
            raise ValueError(
                f"'class_names' must have {num_outputs} names, as the model has outputs "
                f"(got {len(self.class_names)})"
            )
        return list(self.class_names) or [str(i) for i in range(num_outputs)]

    def labels(self, probability: Tensor) -> list[list[str]]:
        r"""Returns the predicted class of each frame, the most probable one or by the
        :obj:`threshold`, or all its labels with a probability above one half; none for a frame
        whose probabilities are NaN.

        Args:
            probability (torch.Tensor): The probabilities :math:`(C,)` or :math:`(B, C)`.

        Raises:
            ValueError: If :obj:`task` is :obj:`"regression"`, or there is a threshold and are not
                two classes.
        """
        if self.task == "regression":
            raise ValueError("a regression has no labels (task='regression')")
        rows = probability.view(-1, probability.size(-1)).cpu()
        names = self.names(rows.size(1))
        if self.task == "multilabel":
            return [[names[i] for i in (row > 0.5).nonzero().view(-1).tolist()] for row in rows]
        missing = rows.isnan().any(dim=1).tolist()
        best = self._best(rows).tolist() if len(rows) else []
        return [[] if is_nan else [names[i]] for i, is_nan in zip(best, missing, strict=True)]

    def _best(self, rows: Tensor) -> Tensor:
        if self.threshold is None:
            return rows.argmax(dim=1)
        if rows.size(1) != 2:
            raise ValueError(f"'threshold' must be None unless of two classes (got {rows.size(1)})")
        return (rows[:, 1] > self.threshold).long()
