r"""What a model said of the samples that were held out."""

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import torch
from sklearn.metrics import roc_auc_score

from torch_geometric_tactile.training._collected_metrics import macro_f1, positive_scores


@dataclass(frozen=True, eq=False)
class Predictions:
    r"""What a model said of :math:`S` samples, and what they are.

    Shapes:
        - **score:** Probabilities of :math:`C` classes or labels :math:`(S, C)`; or one
          number a sample :math:`(S,)`, higher where class 1 of two is expected.
        - **prediction:** The predicted class :math:`(S,)`, or 0 and 1 for each label
          :math:`(S, C)`.
        - **y:** The classes :math:`(S,)` or labels :math:`(S, C)`.
        - **session:** The recording session of each sample :math:`(S,)`.
        - **trial:** The trial of each sample :math:`(S,)`.
        - **index:** The place of each sample in its data set :math:`(S,)`; the
          same ones in all predictions that are compared, if left out.
    """

    score: np.ndarray
    prediction: np.ndarray
    y: np.ndarray
    session: np.ndarray | None = None
    trial: np.ndarray | None = None
    index: np.ndarray | None = None

    def select(self, mask: np.ndarray) -> Self:
        r"""Returns the predictions of some of the samples.

        Shapes:
            - **mask:** Which ones :math:`(S,)`.
        """
        return type(self)(**{name: value[mask] for name, value in self._arrays().items()})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        r"""Returns several predictions as one, such as the folds of a data set."""
        arrays = [part._arrays() for part in parts]
        return cls(**{name: np.concatenate([part[name] for part in arrays]) for name in arrays[0]})

    def metrics(self) -> dict[str, float]:
        r"""Returns :obj:`accuracy`, :obj:`f1` and :obj:`auroc` as
        :func:`~torch_geometric_tactile.training.classification_metrics` defines them, for labels
        also :obj:`label_accuracy`, and for two classes :obj:`f1_positive`,
        :obj:`precision_positive` and :obj:`recall_positive`, the F1 score, precision and recall of
        class 1 (0 where there is nothing to divide by).
        """
        if self.y.ndim == 2:
            num_classes = self.y.shape[1]
            positive, predicted = self.y > 0.5, self.prediction > 0.5
        else:
            num_classes = 2 if self.score.ndim == 1 else self.score.shape[1]
            classes = np.arange(num_classes)
            positive = self.y[:, None] == classes
            predicted = self.prediction[:, None] == classes
        right = positive == predicted
        values = {"accuracy": float(right.all(axis=1).mean())}
        if self.y.ndim == 2:
            values["label_accuracy"] = float(right.mean())
            values |= {f"label_accuracy_{i}": float(right[:, i].mean()) for i in range(num_classes)}
        counts = [
            torch.from_numpy(found.sum(axis=0)).double()
            for found in (positive & predicted, ~positive & predicted, positive & ~predicted)
        ]
        values["f1"] = float(macro_f1(*counts))
        if self.y.ndim == 1 and num_classes == 2:
            values |= {name: float(value) for name, value in positive_scores(*counts).items()}
        values["auroc"] = self._auroc(positive)
        return values

    def _auroc(self, positive: np.ndarray) -> float:
        score = self.score if self.score.ndim == 2 else np.stack([-self.score, self.score], axis=1)
        mixed = positive.any(axis=0) & ~positive.all(axis=0)
        if not mixed.any() or np.isnan(score).any():
            return float("nan")
        areas = [roc_auc_score(positive[:, i], score[:, i]) for i in np.flatnonzero(mixed)]
        return float(np.mean(areas))

    def to_dict(self) -> dict[str, Any]:
        r"""Returns it as JSON values: the bits of the arrays, compressed."""
        return {
            name: {
                "dtype": str(value.dtype),
                "shape": list(value.shape),
                "zlib": base64.b64encode(zlib.compress(value.tobytes())).decode("ascii"),
            }
            for name, value in self._arrays().items()
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds predictions from what :meth:`to_dict` returns."""
        return cls(
            **{
                name: np.frombuffer(
                    zlib.decompress(base64.b64decode(value["zlib"])), np.dtype(value["dtype"])
                ).reshape(value["shape"])
                for name, value in content.items()
            }
        )

    def _arrays(self) -> dict[str, np.ndarray]:
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: np.ascontiguousarray(v) for name, v in values.items() if v is not None}
