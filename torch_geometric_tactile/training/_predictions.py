r"""What a classifier says of samples, collected batch by batch."""

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.training._finite import BatchCheck
from torch_geometric_tactile.training.module import TactileModule


class Outputs(NamedTuple):
    r"""What a classifier says of :math:`S` samples, on the CPU.

    Shapes:
        - **logits:** What the model returned :math:`(S, C)`.
        - **probability:** The probabilities of the classes, or of each label
          :math:`(S, C)`.
        - **y:** Their classes :math:`(S,)` or labels :math:`(S, C)`.
    """

    logits: Tensor
    probability: Tensor
    y: Tensor


def collect_predictions(
    classifier: TactileModule,
    batches: Iterable[Data],
    device: torch.device | str | None = None,
) -> Outputs:
    r"""Returns what a classifier says of samples, in their order. Dropout and the like are off; the
    classifier is left in the mode that it was in.
    """
    device = classifier.device if device is None else torch.device(device)
    training = classifier.training
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
        classifier.train(training)
    need(y, "'batches' must hold at least one batch (got none)")
    return Outputs(torch.cat(logits), torch.cat(probability), torch.cat(y))
