r"""The segments that a transform works on."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout, as_layout, check_segment
from torch_geometric_tactile.typing import PathLike


def segment_numbers(
    by: str | Sequence[int] | Tensor, layout: TaxelLayout | PathLike | None, argument: str
) -> Tensor:
    r"""Returns the segment of each taxel, numbered from zero without gaps, in ascending order.

    Args:
        by (str or sequence of int): :obj:`"digit"` or :obj:`"patch"` of the layout, or a whole
            number for each taxel.
        layout (TaxelLayout or str or PathLike, optional): The taxels.
        argument (str): The name of the argument :obj:`by`, for messages.

    Shapes:
        - **output:** segment numbers :math:`(N,)`

    Raises:
        ValueError: If it is none of these, or comes without a layout that it needs.
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
