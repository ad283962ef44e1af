r"""Readings that are shifted in time."""

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import FRAMES
from torch_geometric_tactile.transforms._random import (
    RandomTransform,
    check_generator,
    check_whole,
    uniform,
)
from torch_geometric_tactile.transforms._segments import samples_of_rows
from torch_geometric_tactile.transforms._windows import given_num_frames, refuse_ragged

_MOST_STEPS = 100_000


@functional_transform("random_time_shift")
class RandomTimeShift(RandomTransform):
    r"""Shifts each sample in time by a random number of frames, the same for all taxels (functional
    name: :obj:`random_time_shift`), as an augmentation: a :obj:`train_transform`. The first or last
    frame is repeated to fill the gap.

    The frames are the features of a taxel: those of its first channel, then those of the second.

    Args:
        steps (int): By how many frames at most, earlier or later; all from none to these are drawn
            equally often.
        num_frames (int, optional): Number of frames :math:`T`, of which the features are a
            multiple. If left out, that of the samples, if these are windows; otherwise all features
            are the frames of one channel.
        generator (torch.Generator, optional): The source of random numbers; PyTorch's own if left
            out.

    Shapes:
        - **input:** readings :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or a PyG batch
          :math:`(B \cdot N, C \cdot T)`
        - **output:** the same shape. Missing readings (NaN) move along.

    Raises:
        ValueError: If :obj:`steps` is not 0 to 100,000, :obj:`num_frames` is below one or not that
            of the windows, the features are no multiple of it, windows are padded, or there are no
            readings.

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
        self.steps = check_whole("steps", steps, 0, _MOST_STEPS)
        if num_frames is not None:
            num_frames = check_whole("num_frames", num_frames, 1, _MOST_STEPS)
        self.num_frames = num_frames
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Shifts the readings."""
        frames = self._frames(data, x)
        if frames and x.size(-1) % frames:
            raise ValueError(
                f"'x' must have a multiple of {frames} features, the frames (got {x.size(-1)})"
            )
        sample, count = samples_of_rows(data, x)
        drawn = uniform(count, x, self.generator)
        steps = (drawn * (2 * self.steps + 1)).long().clamp(max=2 * self.steps) - self.steps
        if x.numel() == 0:
            return x
        source = torch.arange(frames, device=x.device) - steps[sample].unsqueeze(1)
        rows = x.reshape(len(sample), -1, frames)
        source = source.clamp(0, frames - 1).unsqueeze(1).expand_as(rows)
        return rows.gather(2, source).reshape(x.shape)

    def _frames(self, data: Data, x: Tensor) -> int:
        refuse_ragged(self, data)
        given = given_num_frames(data)
        if None not in (given, self.num_frames) and given != self.num_frames:
            raise ValueError(
                f"'num_frames' must be {given}, that of the windows (got {self.num_frames})"
            )
        return self.num_frames or given or x.size(-1)

    def __repr__(self) -> str:
        frames = "" if self.num_frames is None else f", num_frames={self.num_frames}"
        return f"{type(self).__name__}(steps={self.steps}{frames})"
