r"""Variance of an accuracy over random draws of the test samples."""

from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.experiments.predictions import Predictions


@dataclass(frozen=True)
class Draws:
    r"""Random draws of the test samples without replacement. The "Morphology-Specific Convolutional
    Neural Networks for Tactile Object Recognition with a Multi-Fingered Hand" paper uses ten draws
    of 1,500 of the 2,500 samples. The model is trained once and tested on each draw.

    Args:
        count (int): Number of draws.
        part (float): Share of the test samples in a draw, between 0 and 1.
        seed (int): Seed of the draws.

    Examples:
        >>> round(100**2 * Draws().variance(0.5, 2500), 2), round(Draws().num_drawn(2500))
        (0.67, 1500)
    """

    count: int = 10
    part: float = 0.6
    seed: int = 0

    def __post_init__(self) -> None:
        for name, minimum in (("count", 2), ("seed", 0)):
            value = getattr(self, name)
            if type(value) is not int or value < minimum:  # True is an int, too
                raise ValueError(
                    f"'{name}' of draws must be a whole number of at least {minimum} "
                    f"(got {value!r})"
                )
        if not isinstance(self.part, float) or not 0 < self.part < 1:
            raise ValueError(f"'part' of draws must be between 0 and 1 (got {self.part!r})")

    def num_drawn(self, num_samples: int) -> int:
        r"""Returns the number of samples in a draw."""
        return max(1, round(self.part * num_samples))

    def accuracies(self, predicted: Predictions) -> np.ndarray:
        r"""Returns the accuracy of each draw, from 0 to 1. A sample with several labels is correct
        if all its labels are correct.
        """
        is_correct = predicted.prediction == predicted.y
        is_correct = is_correct if is_correct.ndim == 1 else is_correct.all(axis=1)
        rng, size = np.random.default_rng(self.seed), self.num_drawn(len(is_correct))
        draws = [rng.choice(len(is_correct), size, replace=False) for _ in range(self.count)]
        return np.array([is_correct[indices].mean() for indices in draws])

    def metrics(self, predicted: Predictions) -> dict[str, float]:
        r"""Returns :obj:`draws_accuracy`, the mean accuracy of the draws, and
        :obj:`draws_variance`, the unbiased estimate of their variance. Accuracies are from 0 to 1.
        """
        accuracies = self.accuracies(predicted)
        return {
            "draws_accuracy": float(accuracies.mean()),
            "draws_variance": float(accuracies.var(ddof=1)),
        }

    def variance(self, accuracy: float, num_samples: int) -> float:
        r"""Returns the expected variance of the accuracies. If :math:`n` of :math:`N` samples are
        drawn and a share :math:`p` of all samples is classified correctly, this is the variance of
        the hypergeometric distribution,

        .. math::
            \frac{p (1 - p)}{n} \cdot \frac{N - n}{N - 1}

        It is largest for :math:`p = 1/2`.

        Args:
            accuracy (float): The accuracy :math:`p` on all test samples.
            num_samples (int): The number of test samples :math:`N`.
        """
        size = self.num_drawn(num_samples)
        finite_correction = (num_samples - size) / max(num_samples - 1, 1)
        return accuracy * (1.0 - accuracy) / size * finite_correction
