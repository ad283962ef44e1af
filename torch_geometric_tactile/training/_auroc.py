r"""The area under the ROC curve, without classes that there is nothing to rank of."""

import torch
import torch.nn.functional as F
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.functional.classification import binary_auroc
from torchmetrics.utilities import dim_zero_cat


def macro_auroc(score: Tensor, positive: Tensor) -> Tensor:
    r"""Returns the mean area under the ROC curve, over the classes that some samples have and
    some have not; NaN if there is none, or a score is NaN.

    Shapes:
        - **input:** :math:`(S, C)` each
        - **output:** a scalar
    """
    mixed = (positive.any(dim=0) & ~positive.all(dim=0)).nonzero().view(-1)
    if len(mixed) == 0 or score.isnan().any():
        return score.new_tensor(torch.nan)
    areas = [
        binary_auroc(score[:, i], positive[:, i].long(), validate_args=False)
        for i in mixed.tolist()
    ]
    return torch.stack(areas).mean()


class MacroAUROC(Metric):
    r"""The mean area under the ROC curve of each class against the rest, or of each label; classes
    that no sample has, or all have, are left out (torchmetrics counts them as zero).

    It keeps the scores of all samples until it is reset.

    Shapes:
        - **num_classes:** Number of classes or labels :math:`C`.
    """

    full_state_update = False
    higher_is_better = True
    scores: list[Tensor]
    positives: list[Tensor]

    def __init__(self, num_classes: int, task: str = "multiclass") -> None:
        super().__init__()
        self.num_classes = num_classes
        self.task = task
        self.add_state("scores", default=[], dist_reduce_fx="cat")
        self.add_state("positives", default=[], dist_reduce_fx="cat")

    def update(self, score: Tensor, y: Tensor) -> None:
        r"""Takes the predictions of a batch.

        Shapes:
            - **score:** Probabilities :math:`(B, C)`.
            - **y:** Classes :math:`(B,)`, or labels :math:`(B, C)`.
        """
        self.scores.append(score.detach())
        positive = y if self.task == "multilabel" else F.one_hot(y, self.num_classes)
        self.positives.append(positive > 0.5)

    def compute(self) -> Tensor:
        r"""Returns the mean of all samples so far."""
        if len(self.scores) == 0:
            return torch.tensor(torch.nan)
        return macro_auroc(dim_zero_cat(self.scores), dim_zero_cat(self.positives))
