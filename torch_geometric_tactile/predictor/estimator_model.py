r"""A fitted scikit-learn estimator as a PyTorch model."""

from collections.abc import Mapping, Sequence
from typing import Any, Self

from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.predictor._estimator_features import FEATURES
from torch_geometric_tactile.predictor._estimator_steps import ROWS, Chain


class EstimatorModel(Module):
    r"""A fitted scikit-learn pipeline of :mod:`torch_geometric_tactile.baselines` as a PyTorch
    model. The support vectors, trees and weights are stored as tensors. The model can be part of a
    predictor and can be exported to ONNX; it needs neither scikit-learn nor a pickle. Use
    :func:`estimator_predictor` to build it.

    The model computes in double precision, like scikit-learn. The output has the precision of the
    readings.

    Args:
        steps (sequence of mappings): The steps in order. The first step computes features of
            samples; the other steps are fitted scalers and estimators. Each mapping holds the name
            of a step (:obj:`"step"`) and its arguments as plain values and tensors.

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
            raise ValueError(f"'steps' must be features and a model (got {steps!r:.80})")
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
            num_classes (int, optional): Number of classes, including classes that are missing from
                the training part. If left out, the model is a regression.
            **samples (bool, optional): :obj:`normal` and :obj:`tangent`: whether samples have these
                attributes.

        Raises:
            ValueError: If the estimator is not supported, not fitted, or a classifier without
                probabilities.
        """
        # The import is here because a model that is read from a file does not need scikit-learn.
        from torch_geometric_tactile.predictor._estimator_numbers import fitted_steps

        return cls(fitted_steps(estimator, num_classes, **samples))

    @property
    def modalities(self) -> tuple[str, ...]:
        r"""The names of the attributes that :meth:`forward` reads in addition to the readings."""
        return self.features.modalities

    def float(self) -> Self:
        r"""Returns the model unchanged, because it computes in double precision."""
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
