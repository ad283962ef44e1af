r"""Fitted estimators as modules with tensors in double precision. Each module is a step that turns
rows of numbers into rows of numbers. Modules check their arguments, which may come from a damaged
file.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.predictor._estimator_features import Step

_MAX_TREE_LEVELS = 1000
_MIN_PROBABILITY = 1e-30  # gives classes with zero probability a finite logarithm
_MAX_CLASSES = 100_000


class Affine(Step):
    r"""A step that scales and shifts each number of a row.

    Shapes:
        - **weight, bias:** :math:`(F,)`
    """

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Tensor, bias: Tensor) -> None:
        super().__init__()
        self._register_tensor("weight", weight, 1)
        self._register_tensor("bias", bias, 1)
        need(
            weight.shape == bias.shape, "'bias' must have the shape of 'weight'", tuple(bias.shape)
        )
        self.num_inputs = self.num_outputs = weight.size(0)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, F)`."""
        return rows * self.weight + self.bias


class Linear(Step):
    r"""A step that computes a weighted sum for each output.

    Shapes:
        - **weight:** :math:`(F, O)`
        - **bias:** :math:`(O,)`
    """

    weight: Tensor
    bias: Tensor

    def __init__(self, weight: Tensor, bias: Tensor) -> None:
        super().__init__()
        self._register_tensor("weight", weight, 2)
        self._register_tensor("bias", bias, 1)
        need(
            weight.shape[1:] == bias.shape,
            "'bias' must have a number for each output",
            tuple(bias.shape),
        )
        self.num_inputs, self.num_outputs = weight.shape

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        return rows @ self.weight + self.bias


