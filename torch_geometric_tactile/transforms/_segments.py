r"""Segments of taxels, such as fingers, and computations on them."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.sensors._checks import check_segment
from torch_geometric_tactile.transforms._attributes import check_num_taxels


def segment_numbers(
    by: str | Sequence[int] | Tensor, layout: TaxelLayout | PathLike | None, argument: str
) -> Tensor:
    r"""Returns the segment of each taxel. Segments are numbered from zero without gaps, in the
    order of their original numbers.

    Args:
        by (str or sequence of int or torch.Tensor): :obj:`"digit"` or :obj:`"patch"` of the layout,
            or an integer for each taxel.
        layout (TaxelLayout or str or PathLike, optional): The taxels.
        argument (str): Name of the argument in messages.

    Shapes:
        - **output:** segment numbers :math:`(N,)`

    Raises:
        ValueError: If a name is given without a layout, or the number of taxels differs.
    """
    layout = None if layout is None else as_layout(layout)
    if isinstance(by, str):
        if layout is None:
            raise ValueError(f"'{argument}' requires a 'layout' if it is a name (got '{by}')")
        numbers = layout.segments(by)  # type: ignore[arg-type]
    else:
        requirement = f"'{argument}', if neither 'digit' nor 'patch',"
        numbers = check_segment(torch.as_tensor(by).cpu(), what=requirement, gaps=True)
        if layout is not None and len(numbers) != layout.num_taxels:
            raise ValueError(
                f"'{argument}' must have {layout.num_taxels} numbers, one for each taxel of layout "
                f"'{layout.name}' (got {len(numbers)})"
            )
    return numbers.unique(return_inverse=True)[1]


def samples_of_rows(data: Data, x: Tensor) -> tuple[Tensor, int]:
    r"""Returns the sample of each row of readings, and the number of samples.

    Shapes:
        - **x:** The readings :math:`(N, F)` or :math:`(B, N, F)`.
    """
    if isinstance(data, Batch):
        return data.batch, data.num_graphs
    num_samples = x.shape[:-2].numel()
    return repeat_rows(torch.arange(num_samples, device=x.device), x.size(-2)), num_samples


def repeat_rows(rows: Tensor, times: int) -> Tensor:
    r"""Repeats each row :obj:`times` times, one directly after another.

    ``rows.repeat_interleave(times, dim=0)`` returns the same, but PyTorch 2.8 exports it to ONNX
    with wrong numbers or a wrong shape.

    Shapes:
        - **rows:** :math:`(R, *)`
        - **output:** :math:`(R \cdot times, *)`
    """
    return rows.unsqueeze(1).expand(-1, times, *rows.shape[1:]).flatten(0, 1)


def segment_means(rows: Tensor, segment: Tensor, count: int) -> Tensor:
    r"""Returns the mean of each segment without missing readings; zero for a segment without
    readings.

    Args:
        rows (torch.Tensor): The readings in double precision :math:`(R, F)`.
        segment (torch.Tensor): The segment of each row :math:`(R,)`.
        count (int): Number of segments.

    Shapes:
        - **output:** :math:`(count, F)`
    """
    is_valid, shape = ~rows.isnan(), (count, rows.size(1))
    total = rows.new_zeros(shape).index_add_(0, segment, torch.where(is_valid, rows, 0.0))
    num_valid = rows.new_zeros(shape).index_add_(0, segment, is_valid.double())
    return total / num_valid.clamp(min=1)


class Segments:
    r"""The segments of each sample on which a transform works.

    Args:
        segments (str or sequence of int or torch.Tensor, optional): :obj:`"digit"` or
            :obj:`"patch"` of the layout, or an integer for each taxel; if left out, each sample is
            one segment.
        layout (TaxelLayout or str or PathLike, optional): The taxels.
    """

    def __init__(
        self,
        segments: str | Sequence[int] | Tensor | None,
        layout: TaxelLayout | PathLike | None,
    ) -> None:
        self.layout = layout
        self.by = segments if isinstance(segments, str) or segments is None else "numbers"
        self.segment: Tensor | None = None  # (N,), from zero without gaps
        self.num_segments = 1
        if segments is not None:
            self.segment = segment_numbers(segments, layout, "segments")
            self.num_segments = int(self.segment.max()) + 1

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor, in which segments are numbered from zero."""
        return {
            "segments": self.segment if self.by == "numbers" else self.by,
            "layout": self.layout,
        }

    def row_segments(self, data: Data, x: Tensor) -> tuple[Tensor, int]:
        r"""Returns the segment of each row of the readings, and the number of segments of all
        samples. The segments of each sample continue the numbers of the previous sample.

        Args:
            data (torch_geometric.data.Data): The samples.
            x (torch.Tensor): Their readings :math:`(N, F)` or :math:`(B, N, F)`.
        """
        sample, num_samples = samples_of_rows(data, x)
        if self.segment is None:
            return sample, num_samples
        check_num_taxels(data, len(self.segment), "its segments")
        segment = self.segment.to(x.device).repeat(num_samples)
        return segment + self.num_segments * sample, self.num_segments * num_samples

    def __repr__(self) -> str:
        by = repr(self.by) if self.by != "numbers" else self.by
        return "" if self.segment is None else f"{by}, num_segments={self.num_segments}"
