r"""Pressure on the surface of an elastic layer, and what pixels below it take up."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout

CELL = 0.00025  # m, side of the cells in which pressure is given


@dataclass(frozen=True, eq=False)
class FieldSampling:
    r"""How much each pixel takes up of the pressure on each cell of the surface."""

    low: np.ndarray
    high: np.ndarray
    weights: tuple[tuple[np.ndarray, np.ndarray], ...]
    index: tuple[np.ndarray, np.ndarray]

    def cells(
        self, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, tuple[slice, slice]]:
        r"""Returns the middles of the cells that a box touches, along both axes, and their
        numbers.
        """
        middles, parts = [], []
        for axis in range(2):
            number = self.weights[0][axis].shape[1]
            ends = (np.array([low[axis], high[axis]]) - self.low[axis]) / CELL
            start = max(0, int(np.floor(ends[0])))
            stop = min(number, int(np.ceil(ends[1])))
            parts.append(slice(start, stop))
            middles.append(self.low[axis] + (np.arange(start, stop) + 0.5) * CELL)
        return middles[0], middles[1], (parts[0], parts[1])

    def at_pixels(self, field: np.ndarray, cells: tuple[slice, slice]) -> np.ndarray:
        r"""Returns what each pixel takes up.

        Shapes:
            - **output:** mean pressure on the square of each pixel :math:`(N,)`
        """
        out = np.zeros(len(self.index[0]))
        for along_x, along_y in self.weights:
            # No BLAS: the last bit of its sums may depend on its number of threads.
            rows = np.einsum("yf,fg->yg", along_y[:, cells[1]], field)
            out += np.einsum("ng,ng->n", rows[self.index[1]], along_x[self.index[0], cells[0]])
        return out


@lru_cache(maxsize=4)
def field_sampling(
    layout: TaxelLayout, sensel: float, lengths: tuple[float, ...], parts: tuple[float, ...]
) -> FieldSampling:
    r"""Returns what the pixels of a flat layout take up of the pressure above them: the layer
    spreads it by Gaussians, and each pixel takes its mean over a square along :math:`x` and
    :math:`y`. Both are exact for pressure that is constant within cells.
    """
    pos = layout.pos.double()[:, :2]
    low, high = pos.amin(dim=0), pos.amax(dim=0)
    middles, index = [], []
    for axis in range(2):
        places, which = pos[:, axis].unique(return_inverse=True)
        number = int(torch.ceil((high[axis] - low[axis]) / CELL - 1e-6))
        cells = low[axis] + (torch.arange(number, dtype=torch.double) + 0.5) * CELL
        middles.append(places[:, None] - cells)
        index.append(which.numpy())
    weights = tuple(
        (part * _weights(middles[0], sensel, length), _weights(middles[1], sensel, length))
        for length, part in zip(lengths, parts, strict=True)
        if part
    )
    return FieldSampling(low.numpy(), high.numpy(), weights, (index[0], index[1]))


def _weights(distance: Tensor, sensel: float, length: float) -> np.ndarray:
    # The second integral of a Gaussian, over the pixel and the cell.
    wide, narrow = (sensel + CELL) / 2, (sensel - CELL) / 2
    total = _twice_integrated(distance + wide, length) - _twice_integrated(
        distance + narrow, length
    )
    total -= _twice_integrated(distance - narrow, length)
    total += _twice_integrated(distance - wide, length)
    weights: np.ndarray = (total / sensel).numpy()
    return weights


def _twice_integrated(x: Tensor, length: float) -> Tensor:
    if length == 0:
        return x.clamp(min=0)
    t = x / length
    density = torch.exp(-t.square() / 2) / (2 * torch.pi) ** 0.5
    return x * torch.special.ndtr(t) + length * density
