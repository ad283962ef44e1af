r"""From what a model returns to what it decides."""

from torch import Tensor

from torch_geometric_tactile._typing import ThresholdMetric
from torch_geometric_tactile.training._checkpointed_module import CheckpointedModule
from torch_geometric_tactile.training._threshold import BestThreshold


class DecidingModule(CheckpointedModule):
    r"""A module that tells probabilities, and has a threshold above which class 1 of two is
    predicted.
    """

    threshold: float | ThresholdMetric | None
    val_threshold: BestThreshold | None

    def set_threshold(self, threshold: float | ThresholdMetric | None) -> None:
        r"""Sets the threshold, or the metric that chooses it.

        Args:
            threshold (float or str, optional): The threshold, or a metric.
        """
        self.threshold = threshold
        self.decision_threshold = None if isinstance(threshold, str) else threshold
        self.val_threshold = BestThreshold(threshold) if isinstance(threshold, str) else None

    def choose_threshold(self) -> None:
        r"""Chooses and logs the threshold at the end of a validation in training."""
        if self.val_threshold is None:
            return
        if self.trainer.state.fn == "fit":  # a trained model keeps what it was trained with
            self.decision_threshold = float(self.val_threshold.compute())
            self.log("val/threshold", self.decision_threshold, sync_dist=True)
        self.val_threshold.reset()

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes or of each label :math:`(B, C)`; the numbers of
        a regression as they are.

        Args:
            logits (torch.Tensor): What the model returned :math:`(B, C)`.
        """
        if self.task == "regression":
            return logits
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)
