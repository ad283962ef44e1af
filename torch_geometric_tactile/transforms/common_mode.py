r"""Subtraction of the mean reading of a segment."""

from collections.abc import Sequence
from typing import Any

from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import require_x
from torch_geometric_tactile.transforms._segments import Segments, segment_means
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("common_mode")
class CommonMode(TactileTransform):
    r"""Subtracts the mean over the taxels of each segment, in each sample and channel (functional
    name: :obj:`common_mode`).

    .. math::
        x'_i = x_i - \frac{1}{|S_i|} \sum_{j \in S_i} x_j

    Here :math:`S_i` are the taxels in the segment of taxel :math:`i` whose readings are not
    missing.

    Use it to remove the offset of a finger caused by temperature, static fluid pressure or a new
    day. It needs no fit, no readings at rest and no sessions. Apply it to raw counts, before
    scalers: after each taxel is scaled separately, the taxels no longer share an offset.

    It also removes the mean pressure on a segment. If the label depends on the mean pressure (as
    weight and grip force do), subtract the readings at rest instead with
    :class:`~torch_geometric_tactile.transforms.Tare`.

    Args:
        segments (str or sequence of int, optional): The segments: :obj:`"digit"` or :obj:`"patch"`
            of the layout, or an integer for each taxel :math:`(N,)`. If left out, all taxels of a
            sample are one segment; this is also the choice if each finger is a channel.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of a
            layout of this package, or a layout file; required for :obj:`"digit"` and
            :obj:`"patch"`.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape, in the same unit. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If :obj:`segments` is invalid or requires a layout, or a sample has the wrong
            number of taxels or no readings.

    Examples:
        >>> import torch
        >>> x = torch.tensor([[11.0], [13.0], [50.0]])
        >>> CommonMode([0, 0, 1])(Data(x=x)).x.view(-1)
        tensor([-1.,  1.,  0.])
    """

    reads = writes = ("x",)
    per_frame = True

    def __init__(
        self,
        segments: str | Sequence[int] | Tensor | None = None,
        layout: TaxelLayout | PathLike | None = None,
    ) -> None:
        self._segments = Segments(segments, layout)

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor, in which segments are numbered from zero."""
        return self._segments.arguments()

    def forward(self, data: Data) -> Data:
        r"""Subtracts the means."""
        x = require_x(self, data)
        # Sums of counts are exact in double precision, so results do not depend on batching.
        rows = x.reshape(-1, x.size(-1)).double()
        segment, count = self._segments.row_segments(data, x)
        mean = segment_means(rows, segment, count)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        data.x = (rows - mean[segment]).to(x).reshape(x.shape)
        return data

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._segments!r})"
