r"""LSTMs for grasp stability."""

from typing import Optional

import torch
from torch import Tensor
from torch.nn import Linear, Module, Parameter
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxels import LayoutLike, count_taxels, stacked_readings


class _LSTMCells(Module):
    r"""The layers of a :class:`torch.nn.LSTM` with :obj:`batch_first=True`. The weights have the
    same names. Unlike :class:`torch.nn.LSTM`, this module can be compiled by :func:`torch.compile`.
    """

    def __init__(self, in_channels: int, hidden_channels: int, num_layers: int = 1) -> None:
        super().__init__()
        self.hidden_channels = hidden_channels
        self.num_layers = num_layers
        rows = 4 * hidden_channels
        for i in range(num_layers):
            width = hidden_channels if i else in_channels
            self.register_parameter(f"weight_ih_l{i}", Parameter(torch.empty(rows, width)))
            self.register_parameter(
                f"weight_hh_l{i}", Parameter(torch.empty(rows, hidden_channels))
            )
            self.register_parameter(f"bias_ih_l{i}", Parameter(torch.empty(rows)))
            self.register_parameter(f"bias_hh_l{i}", Parameter(torch.empty(rows)))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters in the same way as :class:`torch.nn.LSTM`."""
        bound = self.hidden_channels**-0.5
        for weight in self.parameters():
            torch.nn.init.uniform_(weight, -bound, bound)

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the hidden state of the last layer at each frame :math:`(B, T, H)`.

        Args:
            x (torch.Tensor): Features of the frames :math:`(B, T, F)`.
        """
        zeros = x.new_zeros(self.num_layers, x.size(0), self.hidden_channels)
        weights: list[Tensor] = list(self.parameters())
        if torch.compiler.is_compiling():
            # If the input needs no gradient, PyTorch compiles to a oneDNN layer, which does not
            # compute gradients of the weights. Adding zero times a weight makes the input need a
            # gradient.
            x = x + 0 * weights[0][0, 0]
        out, _, _ = torch.lstm(
            x, (zeros, zeros), weights, True, self.num_layers, 0.0, self.training, False, True
        )
        return out


class GraspLSTM(BaseModel):
    r"""The LSTM-L, -M, -R and -F from the "Tactile Grasp Stability Classification Based on Graph
    Convolutional Networks" paper (:doc:`P3 </papers>`). These models have one LSTM layer with 128
    cells, and one fully connected layer on the hidden state of the last frame. The input is the
    signals of all electrodes, either of one finger (L, M, R) or of all fingers (F).

    No graph is used. The input of a frame consists of its readings, sorted by electrode and then by
    finger. The outputs are logits. For two classes, their softmax equals the paper's sigmoid of the
    difference.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout of one finger, the name of a stock
            layout, the path of a layout file, or the number of electrodes :math:`N`.
        out_channels (int): Number of classes :math:`C`.
        num_fingers (int): Number of fingers :math:`K`, whose signals are concatenated.
        finger (int, optional): Index of the finger to use. By default, all fingers are used.
        hidden_channels (int): Number of LSTM cells.
        num_layers (int): Number of LSTM layers (one in the paper).

    Shapes:
        - **input:** windows of any number of frames :math:`T`: :math:`(N, K \cdot T)`,
          :math:`(B, N, K \cdot T)` or, for a PyG batch, :math:`(B \cdot N, K \cdot T)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`finger` is out of range, a size is below one, or :obj:`x` has the wrong
            number of electrodes or a number of columns that is not a multiple of :math:`K`.

    Examples:
        >>> model = GraspLSTM("biotac", 2)
        >>> model
        GraspLSTM(19, 2, num_fingers=3, hidden_channels=128)
        >>> model(torch.zeros(5, 19, 3 * 60)).shape
        torch.Size([5, 2])
    """

    needs_edges = False

    def __init__(
        self,
        layout: LayoutLike = "biotac",
        out_channels: int = 2,
        *,
        num_fingers: int = 3,
        finger: Optional[int] = None,
        hidden_channels: int = 128,
        num_layers: int = 1,
    ) -> None:
        super().__init__()
        self.num_nodes = count_taxels(layout)
        check_sizes(
            out_channels=out_channels,
            num_fingers=num_fingers,
            hidden_channels=hidden_channels,
            num_layers=num_layers,
        )
        need(
            finger is None or 0 <= finger < num_fingers,
            f"'finger' must be between 0 and {num_fingers - 1}",
            finger,
        )
        self.out_channels = out_channels
        self.num_fingers = num_fingers
        self.finger = finger
        self.hidden_channels = hidden_channels
        self.num_layers = num_layers
        width = self.num_nodes * (num_fingers if finger is None else 1)
        self.lstm = _LSTMCells(width, hidden_channels, num_layers)
        self.lin = Linear(hidden_channels, out_channels)

    def _logits(self, x: Tensor, **unused: OptTensor) -> Tensor:
        size = x.size(-1) if x.dim() else 0
        if size == 0 or size % self.num_fingers:
            raise ValueError(
                f"'x' must have the same number of frames for each of {self.num_fingers} fingers "
                f"(got shape {tuple(x.shape)})"
            )
        x = stacked_readings(x, self.num_nodes, size, "fingers x frames")
        frames = split_frames(x, size // self.num_fingers)  # (B, N, T, K)
        if self.finger is not None:
            frames = frames.narrow(-1, self.finger, 1)
        hidden = self.lstm(frames.transpose(1, 2).flatten(2))
        return self.lin(hidden[:, -1])

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        finger = "" if self.finger is None else f", finger={self.finger}"
        layers = f", num_layers={self.num_layers}" if self.num_layers > 1 else ""
        return (
            f"{self.num_nodes}, {self.out_channels}, num_fingers={self.num_fingers}{finger}, "
            f"hidden_channels={self.hidden_channels}{layers}"
        )
