r"""A causal convolution over the frames of time series."""

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.nn import Module, Parameter
from torch_geometric.nn.inits import glorot, zeros

from torch_geometric_tactile.nn._sizes import check_sizes


class CausalTemporalConv(Module):
    r"""A dilated convolution over the frames of each taxel, or of any other sequence, that uses
    only the current frame and past frames.

    .. math::
        \mathbf{x}'_t = \mathbf{b} + \sum_{j=0}^{K-1} \mathbf{W}_j \, \mathbf{x}_{t - (K - 1 - j) D}

    with kernel size :math:`K` and dilation :math:`D`. Frames before the first frame are zero. The
    layer is equivalent to :class:`torch.nn.Conv1d` with zero padding on the left, except that time
    comes before the features, as in the output of
    :func:`~torch_geometric_tactile.data.split_frames`.

    :meth:`step` processes one frame at a time. Its state is a tensor with the last
    :math:`(K - 1) D` frames. Starting from :meth:`initial_state`, it returns the same features as
    :meth:`forward`.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        kernel_size (int): Number of frames in the kernel :math:`K`.
        dilation (int): Distance between the frames of the kernel :math:`D`.
        bias (bool): Whether to add a learnable bias.

    Shapes:
        - **input:** features :math:`(*, T, F_{in})`; for :meth:`step`, features
          :math:`(*, F_{in})` and a state :math:`(*, (K - 1) D, F_{in})`
        - **output:** features :math:`(*, T, F_{out})`; for :meth:`step`, features
          :math:`(*, F_{out})` and the next state

    Raises:
        ValueError: If a size is below one, or :obj:`x` or :obj:`state` has the wrong shape.

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
        # The last weight is for the current frame.
        self.weight = Parameter(torch.empty(kernel_size, in_channels, out_channels))
        if bias:
            self.bias = Parameter(torch.empty(out_channels))
        else:
            self.register_parameter("bias", None)
        self.reset_parameters()

    @property
    def num_past(self) -> int:
        r"""Number of past frames in the receptive field."""
        return (self.kernel_size - 1) * self.dilation

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        glorot(self.weight.flatten(0, 1))
        zeros(self.bias)

    def forward(self, x: Tensor, *, spacing: int = 1, stride: int = 1) -> Tensor:
        r"""Returns the features after the convolution, for all frames or for every :obj:`stride`-th
        frame.

        In a stack of layers, the output at the last frame depends on only some frames of the
        earlier layers. If each dilation is a multiple of the previous dilation, a layer can compute
        only these frames with :obj:`stride`. The next layer must then be called with :obj:`spacing`
        set to the same number.

        Args:
            x (torch.Tensor): Features.
            spacing (int): Distance between the input frames. It must divide the dilation.
            stride (int): Distance between the output frames in input frames, counted backwards from
                the last frame.
        """
        if x.dim() < 2 or x.size(-1) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (..., num_frames, {self.in_channels}) (got {tuple(x.shape)})"
            )
        if spacing < 1 or self.dilation % spacing:
            raise ValueError(f"'spacing' must divide the dilation {self.dilation} (got {spacing})")
        if stride < 1:
            raise ValueError(f"'stride' must be at least 1 (got {stride})")
        num_past = self.num_past // spacing
        starts = range(0, num_past + 1, self.dilation // spacing)
        return self._product(F.pad(x, (0, 0, num_past, 0)), starts, x.size(-2), stride)

    def initial_state(
        self,
        *sizes: int,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> Tensor:
        r"""Returns the state before the first frame, which is a tensor of zeros.

        Args:
            *sizes (int): Leading sizes :math:`*`.
            device (torch.device, optional): Device of the state. Defaults to the device of the
                weights.
            dtype (torch.dtype, optional): Data type of the state. Defaults to the data type of the
                weights.
        """
        size = (*sizes, self.num_past, self.in_channels)
        return self.weight.new_zeros(size, device=device, dtype=dtype)

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Returns the features of the next frame after the convolution, and the next state.

        Args:
            x (torch.Tensor): Features of the frame.
            state (torch.Tensor): State before the frame.
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
        # `rows` holds the past frames, followed by `num_frames` frames. The output is computed for
        # the last frame and every `stride`-th frame before it. `starts` holds the offsets of the
        # kernel's frames.
        first = (num_frames - 1) % stride
        slices = [rows[..., start + first : start + num_frames : stride, :] for start in starts]
        return F.linear(torch.cat(slices, dim=-1), self.weight.flatten(0, 1).t(), self.bias)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"kernel_size={self.kernel_size}, dilation={self.dilation})"
        )
