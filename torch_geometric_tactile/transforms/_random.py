r"""Random draws and the base classes of random transforms."""

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
from torch_geometric_tactile.transforms._windows import num_channels_and_frames, repeat_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


class RandomTransform(TactileTransform):
    r"""The base class of transforms that change the readings at random. One draw applies to all
    frames of a window.
    """

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
        r"""Returns the changed readings, of the same shape.

        Args:
            data (torch_geometric.data.Data): The samples.
            x (torch.Tensor): Their readings :math:`(N, F)` or :math:`(B, N, F)`.
        """
        raise NotImplementedError


class SegmentDraws(RandomTransform):
    r"""The base class of transforms that draw a normally distributed number for each segment and
    channel of each sample.
    """

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
        r"""Returns the arguments of the constructor, in which segments are numbered from zero."""
        segment_arguments = self._segments.arguments()
        return {"std": self.std, **segment_arguments, "generator": self.generator}

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the readings, changed by the draws for their segments."""
        segment, count = self._segments.row_segments(data, x)
        num_channels, num_frames = num_channels_and_frames(data, x)
        draws = normal(count * num_channels, x, self.generator).view(count, num_channels)
        return self.combined(x, segment, self.std * repeat_frames(draws, num_frames))

    def combined(self, x: Tensor, segment: Tensor, draws: Tensor) -> Tensor:
        r"""Applies the draws to the readings.

        Args:
            x (torch.Tensor): The readings :math:`(N, F)` or :math:`(B, N, F)`.
            segment (torch.Tensor): The segment of each row of the readings.
            draws (torch.Tensor): The draws for each segment, one for each feature.
        """
        raise NotImplementedError

    def __repr__(self) -> str:
        segments = f", {self._segments!r}" if self._segments.segment is not None else ""
        return f"{type(self).__name__}(std={self.std}{segments})"


def uniform(count: int, x: Tensor, generator: torch.Generator | None) -> Tensor:
    r"""Draws uniform random numbers from 0 to 1 on the device of the readings. The same seed gives
    the same numbers, whether the samples are in one batch or in several.

    Shapes:
        - **output:** :math:`(count,)`
    """
    device = x.device if generator is None else generator.device
    return torch.rand(count, generator=generator, device=device).to(x.device)


def normal(count: int, x: Tensor, generator: torch.Generator | None) -> Tensor:
    r"""Draws normal random numbers with standard deviation one, with the properties of
    :func:`uniform`.

    Shapes:
        - **output:** :math:`(count,)`, none beyond 5.5 deviations
    """
    # `torch.randn` is not used: it draws many numbers in a different order than single numbers.
    draws = uniform(count, x, generator).double()
    # `torch.rand` returns multiples of 2**-24; the shift by half a step avoids 0 and thus infinity.
    return torch.special.ndtri(draws + 2.0**-25).float()


def check_generator(generator: torch.Generator | None) -> torch.Generator | None:
    r"""Checks a random number generator and returns it."""
    if generator is not None and not isinstance(generator, torch.Generator):
        raise ValueError(
            "'generator' must be a torch.Generator, such as torch.Generator().manual_seed(0), or "
            f"None (got {generator!r:.80})"
        )
    return generator


def check_deviation(std: float, name: str = "std") -> float:
    r"""Checks a standard deviation and returns it."""
    need(0 <= std < math.inf, f"'{name}' must be at least 0 and finite", std)
    return float(std)


def check_probability(p: float) -> float:
    r"""Checks a probability and returns it."""
    need(0 <= p <= 1, "'p' must be a probability between 0 and 1", p)
    return float(p)


def check_integer(name: str, number: int, minimum: int, maximum: int) -> int:
    r"""Checks that an argument is an integer within a range and returns it."""
    if isinstance(number, bool) or not isinstance(number, int) or not minimum <= number <= maximum:
        raise ValueError(
            f"'{name}' must be an integer between {minimum} and {maximum} (got {number})"
        )
    return number
