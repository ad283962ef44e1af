r"""Readings relative to those of their neighbours in the same moment."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import check_num_taxels, require_x
from torch_geometric_tactile.transforms._segments import segment_numbers
from torch_geometric_tactile.typing import PathLike


@functional_transform("common_mode")
class CommonMode(BaseTransform):
    r"""Subtracts what all taxels of a segment have in common: in each sample and channel, their
    mean (functional name: :obj:`common_mode`).

    .. math::
        x'_i = x_i - \frac{1}{|S_i|} \sum_{j \in S_i} x_j

    with the taxels :math:`S_i` of the segment of taxel :math:`i` whose reading is not missing. It
    needs no fit, no rest reading and no session: an offset of a whole finger, such as that of
    temperature, of static fluid pressure, or of another day, is gone within the one reading. It
    belongs in front of the scalers, on raw counts: taxels that were scaled one by one have no mean
    in common any more.

    It destroys what a segment feels as a whole: a pressure that is the same on all of its taxels,
    and how strong the mean touch is. Where that is the answer (weight, grip force), subtract rest
    readings instead (:class:`~torch_geometric_tactile.transforms.Tare`).

    Args:
        segments (str or sequence of int, optional): What a segment is, :obj:`"digit"` or
            :obj:`"patch"` of the layout, or a whole number for each taxel :math:`(N,)`; all taxels
            of a sample if left out. Where each finger is a channel, that is each finger.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of one
            that comes with the package, or a layout file; needed for :obj:`"digit"` and
            :obj:`"patch"`.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape, in the same unit. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If :obj:`segments` is none of these or comes without a layout that it needs, or
            a sample has another number of taxels or no readings.

    Examples:
        >>> x = torch.tensor([[11.0], [13.0], [50.0]])
        >>> CommonMode([0, 0, 1])(Data(x=x)).x.view(-1)
        tensor([-1.,  1.,  0.])
    """

    supports_static = True

    def __init__(
        self,
        segments: str | Sequence[int] | Tensor | None = None,
        layout: TaxelLayout | PathLike | None = None,
    ) -> None:
        self.layout = layout
        self.segments = segments if isinstance(segments, str) or segments is None else "numbers"
        self.segment: Tensor | None = None  # (N,), from zero without gaps
        self.num_segments = 1
        if segments is not None:
            self.segment = segment_numbers(segments, layout, "segments")
            self.num_segments = int(self.segment.max()) + 1

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor; segments that were given are numbered anew."""
        segments = self.segment if self.segments == "numbers" else self.segments
        return {"segments": segments, "layout": self.layout}

    def forward(self, data: Data) -> Data:
        r"""Subtracts the means."""
        x = require_x(self, data)
        if self.segment is not None:
            check_num_taxels(data, len(self.segment), "the common mode has")
        rows = x.reshape(-1, x.size(-1)).double()  # sums of counts are exact, in any order
        segment, count = self._of_rows(data, x)
        valid = ~rows.isnan()
        shape = count, rows.size(1)
        total = rows.new_zeros(shape).index_add_(0, segment, torch.where(valid, rows, 0.0))
        num_valid = rows.new_zeros(shape).index_add_(0, segment, valid.double())
        mean = total / num_valid.clamp(min=1)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        data.x = (rows - mean[segment]).to(x).reshape(x.shape)
        return data

    def _of_rows(self, data: Data, x: Tensor) -> tuple[Tensor, int]:
        # The segment of each row, numbered on from sample to sample, and the number of segments.
        if isinstance(data, Batch):
            sample, num_samples = data.batch, data.num_graphs
        else:
            num_samples = x.shape[:-2].numel()
            sample = torch.arange(num_samples, device=x.device).repeat_interleave(x.size(-2))
        if self.segment is None:
            return sample, num_samples
        segment = self.segment.to(x.device).repeat(num_samples)
        return segment + self.num_segments * sample, self.num_segments * num_samples

    def __repr__(self) -> str:
        if self.segment is None:
            return f"{type(self).__name__}()"
        by = self.segments if self.segments == "numbers" else f"'{self.segments}'"
        return f"{type(self).__name__}({by}, num_segments={self.num_segments})"
