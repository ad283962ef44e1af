r"""Pressure on the surface of an elastic layer, and the mean pressure on the pixels below."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout

CELL = 0.00025  # m; side of the cells in which the pressure is constant


@dataclass(frozen=True, eq=False)
class FieldSampling:
    r"""The weights with which the pressure on each cell of the surface contributes to the reading
    of each pixel.

    A weight is the product of a factor along :math:`x` and a factor along :math:`y`.
    :obj:`weights` has a pair of factors for each Gaussian of the layer, and :obj:`index` has the
    column and row of each pixel in the factors. :obj:`low` and :obj:`high` are the corners of the
    surface in metres.
    """

    low: np.ndarray
    high: np.ndarray
    weights: tuple[tuple[np.ndarray, np.ndarray], ...]
    index: tuple[np.ndarray, np.ndarray]

    def cells_in_box(
        self, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, tuple[slice, slice]]:
        r"""Returns the centres of the cells that a box touches along :math:`x` and along :math:`y`,
        and the slices of the cells along both axes.
        """
        centres, slices = [], []
        for axis in range(2):
            num_cells = self.weights[0][axis].shape[1]
            box = (np.array([low[axis], high[axis]]) - self.low[axis]) / CELL
            start = max(0, int(np.floor(box[0])))
            stop = min(num_cells, int(np.ceil(box[1])))
            slices.append(slice(start, stop))
            centres.append(self.low[axis] + (np.arange(start, stop) + 0.5) * CELL)
        return centres[0], centres[1], (slices[0], slices[1])

    def at_pixels(self, field: np.ndarray, cells: tuple[slice, slice]) -> np.ndarray:
        r"""Returns the mean pressure on the square of each pixel.

        Shapes:
            - **field:** pressure on the cells in the slices :obj:`cells`, with rows along :math:`y`
            - **output:** :math:`(N,)`
        """
        pressure = np.zeros(len(self.index[0]))
        for along_x, along_y in self.weights:
            # BLAS is not used: the last bit of its sums may depend on the number of threads.
            rows = np.einsum("yf,fg->yg", along_y[:, cells[1]], field)
            pressure += np.einsum("ng,ng->n", rows[self.index[1]], along_x[self.index[0], cells[0]])
        return pressure


@lru_cache(maxsize=4)
def field_sampling(
    layout: TaxelLayout, sensel: float, lengths: tuple[float, ...], parts: tuple[float, ...]
) -> FieldSampling:
    r"""Returns the weights with which pixels of a flat layout read the pressure on the surface.

    The layer spreads the pressure by Gaussians, and each pixel reads the mean over a square along
    :math:`x` and :math:`y`. Both are exact for pressure that is constant within cells.

    Args:
        layout (TaxelLayout): The pixels.
        sensel (float): Side of the square of a pixel in metres.
        lengths (tuple of float): Standard deviations of the Gaussians in metres.
        parts (tuple of float): Part of the pressure that each Gaussian spreads.
    """
    pos = layout.pos.double()[:, :2]
    low, high = pos.amin(dim=0), pos.amax(dim=0)
    distances, index = [], []
    for axis in range(2):
        # Pixels of a regular array share few coordinates, so weights are computed once per
        # coordinate.
        coordinates, coordinate_index = pos[:, axis].unique(return_inverse=True)
        num_cells = int(torch.ceil((high[axis] - low[axis]) / CELL - 1e-6))
        cells = low[axis] + (torch.arange(num_cells, dtype=torch.double) + 0.5) * CELL
        distances.append(coordinates[:, None] - cells)
        index.append(coordinate_index.numpy())
    weights = tuple(
        (part * _weights(distances[0], sensel, length), _weights(distances[1], sensel, length))
        for length, part in zip(lengths, parts, strict=True)
        if part
    )
    return FieldSampling(low.numpy(), high.numpy(), weights, (index[0], index[1]))


def _weights(distance: Tensor, sensel: float, length: float) -> np.ndarray:
    # The integral of a Gaussian over the pixel and the cell, from its second antiderivative.
    outer, inner = (sensel + CELL) / 2, (sensel - CELL) / 2
    total = _second_antiderivative(distance + outer, length) - _second_antiderivative(
        distance + inner, length
    )
    total -= _second_antiderivative(distance - inner, length)
    total += _second_antiderivative(distance - outer, length)
    weights: np.ndarray = (total / sensel).numpy()
    return weights


def _second_antiderivative(x: Tensor, length: float) -> Tensor:
    # For a Gaussian with standard deviation `length`, which is a delta function if `length` is 0.
    if length == 0:
        return x.clamp(min=0)
    t = x / length
    density = torch.exp(-t.square() / 2) / (2 * torch.pi) ** 0.5
    return x * torch.special.ndtr(t) + length * density
