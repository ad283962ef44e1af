r"""The average of several models."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module, ModuleList

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.nn.models._calls import input_names, needs_edges, takes_batch


class AverageModel(Module):
    r"""A model that averages the predictions of several models for the same task. For classes, the
    probabilities are averaged and their logarithms are returned. For a regression, the numbers are
    averaged; if the models were trained on scaled numbers, the mean is converted back to the
    original unit.

    Args:
        models (sequence of torch.nn.Module): The models, which must have the same inputs.
        numbers (bool): Whether the models predict numbers instead of classes.
        center (torch.Tensor, optional): Offset that is added to numbers after scaling
            :math:`(C,)`.
        scale (torch.Tensor, optional): Factor by which numbers are multiplied :math:`(C,)`.

    Shapes:
        - **x:** prepared readings :math:`(B, N, F)`
        - **output:** logarithms of probabilities, or numbers :math:`(B, C)`

    Raises:
        ValueError: If there are no models, or the inputs of the models differ.

    Examples:
        >>> from torch_geometric_tactile.nn.models import TactileFNN
        >>> model = AverageModel([TactileFNN(4, 2), TactileFNN(4, 2)]).eval()
        >>> model(torch.rand(5, 4, 3)).shape
        torch.Size([5, 2])
    """

    _center: Tensor | None
    _scale: Tensor | None

    def __init__(
        self,
        models: Sequence[Module],
        numbers: bool = False,
        center: Tensor | None = None,
        scale: Tensor | None = None,
    ) -> None:
        super().__init__()
        if not models or not all(isinstance(model, Module) for model in models):
            raise ValueError(f"'models' must hold at least one model (got {models!r:.80})")
        self.models = ModuleList(models)
        self.modalities: tuple[str, ...] = input_names(models[0])
        self.needs_edges = needs_edges(models[0])
        self.takes_batch = takes_batch(models[0])
        for model in models[1:]:
            names = input_names(model)
            need(names == self.modalities, f"'models' must all read {self.modalities}", names)
        self.numbers = bool(numbers)
        for name, value in (("center", center), ("scale", scale)):
            if value is not None and (not isinstance(value, Tensor) or value.dim() > 1):
                raise ValueError(f"'{name}' must have a number per output (got {value!r:.80})")
            # These buffers are not persistent: they are saved with `init_arguments`.
            self.register_buffer(f"_{name}", value, persistent=False)
        self.init_arguments = {
            "models": list(models),
            "numbers": self.numbers,
            "center": center,
            "scale": scale,
        }

    def forward(self, x: Tensor, edge_index: Tensor | None = None, **attributes: Any) -> Tensor:
        r"""Returns logarithms of probabilities :math:`(B, C)`, or numbers.

        Args:
            x (torch.Tensor): Prepared readings :math:`(B, N, F)`.
            edge_index (torch.Tensor, optional): Edges :math:`(2, |\mathcal{E}|)`.
            **attributes (optional): The attributes listed in :obj:`modalities`, and :obj:`batch` if
                the models have this argument.
        """
        outputs = torch.stack([model(x, edge_index, **attributes) for model in self.models])
        if not self.numbers:
            # The mean of the probabilities is computed from logarithms to avoid underflow.
            return outputs.log_softmax(dim=-1).logsumexp(dim=0) - math.log(len(self.models))
        mean = outputs.double().mean(dim=0)
        if self._scale is not None:
            mean = mean * self._scale
        return (mean if self._center is None else mean + self._center).to(outputs.dtype)
