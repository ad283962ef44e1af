r"""Predictions of a model for held-out samples."""

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from sklearn.metrics import accuracy_score, precision_recall_fscore_support, roc_auc_score


@dataclass(frozen=True, eq=False)
class Predictions:
    r"""Predictions for :math:`S` samples with their true values.

    Shapes:
        - **score:** Probabilities of :math:`C` classes or labels :math:`(S, C)`; or one number per
          sample :math:`(S,)`, which is higher if class 1 of two is expected.
        - **prediction:** The predicted class :math:`(S,)`, or 0 or 1 for each label
          :math:`(S, C)`.
        - **y:** The classes :math:`(S,)` or labels :math:`(S, C)`.
        - **session:** The recording session of each sample :math:`(S,)`.
        - **trial:** The trial of each sample :math:`(S,)`.
        - **index:** The index of each sample in its data set :math:`(S,)`. If left out, all
          compared predictions must be for the same samples.
    """

    score: np.ndarray
    prediction: np.ndarray
    y: np.ndarray
    session: np.ndarray | None = None
    trial: np.ndarray | None = None
    index: np.ndarray | None = None

    def select(self, mask: np.ndarray) -> Self:
        r"""Returns the predictions for selected samples.

        Shapes:
            - **mask:** True for the selected samples :math:`(S,)`.
        """
        return type(self)(**{name: value[mask] for name, value in self._arrays().items()})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        r"""Joins predictions for different samples, such as the folds of a data set."""
        arrays = [part._arrays() for part in parts]
        return cls(**{name: np.concatenate([part[name] for part in arrays]) for name in arrays[0]})

    def metrics(self) -> dict[str, float]:
        r"""Returns :obj:`accuracy`, :obj:`f1` and :obj:`auroc` as defined by
        :func:`~torch_geometric_tactile.training.classification_metrics`. Labels also have
        :obj:`label_accuracy`. Two classes also have :obj:`f1_positive`, :obj:`precision_positive`
        and :obj:`recall_positive`: the F1 score, precision and recall of class 1 (0 instead of a
        division by zero).
        """
        if self.y.ndim == 2:
            y, prediction = (self.y > 0.5).astype(int), (self.prediction > 0.5).astype(int)
            is_correct = y == prediction
            num_classes = y.shape[1]
            values = {
                "accuracy": float(accuracy_score(y, prediction)),
                "label_accuracy": float(is_correct.mean()),
            }
            for i in range(num_classes):
                values[f"label_accuracy_{i}"] = float(is_correct[:, i].mean())
        else:
            y, prediction = self.y, self.prediction
            num_classes = 2 if self.score.ndim == 1 else self.score.shape[1]
            values = {"accuracy": float(accuracy_score(y, prediction))}
        # Classes that are neither present nor predicted score NaN, and do not enter the mean.
        precision, recall, f1, _ = precision_recall_fscore_support(
            y, prediction, labels=np.arange(num_classes), zero_division=np.nan
        )
        is_present = ~np.isnan(f1)
        values["f1"] = float(f1[is_present].mean()) if is_present.any() else math.nan
        if self.y.ndim == 1 and num_classes == 2:
            for name, score in (("f1", f1), ("precision", precision), ("recall", recall)):
                values[f"{name}_positive"] = float(np.nan_to_num(score[1]))
        values["auroc"] = self._auroc(y if y.ndim == 2 else y[:, None] == np.arange(num_classes))
        return values

    def _auroc(self, positive: np.ndarray) -> float:
        score = self.score if self.score.ndim == 2 else np.stack([-self.score, self.score], axis=1)
        is_mixed = positive.any(axis=0) & ~positive.all(axis=0)
        if not is_mixed.any() or np.isnan(score).any():
            return math.nan
        areas = [roc_auc_score(positive[:, i], score[:, i]) for i in np.flatnonzero(is_mixed)]
        return float(np.mean(areas))

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the predictions as JSON values, with arrays compressed without loss."""
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
        r"""Builds predictions from the JSON values of :meth:`to_dict`."""
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
