r"""What random transforms draw, and the base class of those that draw for each sample."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import FRAMES, require_floats
from torch_geometric_tactile.transforms._segments import Segments
from torch_geometric_tactile.transforms._windows import num_channels_and_frames, repeated
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


class RandomTransform(TactileTransform):
    r"""Changes the readings by what it draws, of all frames of a window alike."""

    reads: tuple[str, ...] = ("x",)
    writes = ("x",)
    per_frame = False
    is_random = True
    generator: torch.Generator | None

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`."""
        data.x = self.changed(data, require_floats(self, data))
        return data

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns other readings, of the same shape."""
        raise NotImplementedError


class SegmentDraws(RandomTransform):
    r"""Changes the readings by normal numbers, one for each segment and channel of each sample."""

    reads = ("x", *FRAMES)

    def __init__(
        self,
        std: float = 0.1,
        segments: str | Sequence[int] | Tensor | None = None,
        layout: TaxelLayout | PathLike | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        self.std = check_deviation(std)
        self.generator = check_generator(generator)
        self._segments = Segments(segments, layout)

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor; segments that were given are numbered anew."""
        rest = self._segments.arguments()
        return {"std": self.std, **rest, "generator": self.generator}

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the readings, changed by the numbers of their segments."""
        segment, count = self._segments.of_rows(data, x)
        num_channels, num_frames = num_channels_and_frames(data, x)
        drawn = normal(count * num_channels, x, self.generator).view(count, num_channels)
        return self.combined(x, segment, self.std * repeated(drawn, num_frames))

    def combined(self, x: Tensor, segment: Tensor, drawn: Tensor) -> Tensor:
        r"""Returns readings, whose rows have segments, with the numbers of each segment."""
        raise NotImplementedError

    def __repr__(self) -> str:
        segments = f", {self._segments!r}" if self._segments.segment is not None else ""
        return f"{type(self).__name__}(std={self.std}{segments})"


def uniform(count: int, x: Tensor, generator: torch.Generator | None) -> Tensor:
    r"""Returns random numbers from 0 to 1, on the device of the readings: the same for one seed
    however samples are arranged.

    Shapes:
        - **output:** :math:`(count,)`
    """
    device = x.device if generator is None else generator.device
    return torch.rand(count, generator=generator, device=device).to(x.device)


def normal(count: int, x: Tensor, generator: torch.Generator | None) -> Tensor:
    r"""Returns normal random numbers of deviation one, as of :func:`uniform`.

    Shapes:
        - **output:** :math:`(count,)`, none beyond 5.5 deviations
    """
    # PyTorch draws many normal numbers at once in another order than one by one.
    drawn = uniform(count, x, generator).double()
    return torch.special.ndtri(drawn + 2.0**-25).float()  # the middles of the steps of `rand`


def check_generator(generator: torch.Generator | None) -> torch.Generator | None:
    r"""Returns a source of random numbers."""
    if generator is not None and not isinstance(generator, torch.Generator):
        raise ValueError(
            "'generator' must be a torch.Generator, such as torch.Generator().manual_seed(0), or "
            f"None (got {generator!r:.80})"
        )
    return generator


def check_deviation(std: float, name: str = "std") -> float:
    r"""Returns a standard deviation."""
    need(0 <= std < math.inf, f"'{name}' must be at least 0 and finite", std)
    return float(std)


def check_probability(p: float) -> float:
    r"""Returns a probability."""
    need(0 <= p <= 1, "'p' must be a probability, 0 to 1", p)
    return float(p)


def check_whole(name: str, number: int, least: int, most: int) -> int:
    r"""Returns a whole number."""
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        raise ValueError(f"'{name}' must be a whole number, {least} to {most} (got {number})")
    return number
