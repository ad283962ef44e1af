r"""How much an accuracy varies over draws of the samples tested on."""

from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.experiments.predictions import Predictions


@dataclass(frozen=True)
class Draws:
    r"""Draws of the samples tested on, without replacement, as the "Morphology-Specific
    Convolutional Neural Networks for Tactile Object Recognition with a Multi-Fingered Hand" paper
    has them: ten, each of 1,500 of the 2,500 samples. The model is one, trained once.

    Examples:
        >>> round(100**2 * Draws().variance(0.5, 2500), 2), round(Draws().num_drawn(2500))
        (0.67, 1500)
    """

    count: int = 10
    part: float = 0.6
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("count", 2), ("seed", 0)):
            value = getattr(self, name)
            if type(value) is not int or value < least:
                raise ValueError(
                    f"'{name}' of draws must be a whole number from {least} on (got {value!r})"
                )
        if not isinstance(self.part, float) or not 0 < self.part < 1:
            raise ValueError(f"'part' of draws must be between 0 and 1 (got {self.part!r})")

    def num_drawn(self, num_samples: int) -> int:
        r"""Returns how many samples a draw has."""
        return max(1, round(self.part * num_samples))

    def accuracies(self, predicted: Predictions) -> np.ndarray:
        r"""Returns the accuracy of each draw, from 0 to 1."""
        right = predicted.prediction == predicted.y
        right = right if right.ndim == 1 else right.all(axis=1)
        rng, size = np.random.default_rng(self.seed), self.num_drawn(len(right))
        draws = [rng.choice(len(right), size, replace=False) for _ in range(self.count)]
        return np.array([right[drawn].mean() for drawn in draws])

    def metrics(self, predicted: Predictions) -> dict[str, float]:
        r"""Returns :obj:`draws_accuracy`, the mean over the draws, and :obj:`draws_variance`, the
        unbiased estimate of their variance, of accuracies from 0 to 1.
        """
        found = self.accuracies(predicted)
        return {"draws_accuracy": float(found.mean()), "draws_variance": float(found.var(ddof=1))}

    def variance(self, accuracy: float, num_samples: int) -> float:
        r"""Returns the variance that draws can be expected to have: of :math:`n` of :math:`N`
        samples, of which a part :math:`p` is right, that of the hypergeometric distribution,

        .. math::
            \frac{p (1 - p)}{n} \cdot \frac{N - n}{N - 1}

        which is largest for :math:`p = 1/2`.
        """
        size = self.num_drawn(num_samples)
        rest = (num_samples - size) / max(num_samples - 1, 1)
        return accuracy * (1.0 - accuracy) / size * rest
