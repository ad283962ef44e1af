r"""What fitted estimators compute of features, as modules of tensors in double precision. Each is
a step from rows of numbers to rows of numbers, and checks at birth what a file may claim.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.predictor._estimator_features import Step

_MOST_LEVELS = 1000  # of a tree
_LEAST = 1e-30  # probability
_MOST_CLASSES = 100_000


class Affine(Step):
    r"""Scales and shifts each number.

    Shapes:
        - **weight, bias:** :math:`(F,)`
    """

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Tensor, bias: Tensor) -> None:
        super().__init__()
        self._keep("weight", weight, 1)
        self._keep("bias", bias, 1)
        need(weight.shape == bias.shape, "'bias' must be as 'weight'", tuple(bias.shape))
        self.takes = self.gives = weight.size(0)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, F)`."""
        return rows * self.weight + self.bias


class Linear(Step):
    r"""A weighted sum for each output.

    Shapes:
        - **weight:** :math:`(F, O)`
        - **bias:** :math:`(O,)`
    """

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Tensor, bias: Tensor) -> None:
        super().__init__()
        self._keep("weight", weight, 2)
        self._keep("bias", bias, 1)
        need(weight.shape[1:] == bias.shape, "'bias' must be of each output", tuple(bias.shape))
        self.takes, self.gives = weight.shape

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        return rows @ self.weight + self.bias


class Kernel(Step):
    r"""Support vector machines with one radial kernel: weighted sums of how near a row is to the
    support vectors, by groups of these.

    Shapes:
        - **vectors:** :math:`(V, F)`
        - **weight:** :math:`(V, R)`
        - **counts:** How many vectors each of the groups has :math:`(G,)`
        - **output:** :math:`(B, G \cdot R)`
    """

    vectors: Tensor
    weight: Tensor
    _length: Tensor

    def __init__(self, vectors: Tensor, weight: Tensor, counts: Sequence[int], gamma: float):
        super().__init__()
        self._keep("vectors", vectors, 2)
        self._keep("weight", weight, 2)
        self.counts = _whole("counts", counts)
        self.gamma = float(gamma)
        total = sum(self.counts)
        if not len(vectors) == len(weight) == total:
            raise ValueError(f"'counts' must be of {len(vectors)} vectors (got {total})")
        self.takes, self.gives = vectors.size(1), len(self.counts) * weight.size(1)
        self.register_buffer("_length", self.vectors.square().sum(dim=1), persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, G \cdot R)`."""
        length = rows.square().sum(dim=1, keepdim=True)
        distance = (length + self._length - 2 * rows @ self.vectors.t()).clamp(min=0)
        near = (-self.gamma * distance).exp()
        found, start = [], 0
        for count in self.counts:
            group = slice(start, start + count)
            found.append(near[:, group] @ self.weight[group])
            start += count
        return torch.cat(found, dim=1)


class Votes(Step):
    r"""Scores of classes of what pairs of classes say against each other: their votes, and their
    confidence as a fraction of one, as :obj:`SVC(decision_function_shape="ovr")`.

    Shapes:
        - **bias:** of each pair :math:`(C \cdot (C - 1) / 2,)`
        - **input:** :math:`(B, C \cdot (C - 1))`
    """

    bias: Tensor
    _first: Tensor
    _second: Tensor
    _pair: Tensor
    _side: Tensor

    def __init__(self, bias: Tensor) -> None:
        super().__init__()
        self._keep("bias", bias, 1)
        count = 2
        while count * (count - 1) // 2 < len(bias):
            count += 1
        need(count * (count - 1) // 2 == len(bias), "'bias' must be of pairs", len(bias))
        self.takes, self.gives = count * (count - 1), count
        first, second = torch.triu_indices(count, count, 1)
        pair, side = torch.zeros(2, count, count, dtype=torch.long)
        pair[first, second] = pair[second, first] = torch.arange(len(bias))
        side[first, second], side[second, first] = 1, -1
        places = (first * (count - 1) + second - 1, second * (count - 1) + first)
        for name, value in zip(
            ("_first", "_second", "_pair", "_side"), (*places, pair, side.double()), strict=True
        ):
            self.register_buffer(name, value, persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, C)`."""
        said = rows[:, self._first] + rows[:, self._second] + self.bias
        against = said[:, self._pair] * self._side  # of each class against each
        votes, confidence = (against > 0).double().sum(dim=2), against.sum(dim=2)
        return votes + confidence / (3 * (confidence.abs() + 1))


class Forest(Step):
    r"""The mean of the leaves of decision trees that a row comes to.

    Shapes:
        - **feature, threshold, left, right:** of each node :math:`(V,)`; a leaf has itself on both
          sides, and others come after their parent
        - **roots:** :math:`(T,)`
        - **values:** :math:`(V, O)`
    """

    feature: Tensor
    threshold: Tensor
    left: Tensor
    right: Tensor
    roots: Tensor
    values: Tensor

    def __init__(
        self,
        feature: Tensor,
        threshold: Tensor,
        left: Tensor,
        right: Tensor,
        roots: Tensor,
        values: Tensor,
        num_features: int,
    ) -> None:
        super().__init__()
        whole = {"feature": feature, "left": left, "right": right, "roots": roots}
        for name, value in whole.items():
            self._keep(name, value, 1, torch.long)
        self._keep("threshold", threshold, 1)
        self._keep("values", values, 2)
        count = len(values)
        (width,) = _whole("num_features", [num_features])
        sizes = [len(value) for value in (feature, threshold, left, right)]
        need(count > 0 and sizes == [count] * 4, f"each of {count} nodes must be whole", sizes)
        limits = {"feature": width, "left": count, "right": count, "roots": count}
        for name, most in limits.items():
            value = getattr(self, name)
            if not len(value) or value.min() < 0 or value.max() >= most:
                raise ValueError(f"'{name}' must be from 0 to {most - 1} (got others)")
        self.num_levels = self._count_levels()
        self.takes, self.gives = width, values.size(1)

    def _count_levels(self) -> int:
        node = torch.arange(len(self.left))
        is_leaf = (self.left == node) & (self.right == node)
        if not (is_leaf | ((self.left > node) & (self.right > node))).all():
            raise ValueError("'left' and 'right' must come after their parent (got others)")
        reached, levels = self.roots.unique(), 0
        while not is_leaf[reached].all():
            levels += 1
            need(levels <= _MOST_LEVELS, f"a tree must have at most {_MOST_LEVELS} levels", levels)
            reached = torch.cat([self.left[reached], self.right[reached]]).unique()
        return levels

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        rows = rows.float().double()  # as scikit-learn compares them
        node = self.roots.unsqueeze(0).expand(rows.size(0), -1)
        for _ in range(self.num_levels):
            is_left = rows.gather(1, self.feature[node]) <= self.threshold[node]
            node = torch.where(is_left, self.left[node], self.right[node])
        return self.values[node].mean(dim=1)


class Constant(Step):
    r"""The same numbers for every row.

    Shapes:
        - **values:** :math:`(O,)`
    """

    values: Tensor

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self._keep("values", values, 1)
        self.gives = len(values)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        return self.values.unsqueeze(0) + torch.zeros_like(rows[:, :1])


class Beside(Step):
    r"""Several models of the same rows, with their outputs side by side.

    Args:
        models (sequence): The steps of each.
    """

    def __init__(self, models: Sequence[Sequence[Mapping[str, Any]]]) -> None:
        super().__init__()
        chains = [Chain(steps, ROWS) for steps in models]
        need(chains, "'models' must hold at least one (got none)")
        self.models = torch.nn.ModuleList(chains)
        widths = [chain.gives for chain in chains]
        need(None not in widths, "each of 'models' must give as many numbers", widths)
        self.takes = next((chain.takes for chain in chains if chain.takes), None)
        self.gives = sum(width or 0 for width in widths)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        return torch.cat([model(rows) for model in self.models], dim=1)


class Probability(Step):
    r"""Probabilities of scores :math:`(B, C)`, or of one score of two classes :math:`(B, 1)`."""

    def __init__(self, factor: float, of_two: bool) -> None:
        super().__init__()
        self.factor = float(factor)
        need(self.factor > 0, "'factor' must be above 0", factor)
        self.of_two = bool(of_two)
        if self.of_two:
            self.takes, self.gives = 1, 2

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, C)`."""
        scores = self.factor * rows
        if self.of_two:
            scores = torch.cat([torch.zeros_like(scores), scores], dim=1)
        return scores.softmax(dim=1)