class Kernel(Step):
    r"""A step that evaluates support vector machines with one radial kernel. For each group of
    support vectors, it computes weighted sums of the kernel between a row and the support vectors.

    Shapes:
        - **vectors:** :math:`(V, F)`
        - **weight:** :math:`(V, R)`
        - **counts:** number of vectors in each group :math:`(G,)`
        - **output:** :math:`(B, G \cdot R)`
    """

    vectors: Tensor
    weight: Tensor
    _squared_norm: Tensor

    def __init__(self, vectors: Tensor, weight: Tensor, counts: Sequence[int], gamma: float):
        super().__init__()
        self._register_tensor("vectors", vectors, 2)
        self._register_tensor("weight", weight, 2)
        self.counts = _to_counts("counts", counts)
        self.gamma = float(gamma)
        total = sum(self.counts)
        if not len(vectors) == len(weight) == total:
            raise ValueError(f"'counts' must add up to {len(vectors)} vectors (got {total})")
        self.num_inputs, self.num_outputs = vectors.size(1), len(self.counts) * weight.size(1)
        self.register_buffer("_squared_norm", self.vectors.square().sum(dim=1), persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, G \cdot R)`."""
        squared_norm = rows.square().sum(dim=1, keepdim=True)
        squared_distance = (squared_norm + self._squared_norm - 2 * rows @ self.vectors.t()).clamp(
            min=0
        )
        similarity = (-self.gamma * squared_distance).exp()
        sums, start = [], 0
        for count in self.counts:
            group = slice(start, start + count)
            sums.append(similarity[:, group] @ self.weight[group])
            start += count
        return torch.cat(sums, dim=1)


class Votes(Step):
    r"""A step that computes scores of classes from the scores of all pairs of classes. A score is
    the number of pairs that a class wins, plus its confidence as a fraction below one, as in
    :obj:`SVC(decision_function_shape="ovr")`.

    Shapes:
        - **bias:** one number for each pair :math:`(C \cdot (C - 1) / 2,)`
        - **input:** :math:`(B, C \cdot (C - 1))`
    """

    bias: Tensor
    _first: Tensor
    _second: Tensor
    _pair: Tensor
    _side: Tensor

    def __init__(self, bias: Tensor) -> None:
        super().__init__()
        self._register_tensor("bias", bias, 1)
        num_classes = 2
        while num_classes * (num_classes - 1) // 2 < len(bias):
            num_classes += 1
        need(
            num_classes * (num_classes - 1) // 2 == len(bias),
            "'bias' must have a number for each pair of classes",
            len(bias),
        )
        self.num_inputs, self.num_outputs = num_classes * (num_classes - 1), num_classes
        first, second = torch.triu_indices(num_classes, num_classes, 1)
        pair, side = torch.zeros(2, num_classes, num_classes, dtype=torch.long)
        pair[first, second] = pair[second, first] = torch.arange(len(bias))
        side[first, second], side[second, first] = 1, -1
        positions = (first * (num_classes - 1) + second - 1, second * (num_classes - 1) + first)
        for name, value in zip(
            ("_first", "_second", "_pair", "_side"), (*positions, pair, side.double()), strict=True
        ):
            self.register_buffer(name, value, persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, C)`."""
        pair_scores = rows[:, self._first] + rows[:, self._second] + self.bias
        signed_scores = pair_scores[:, self._pair] * self._side  # score of class i against class j
        votes, confidence = (signed_scores > 0).double().sum(dim=2), signed_scores.sum(dim=2)
        # The confidence is below a third, as in scikit-learn, so that it only breaks ties.
        return votes + confidence / (3 * (confidence.abs() + 1))


class Forest(Step):
    r"""A step that evaluates decision trees. Each row reaches one leaf per tree, and the output is
    the mean of the values of these leaves.

    Args:
        feature (torch.Tensor): Index of the feature that each node compares.
        threshold (torch.Tensor): Threshold of each node. Rows that do not exceed it go left.
        left (torch.Tensor): Left child of each node. Children come after their parent; the child of
            a leaf is the leaf itself.
        right (torch.Tensor): Right child of each node.
        roots (torch.Tensor): First node of each tree.
        values (torch.Tensor): Outputs of each node.
        num_features (int): Length of a row.

    Shapes:
        - **feature, threshold, left, right:** :math:`(V,)`
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
        indices = {"feature": feature, "left": left, "right": right, "roots": roots}
        for name, value in indices.items():
            self._register_tensor(name, value, 1, torch.long)
        self._register_tensor("threshold", threshold, 1)
        self._register_tensor("values", values, 2)
        num_nodes = len(values)
        (num_inputs,) = _to_counts("num_features", [num_features])
        sizes = [len(value) for value in (feature, threshold, left, right)]
        need(
            num_nodes > 0 and sizes == [num_nodes] * 4,
            f"all {num_nodes} nodes must be complete",
            sizes,
        )
        limits = {"feature": num_inputs, "left": num_nodes, "right": num_nodes, "roots": num_nodes}
        for name, limit in limits.items():
            value = getattr(self, name)
            if not len(value) or value.min() < 0 or value.max() >= limit:
                raise ValueError(f"'{name}' must be from 0 to {limit - 1} (got other numbers)")
        self.num_levels = self._count_levels()
        self.num_inputs, self.num_outputs = num_inputs, values.size(1)

    def _count_levels(self) -> int:
        node = torch.arange(len(self.left))
        is_leaf = (self.left == node) & (self.right == node)
        if not (is_leaf | ((self.left > node) & (self.right > node))).all():
            raise ValueError("'left' and 'right' must come after their parent (got other nodes)")
        nodes, levels = self.roots.unique(), 0
        while not is_leaf[nodes].all():
            levels += 1
            need(
                levels <= _MAX_TREE_LEVELS,
                f"a tree must have at most {_MAX_TREE_LEVELS} levels",
                levels,
            )
            nodes = torch.cat([self.left[nodes], self.right[nodes]]).unique()
        return levels

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        rows = rows.float().double()  # scikit-learn compares in single precision
        node = self.roots.unsqueeze(0).expand(rows.size(0), -1)
        for _ in range(self.num_levels):
            is_left = rows.gather(1, self.feature[node]) <= self.threshold[node]
            node = torch.where(is_left, self.left[node], self.right[node])
        return self.values[node].mean(dim=1)


class Constant(Step):
    r"""A step that returns the same numbers for every row.

    Shapes:
        - **values:** :math:`(O,)`
    """

    values: Tensor

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self._register_tensor("values", values, 1)
        self.num_outputs = len(values)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        return self.values.unsqueeze(0) + torch.zeros_like(rows[:, :1])


class Beside(Step):
    r"""A step that applies several models to the same rows and concatenates their outputs.

    Args:
        models (sequence of sequences): The steps of each model.
    """

    def __init__(self, models: Sequence[Sequence[Mapping[str, Any]]]) -> None:
        super().__init__()
        chains = [Chain(steps, ROWS) for steps in models]
        need(chains, "'models' must hold at least one (got none)")
        self.models = torch.nn.ModuleList(chains)
        output_counts = [chain.num_outputs for chain in chains]
        need(None not in output_counts, "the outputs of 'models' must be known", output_counts)
        self.num_inputs = next((chain.num_inputs for chain in chains if chain.num_inputs), None)
        self.num_outputs = sum(width or 0 for width in output_counts)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        return torch.cat([model(rows) for model in self.models], dim=1)


