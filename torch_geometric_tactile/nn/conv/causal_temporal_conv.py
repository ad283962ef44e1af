r"""A convolution over time that never looks ahead."""

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.nn import Module, Parameter
from torch_geometric.nn.inits import glorot, zeros

from torch_geometric_tactile.nn._sizes import check_sizes


class CausalTemporalConv(Module):
    r"""A dilated convolution over the frames of each taxel, or of any other sequence, that uses
    only present and past frames.

    .. math::
        \mathbf{x}'_t = \mathbf{b} + \sum_{j=0}^{K-1} \mathbf{W}_j \, \mathbf{x}_{t - (K - 1 - j) D}

    with kernel size :math:`K` and dilation :math:`D`; frames before the first are zero. It is
    :class:`torch.nn.Conv1d` behind zeros on the left, with time before the features, as
    :func:`~torch_geometric_tactile.data.split_frames` gives it.

    :meth:`step` takes one frame at a time and keeps the last :math:`(K - 1) D` in a state, a plain
    tensor. From :meth:`initial_state` on, it gives the numbers of :meth:`forward`.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        kernel_size (int): Frames that are seen :math:`K`.
        dilation (int): Distance of these in frames :math:`D`.
        bias (bool): Whether to add a learnable bias.

    Shapes:
        - **input:** features :math:`(*, T, F_{in})`; of a step :math:`(*, F_{in})` and a state
          :math:`(*, (K - 1) D, F_{in})`
        - **output:** features :math:`(*, T, F_{out})`; of a step :math:`(*, F_{out})` and the next
          state

    Raises:
        ValueError: If a size is below one, or :obj:`x` or :obj:`state` has another shape.

    Examples:
        >>> conv = CausalTemporalConv(3, 8, kernel_size=3, dilation=2)
        >>> conv
        CausalTemporalConv(3, 8, kernel_size=3, dilation=2)
        >>> x = torch.randn(5, 24, 60, 3)
        >>> out, state = conv(x), conv.initial_state(5, 24)
        >>> for t in range(60):
        ...     last, state = conv.step(x[:, :, t], state)
        >>> torch.allclose(last, out[:, :, -1], atol=1e-6)
        True
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_size: int = 3,
        dilation: int = 1,
        bias: bool = True,
    ) -> None:
        super().__init__()
        check_sizes(
            in_channels=in_channels,
            out_channels=out_channels,
            kernel_size=kernel_size,
            dilation=dilation,
        )
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.kernel_size = kernel_size
        self.dilation = dilation
        # That of the present frame last.
        self.weight = Parameter(torch.empty(kernel_size, in_channels, out_channels))
        if bias:
            self.bias = Parameter(torch.empty(out_channels))
        else:
            self.register_parameter("bias", None)
        self.reset_parameters()

    @property
    def num_past(self) -> int:
        r"""How many frames before the present one are seen."""
        return (self.kernel_size - 1) * self.dilation

    def reset_parameters(self) -> None:
        r"""Draws the weights anew and sets the bias to zero."""
        glorot(self.weight.flatten(0, 1))
        zeros(self.bias)

    def forward(self, x: Tensor, *, spacing: int = 1, stride: int = 1) -> Tensor:
        r"""Convolves all frames, or those that are needed.

        An answer at the last frame rests on fewer and fewer frames of the layers before: where each
        dilation is a multiple of the one before, a layer with :obj:`stride` gives them alone, and
        the next takes them with that :obj:`spacing`.

        Args:
            x (torch.Tensor): Features.
            spacing (int): Distance of the given frames, of which the dilation is a multiple.
            stride (int): Distance of the frames to return, in those given, counted back from the
                last.
        """
        if x.dim() < 2 or x.size(-1) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (..., num_frames, {self.in_channels}) (got {tuple(x.shape)})"
            )
        if spacing < 1 or self.dilation % spacing:
            raise ValueError(f"'spacing' must divide the dilation {self.dilation} (got {spacing})")
        if stride < 1:
            raise ValueError(f"'stride' must be at least 1 (got {stride})")
        past = self.num_past // spacing
        starts = range(0, past + 1, self.dilation // spacing)
        return self._product(F.pad(x, (0, 0, past, 0)), starts, x.size(-2), stride)

    def initial_state(
        self,
        *sizes: int,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Tensor:
        r"""Returns the state before the first frame: no frame was seen, all are zero.

        Args:
            *sizes (int): The leading sizes :math:`*`.
            device (torch.device, optional): That of the weights, if left out.
            dtype (torch.dtype, optional): Likewise.
        """
        size = (*sizes, self.num_past, self.in_channels)
        return self.weight.new_zeros(size, device=device, dtype=dtype)

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Convolves the next frame, and returns its features and the state after it.

        Args:
            x (torch.Tensor): Features of one frame.
            state (torch.Tensor): The state before it.
        """
        expected = (*x.shape[:-1], self.num_past, self.in_channels)
        if x.dim() < 1 or x.size(-1) != self.in_channels or state.shape != expected:
            raise ValueError(
                f"'x' and 'state' must have shape (..., {self.in_channels}) and (..., "
                f"{self.num_past}, {self.in_channels}) (got {tuple(x.shape)} and "
                f"{tuple(state.shape)})"
            )
        rows = torch.cat([state, x.unsqueeze(-2)], dim=-2)
        starts = range(0, self.num_past + 1, self.dilation)
        return self._product(rows, starts, 1, 1).squeeze(-2), rows[..., 1:, :]

    def _product(self, rows: Tensor, starts: range, num_frames: int, stride: int) -> Tensor:
        # Of frames behind those that they see; the last of them always.
        first = (num_frames - 1) % stride
        parts = [rows[..., start + first : start + num_frames : stride, :] for start in starts]
        return F.linear(torch.cat(parts, dim=-1), self.weight.flatten(0, 1).t(), self.bias)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"kernel_size={self.kernel_size}, dilation={self.dilation})"
        )
