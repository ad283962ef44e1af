r"""The segments that a transform works on."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, check_segment
from torch_geometric_tactile.transforms._attributes import check_num_taxels


def segment_numbers(
    by: str | Sequence[int] | Tensor, layout: TaxelLayout | PathLike | None, argument: str
) -> Tensor:
    r"""Returns the segment of each taxel, numbered from zero without gaps, in ascending order.

    Shapes:
        - **output:** segment numbers :math:`(N,)`
    """
    layout = None if layout is None else as_layout(layout)
    if isinstance(by, str):
        if layout is None:
            raise ValueError(f"'{argument}' must come with a layout if it is a name (got '{by}')")
        numbers = layout.segments(by)  # type: ignore[arg-type]
    else:
        what = f"'{argument}', if neither 'digit' nor 'patch',"
        numbers = check_segment(torch.as_tensor(by).cpu(), what=what, gaps=True)
        if layout is not None and len(numbers) != layout.num_taxels:
            raise ValueError(
                f"'{argument}' must have {layout.num_taxels} numbers, as layout '{layout.name}' "
                f"has taxels (got {len(numbers)})"
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
    r"""Returns each row :obj:`times` times, one after another.

    ``rows.repeat_interleave(times, dim=0)`` is the same, but PyTorch 2.8 exports it to ONNX with
    other numbers or another shape.

    Shapes:
        - **rows:** :math:`(R, *)`
        - **output:** :math:`(R \cdot times, *)`
    """
    return rows.unsqueeze(1).expand(-1, times, *rows.shape[1:]).flatten(0, 1)


def segment_means(rows: Tensor, segment: Tensor, count: int) -> Tensor:
    r"""Returns the mean of each segment without missing readings, zero where there is none.

    Shapes:
        - **rows:** The readings, in double :math:`(R, F)`.
        - **output:** :math:`(count, F)`
    """
    valid, shape = ~rows.isnan(), (count, rows.size(1))
    total = rows.new_zeros(shape).index_add_(0, segment, torch.where(valid, rows, 0.0))
    num_valid = rows.new_zeros(shape).index_add_(0, segment, valid.double())
    return total / num_valid.clamp(min=1)


class Segments:
    r"""The segments that a transform works on: some of each sample, or each sample whole."""

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
        r"""Returns what the segments were made with; numbers that were given are counted anew."""
        return {
            "segments": self.segment if self.by == "numbers" else self.by,
            "layout": self.layout,
        }

    def of_rows(self, data: Data, x: Tensor) -> tuple[Tensor, int]:
        r"""Returns the segment of each row of the readings, numbered on from sample to sample, and
        the number of segments of all samples.

        Shapes:
            - **x:** Their readings :math:`(N, F)` or :math:`(B, N, F)`.
        """
        sample, num_samples = samples_of_rows(data, x)
        if self.segment is None:
            return sample, num_samples
        check_num_taxels(data, len(self.segment), "its segments have")
        segment = self.segment.to(x.device).repeat(num_samples)
        return segment + self.num_segments * sample, self.num_segments * num_samples

    def __repr__(self) -> str:
        by = repr(self.by) if self.by != "numbers" else self.by
        return "" if self.segment is None else f"{by}, num_segments={self.num_segments}"
