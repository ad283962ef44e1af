r"""Predictions of a classifier, collected batch by batch."""

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.training._finite import BatchCheck
from torch_geometric_tactile.training.module import TactileModule


class Outputs(NamedTuple):
    r"""Predictions of a classifier for :math:`S` samples, on the CPU.

    Shapes:
        - **logits:** Outputs of the model :math:`(S, C)`.
        - **probability:** Probabilities of the classes, or of each label :math:`(S, C)`.
        - **y:** True classes :math:`(S,)` or labels :math:`(S, C)`.
    """

    logits: Tensor
    probability: Tensor
    y: Tensor


def collect_predictions(
    classifier: TactileModule,
    batches: Iterable[Data],
    device: torch.device | str | None = None,
) -> Outputs:
    r"""Returns the predictions of a classifier for all samples in order. The classifier is switched
    to evaluation mode, and its previous mode is restored afterwards.
    """
    device = classifier.device if device is None else torch.device(device)
    was_training = classifier.training
    classifier.to(device).eval()
    logits, probability, y = [], [], []
    try:
        with torch.inference_mode():
            for i, batch in enumerate(batches):
                out = classifier(batch.to(device))
                score = classifier.probability(out)
                BatchCheck(classifier.model, batch, f"batch {i}", batches).scores(score)
                logits.append(out.cpu())
                probability.append(score.cpu())
                y.append(batch.y.cpu())
    finally:
        classifier.train(was_training)
    need(y, "'batches' must hold at least one batch (got none)")
    return Outputs(torch.cat(logits), torch.cat(probability), torch.cat(y))