class Probability(Step):
    r"""A step that computes probabilities of classes from scores :math:`(B, C)`, or from one score
    for two classes :math:`(B, 1)`.

    Args:
        factor (float): Factor by which the scores are multiplied.
        of_two (bool): Whether there is one score for two classes.
    """

    def __init__(self, factor: float, of_two: bool) -> None:
        super().__init__()
        self.factor = float(factor)
        need(self.factor > 0, "'factor' must be above 0", factor)
        self.is_binary = bool(of_two)
        if self.is_binary:
            self.num_inputs, self.num_outputs = 1, 2

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, C)`."""
        scores = self.factor * rows
        if self.is_binary:
            scores = torch.cat([torch.zeros_like(scores), scores], dim=1)
        return scores.softmax(dim=1)


class Logits(Step):
    r"""A step that computes logits of all classes from probabilities of the classes in the training
    part. All other classes get a probability close to zero.

    Args:
        classes (sequence of int): Indices of the classes in the training part, in increasing order.
        num_classes (int): Number of all classes.
    """

    _column: Tensor

    def __init__(self, classes: Sequence[int], num_classes: int) -> None:
        super().__init__()
        self.classes = _to_counts("classes", classes)
        (num_outputs,) = _to_counts("num_classes", [num_classes])
        if sorted(set(self.classes)) != self.classes or not self.classes[-1:] < [num_outputs]:
            raise ValueError(
                f"'classes' must increase and be below {num_outputs} (got {classes!r:.80})"
            )
        need(
            num_outputs <= _MAX_CLASSES,
            f"'num_classes' must be at most {_MAX_CLASSES}",
            num_outputs,
        )
        self.num_inputs, self.num_outputs = len(self.classes), num_outputs
        column = torch.full((num_outputs,), len(self.classes))  # points to a column of zeros
        column[self.classes] = torch.arange(len(self.classes))
        self.register_buffer("_column", column, persistent=False)

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, C)`."""
        padded = torch.cat([rows, torch.zeros_like(rows[:, :1])], dim=1)
        return padded[:, self._column].clamp(min=_MIN_PROBABILITY).log()


class Chain(Module):
    r"""A sequence of steps. Each step reads the output of the previous step.

    Args:
        steps (sequence of mappings): Name and arguments of each step.
        step_classes (Mapping): Classes of steps by name.

    Raises:
        ValueError: If a step is unknown, or the sizes of consecutive steps differ.
    """

    def __init__(
        self, steps: Sequence[Mapping[str, Any]], step_classes: Mapping[str, type[Step]]
    ) -> None:
        super().__init__()
        if not isinstance(steps, Sequence) or not steps:
            raise ValueError(f"'steps' must hold at least one step (got {steps!r:.80})")
        built_steps: list[Step] = []
        for description in steps:
            arguments = dict(description)
            name = arguments.pop("step", None)
            if name not in step_classes:
                raise ValueError(
                    f"a step must be one of {', '.join(step_classes)} (got {name!r:.80})"
                )
            built_steps.append(step_classes[name](**arguments))
        self.steps = torch.nn.ModuleList(built_steps)
        self.num_inputs, num_outputs = built_steps[0].num_inputs, built_steps[0].num_outputs
        for step in built_steps[1:]:
            if (
                step.num_inputs is not None
                and num_outputs is not None
                and step.num_inputs != num_outputs
            ):
                raise ValueError(
                    f"{type(step).__name__} must take {num_outputs} numbers (got {step.num_inputs})"
                )
            num_outputs = num_outputs if step.num_outputs is None else step.num_outputs
        self.num_outputs = num_outputs

    def forward(self, rows: Tensor) -> Tensor:
        r"""Returns :math:`(B, O)`."""
        if self.num_inputs is not None and rows.size(1) != self.num_inputs:
            raise ValueError(
                f"each sample must have {self.num_inputs} numbers, as in the fit of the estimator "
                f"(got {rows.size(1)})"
            )
        for step in self.steps:
            rows = step(rows)
        return rows


ROWS: dict[str, type[Step]] = {
    step.__name__: step
    for step in (Affine, Linear, Kernel, Votes, Forest, Constant, Beside, Probability, Logits)
}


def _to_counts(name: str, values: Any) -> list[int]:
    if not isinstance(values, Sequence) or not all(type(v) is int and v >= 0 for v in values):
        raise ValueError(f"'{name}' must hold whole numbers of at least 0 (got {values!r:.80})")
    need(values, f"'{name}' must hold at least one number (got none)")
    return list(values)
