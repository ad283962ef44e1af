r"""Random mirroring of the images of taxels."""

from typing import Literal

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import FRAMES, check_num_taxels, require_x
from torch_geometric_tactile.transforms._image_map import require_map, taxels_at
from torch_geometric_tactile.transforms._random import check_generator, check_probability, uniform
from torch_geometric_tactile.transforms._windows import num_channels_and_frames, repeat_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_ALONG = ("columns", "rows")


@functional_transform("random_mirror")
class RandomMirror(TactileTransform):
    r"""Mirrors the taxel images of randomly drawn samples (functional name: :obj:`random_mirror`):
    opposite taxels on the image map of the layout swap their readings. Use this augmentation in a
    :obj:`train_transform`.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels, with an image map: a layout, the name
            of a layout of this package, or a layout file.
        p (float): Probability with which each sample is mirrored.
        along (str): :obj:`"columns"` reverses the order of the columns (left becomes right),
            :obj:`"rows"` the order of the rows (up becomes down).
        negate (int, optional): The channel whose sign changes, which should be the shear along the
            mirrored axis. On :func:`~torch_geometric_tactile.sensors.grid`, this is channel 0 for
            columns and channel 1 for rows. Requires tared readings and a scaler that preserves
            zero. In windows, all frames of the channel change their sign.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If the layout has no symmetric image map, :obj:`p` is not a probability,
            :obj:`along` is unknown, or a sample has the wrong number of taxels, no readings or no
            such channel.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> transform = RandomMirror(grid(1, 3, 0.01), p=1.0)
        >>> transform(Data(x=torch.tensor([[1.0], [2.0], [3.0]]))).x.view(-1)
        tensor([3., 2., 1.])
    """

    reads, writes = ("x", *FRAMES), ("x",)
    per_frame = False  # all frames of a window are mirrored, or none
    is_random = True

    def __init__(
        self,
        layout: TaxelLayout | PathLike,
        p: float = 0.5,
        along: Literal["columns", "rows"] = "columns",
        negate: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        need(along in _ALONG, f"'along' must be one of {list(_ALONG)} (got {along!r})")
        if negate is not None and (isinstance(negate, bool) or negate < 0):
            raise ValueError(f"'negate' must be a channel, numbered from 0 (got {negate})")
        self.layout, image_map = require_map(self, layout)
        self.p = check_probability(p)
        self.along = along
        self.negate = negate
        self.generator = check_generator(generator)
        dim = 1 if along == "columns" else 0
        # The image map may begin at any row and column, so its two ends are swapped.
        cells = image_map.clone()
        cells[:, dim] = image_map[:, dim].min() + image_map[:, dim].max() - image_map[:, dim]
        self._opposite: Tensor = taxels_at(image_map, cells)
        if (self._opposite < 0).any():
            taxel = int((self._opposite < 0).nonzero()[0])
            raise ValueError(
                f"the image map of layout '{self.layout.name}' must be symmetric along its {along} "
                f"(got no taxel opposite to taxel {taxel})"
            )

    def forward(self, data: Data) -> Data:
        r"""Mirrors the readings of the drawn samples."""
        x = require_x(self, data)
        num_taxels = self.layout.num_taxels
        check_num_taxels(data, num_taxels, f"layout '{self.layout.name}'")
        rows = x.reshape(-1, num_taxels, x.size(-1))
        mirrored = rows[:, self._opposite.to(x.device)]
        if self.negate is not None:
            mirrored = mirrored * self._signs(data, x)
        is_mirrored = uniform(len(rows), x, self.generator) < self.p
        data.x = torch.where(is_mirrored.view(-1, 1, 1), mirrored, rows).reshape(x.shape)
        return data

    def _signs(self, data: Data, x: Tensor) -> Tensor:
        num_channels, num_frames = num_channels_and_frames(data, x)
        if self.negate is not None and self.negate >= num_channels:
            raise ValueError(
                f"'negate' must be below the number of channels, {num_channels} (got {self.negate})"
            )
        sign = torch.ones(1, num_channels, dtype=x.dtype, device=x.device)
        sign[0, self.negate] = -1
        return repeat_frames(sign, num_frames)

    def __repr__(self) -> str:
        negate = "" if self.negate is None else f", negate={self.negate}"
        return (
            f"{type(self).__name__}('{self.layout.name}', p={self.p}, along='{self.along}'{negate})"
        )
