r"""Samples whose readings are images of 32 x 32 pixels."""

from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile.data.static_data import StaticData

ROWS = COLUMNS = 32


def image_of(x: Tensor) -> Tensor:
    r"""Reshapes the readings of a 32 x 32 grid, such as
    :func:`~torch_geometric_tactile.sensors.letter_array`, to images without a copy.

    Args:
        x (torch.Tensor): The readings, row by row.

    Shapes:
        - **input:** readings :math:`(1024, F)`, :math:`(B, 1024, F)`, or :math:`(B \cdot 1024, F)`
          of a PyG batch
        - **output:** a view of the readings :math:`(B, F, 32, 32)`, with :math:`B = 1` for a single
          sample

    Raises:
        ValueError: If the number of taxels is not 1024.

    Examples:
        >>> import torch
        >>> x = torch.zeros(5, 1024, 1)
        >>> image_of(x).shape, image_of(x).data_ptr() == x.data_ptr()
        (torch.Size([5, 1, 32, 32]), True)
    """
    num_taxels = ROWS * COLUMNS
    num_rows = x.size(-2) if x.dim() > 1 else 0
    if x.dim() not in (2, 3) or num_rows % num_taxels or (x.dim() == 3 and num_rows != num_taxels):
        raise ValueError(
            f"'x' must have {num_taxels} taxels in each sample (got shape {tuple(x.shape)})"
        )
    shape = (-1, ROWS, COLUMNS) if x.dim() == 2 else (ROWS, COLUMNS)
    return x.unflatten(-2, shape).movedim(-1, 1)


class _ImageMixin:
    x: Tensor

    @property
    def image(self) -> Tensor:
        r"""The readings as images :math:`(B, F, 32, 32)`, a view of :obj:`x` (see
        :func:`image_of`).
        """
        return image_of(self.x)


class ImageData(_ImageMixin, Data):
    r"""A sample, or a PyG batch of samples, of a 32 x 32 pressure array. Its :obj:`image` is a view
    of the readings :obj:`x` as an image.

    Examples:
        >>> import torch
        >>> data = ImageData(x=torch.zeros(1024, 1))
        >>> data.image.shape
        torch.Size([1, 1, 32, 32])
    """


class StaticImages(_ImageMixin, StaticData):
    r"""A batch of samples on one topology. Its :obj:`image` is a view of the readings :obj:`x` as
    images, and each sample is an :class:`ImageData`. The images are not stored: they always show
    the present :obj:`x`, also after transforms and selections, and take no space in files and
    batches.

    Examples:
        >>> import torch
        >>> data = StaticImages(x=torch.zeros(5, 1024, 1))
        >>> data.image.shape, data[0].image.shape, data.to_batch().image.shape
        (torch.Size([5, 1, 32, 32]), torch.Size([1, 1, 32, 32]), torch.Size([5, 1, 32, 32]))
    """

    sample_type = ImageData
