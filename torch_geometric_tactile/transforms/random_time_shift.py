r"""Random shifts of readings in time."""

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import FRAMES
from torch_geometric_tactile.transforms._random import (
    RandomTransform,
    check_generator,
    check_integer,
    uniform,
)
from torch_geometric_tactile.transforms._segments import samples_of_rows
from torch_geometric_tactile.transforms._windows import get_num_frames, refuse_ragged

_MAX_STEPS = 100_000


@functional_transform("random_time_shift")
class RandomTimeShift(RandomTransform):
    r"""Shifts all taxels of a sample in time by the same random number of frames (functional name:
    :obj:`random_time_shift`). The first or last frame is repeated to fill the gap. Use this
    augmentation in a :obj:`train_transform`.

    The features of a taxel are the frames of its first channel, then the frames of its second
    channel, and so on.

    Args:
        steps (int): The largest shift in frames, earlier or later. All shifts are equally likely.
        num_frames (int, optional): Number of frames :math:`T`; the number of features must be a
            multiple of it. The default is the number of frames of windows; in other samples, all
            features are frames of one channel.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or a PyG batch
          :math:`(B \cdot N, C \cdot T)`
        - **output:** the same shape. Missing readings (NaN) are shifted as well.

    Raises:
        ValueError: If :obj:`steps` is not between 0 and 100,000, :obj:`num_frames` is below one or
            differs from the windows, the number of features is not a multiple of it, windows are
            padded, or there are no readings.

    Examples:
        >>> RandomTimeShift(0)(Data(x=torch.tensor([[1.0, 2.0, 3.0]]))).x
        tensor([[1., 2., 3.]])
        >>> RandomTimeShift(1, num_frames=2)
        RandomTimeShift(steps=1, num_frames=2)
    """

    reads = ("x", *FRAMES)

    def __init__(
        self,
        steps: int = 1,
        num_frames: int | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        self.steps = check_integer("steps", steps, 0, _MAX_STEPS)
        if num_frames is not None:
            num_frames = check_integer("num_frames", num_frames, 1, _MAX_STEPS)
        self.num_frames = num_frames
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the shifted readings."""
        num_frames = self._num_frames(data, x)
        if num_frames and x.size(-1) % num_frames:
            raise ValueError(
                f"'x' must have a multiple of {num_frames} features, the number of frames (got "
                f"{x.size(-1)})"
            )
        sample, count = samples_of_rows(data, x)
        draws = uniform(count, x, self.generator)
        # The product may be rounded up to one step too many.
        steps = (draws * (2 * self.steps + 1)).long().clamp(max=2 * self.steps) - self.steps
        if x.numel() == 0:
            return x
        source = torch.arange(num_frames, device=x.device) - steps[sample].unsqueeze(1)
        rows = x.reshape(len(sample), -1, num_frames)
        source = source.clamp(0, num_frames - 1).unsqueeze(1).expand_as(rows)
        return rows.gather(2, source).reshape(x.shape)

    def _num_frames(self, data: Data, x: Tensor) -> int:
        refuse_ragged(self, data)
        window_frames = get_num_frames(data)
        if None not in (window_frames, self.num_frames) and window_frames != self.num_frames:
            raise ValueError(
                f"'num_frames' must be {window_frames}, as in the windows (got {self.num_frames})"
            )
        return self.num_frames or window_frames or x.size(-1)

    def __repr__(self) -> str:
        num_frames = "" if self.num_frames is None else f", num_frames={self.num_frames}"
        return f"{type(self).__name__}(steps={self.steps}{num_frames})"