class Logits(Step):
    r"""Logits of all classes, of the probabilities of those that were in the training part."""

    _column: Tensor

    def __init__(self, classes: Sequence[int], num_classes: int) -> None:
        super().__init__()
        self.classes = _whole("classes", classes)
        (count,) = _whole("num_classes", [num_classes])
        if sorted(set(self.classes)) != self.classes or not self.classes[-1:] < [count]:
            raise ValueError(f"'classes' must rise and be below {count} (got {classes!r:.80})")
        need(count <= _MOST_CLASSES, f"'num_classes' must be up to {_MOST_CLASSES}", count)
        self.takes, self.gives = len(self.classes), count
        column = torch.full((count,), len(self.classes))  # one of zeros
        column[self.classes] = torch.arange(len(self.classes))
        self.register_buffer("_column", column, persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, C)`."""
        padded = torch.cat([rows, torch.zeros_like(rows[:, :1])], dim=1)
        return padded[:, self._column].clamp(min=_LEAST).log()


class Chain(Module):
    r"""Steps one after the other, each of which must take as many numbers as the one before gives.

    Args:
        steps (sequence): Name and arguments of each.
        known (Mapping): The steps that there are, by name.
    """

    def __init__(self, steps: Sequence[Mapping[str, Any]], known: Mapping[str, type[Step]]) -> None:
        super().__init__()
        if not isinstance(steps, Sequence) or not steps:
            raise ValueError(f"'steps' must be at least one step (got {steps!r:.80})")
        built: list[Step] = []
        for described in steps:
            given = dict(described)
            name = given.pop("step", None)
            if name not in known:
                raise ValueError(f"a step must be one of {', '.join(known)} (got {name!r:.80})")
            built.append(known[name](**given))
        self.steps = torch.nn.ModuleList(built)
        self.takes, width = built[0].takes, built[0].gives
        for step in built[1:]:
            if step.takes is not None and width is not None and step.takes != width:
                raise ValueError(
                    f"{type(step).__name__} must take {width} numbers (got {step.takes})"
                )
            width = width if step.gives is None else step.gives
        self.gives = width

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        if self.takes is not None and rows.size(1) != self.takes:
            raise ValueError(
                f"each sample must have {self.takes} numbers, as the estimator was fitted on (got "
                f"{rows.size(1)})"
            )
        for step in self.steps:
            rows = step(rows)
        return rows


ROWS: dict[str, type[Step]] = {
    step.__name__: step
    for step in (Affine, Linear, Kernel, Votes, Forest, Constant, Beside, Probability, Logits)
}


def _whole(name: str, values: Any) -> list[int]:
    if not isinstance(values, Sequence) or not all(type(v) is int and v >= 0 for v in values):
        raise ValueError(f"'{name}' must hold whole numbers from 0 on (got {values!r:.80})")
    need(values, f"'{name}' must hold at least one number (got none)")
    return list(values)
