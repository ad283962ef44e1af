r"""A fitted estimator of scikit-learn as a model of tensors."""

from collections.abc import Mapping, Sequence
from typing import Any, Self

from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.predictor._estimator_features import FEATURES
from torch_geometric_tactile.predictor._estimator_steps import ROWS, Chain


class EstimatorModel(Module):
    r"""A fitted scikit-learn pipeline of :mod:`torch_geometric_tactile.baselines` as a model of
    tensors: support vectors, trees and weights. It can be part of a predictor and be exported to
    ONNX, and needs neither scikit-learn nor a pickle. :func:`estimator_predictor` builds it.

    It computes in double precision, as scikit-learn does, and returns the precision of the
    readings.

    Args:
        steps (sequence of mappings): The steps in their order. The first one computes features of
            samples; the others are fitted scalers and estimators. Each mapping holds the name of a
            step (:obj:`"step"`) and its arguments, plain values and tensors.

    Shapes:
        - **x:** prepared readings :math:`(B, N, F)`
        - **output:** logarithms of probabilities, or numbers :math:`(B, C)`

    Raises:
        ValueError: If a step is unknown, or its arguments do not fit together.

    Examples:
        >>> import numpy as np, torch
        >>> from torch_geometric_tactile.baselines import flat_forest
        >>> x = np.arange(8.0).reshape(8, 1, 1)
        >>> forest = flat_forest(num_trees=10).fit(x, [0, 0, 0, 0, 1, 1, 1, 1])
        >>> model = EstimatorModel.of(forest, num_classes=2)
        >>> model(torch.tensor([[[0.0]], [[7.0]]])).argmax(dim=1)
        tensor([0, 1])
    """

    needs_edges = False

    def __init__(self, steps: Sequence[Mapping[str, Any]]) -> None:
        super().__init__()
        if not isinstance(steps, Sequence) or len(steps) < 2:
            raise ValueError(f"'steps' must be features and more (got {steps!r:.80})")
        feature_step = dict(steps[0])
        name = feature_step.pop("step", None)
        if name not in FEATURES:
            raise ValueError(f"the first step must be one of {', '.join(FEATURES)} (got {name!r})")
        self.features = FEATURES[name](**feature_step)
        self.rows = Chain(steps[1:], ROWS)
        self.init_arguments = {"steps": [dict(step) for step in steps]}

    @classmethod
    def of(cls, estimator: Any, num_classes: int | None = None, **samples: Any) -> Self:
        r"""Returns the model of a fitted estimator.

        Args:
            estimator (estimator): A pipeline of :mod:`torch_geometric_tactile.baselines`.
            num_classes (int, optional): Number of classes, including those that the training part
                lacks; the model is a regression if left out.
            **samples (bool, optional): :obj:`normal` and :obj:`tangent`, whether samples have these
                attributes.

        Raises:
            ValueError: If the estimator is not supported, not fitted, or a classifier without
                probabilities.
        """
        # Imported here: a model that is read from a file does not need scikit-learn.
        from torch_geometric_tactile.predictor._estimator_numbers import fitted_steps

        return cls(fitted_steps(estimator, num_classes, **samples))

    @property
    def modalities(self) -> tuple[str, ...]:
        r"""Names of the attributes of a batch that :meth:`forward` takes besides the readings."""
        return self.features.modalities

    def float(self) -> Self:
        r"""Returns the model unchanged, since it computes in double precision."""
        return self

    def forward(self, x: Tensor, edge_index: Tensor | None = None, **attributes: Tensor) -> Tensor:
        r"""Returns logarithms of probabilities :math:`(B, C)`, or numbers.

        Args:
            x (torch.Tensor): Prepared readings :math:`(B, N, F)`.
            edge_index (torch.Tensor, optional): Not used.
            **attributes (torch.Tensor): The attributes that :obj:`modalities` names.
        """
        out: Tensor = self.rows(self.features(x, attributes))
        return out.to(x.dtype)

    def extra_repr(self) -> str:
        r"""Returns the names of the steps."""
        return ", ".join(step["step"] for step in self.init_arguments["steps"])
