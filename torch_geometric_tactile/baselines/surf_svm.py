r"""A support vector machine on SURF visual words."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.baselines._visual_words import VisualWordsSVM

_MARGIN = 16  # in scales; mahotas skips points that are closer than this to the border
_WINDOW = 20  # in scales; side of the square that a descriptor covers


@dataclass(kw_only=True, repr=False, eq=False)
class SURFSVM(VisualWordsSVM):
    r"""A support vector machine on SURF visual words, which is a baseline from the "A Novel
    Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for Tactile Shape
    Recognition" paper (Sensors 2020, 20, 5822). The paper gives no details. The defaults of this
    class were chosen on images of drawn letters.

    The SURF detector finds no points in images of 32 x 32 pixels. Images are therefore enlarged,
    and mahotas computes descriptors of 64 numbers at the points of a regular grid, as its
    :func:`surf.dense` does. Points in flat regions are left out. Images are padded with the grey
    values at their border, so that points near the border also have descriptors. Everything else,
    including :obj:`num_without_words_`, is the same as in
    :class:`~torch_geometric_tactile.baselines.SIFTSVM`.

    Args:
        layout (TaxelLayout or str or PathLike, optional): The layout, which must have an image map.
            Defaults to :func:`~torch_geometric_tactile.sensors.letter_array`.
        num_words (int): Number of words :math:`K`.
        factor (int): Factor by which images are enlarged first.
        spacing (int): Distance between points in pixels of the enlarged image.
        scale (float): Scale :math:`s` of a descriptor, which covers :math:`20 s \times 20 s` pixels
            of the enlarged image. With a scale of 4 and a spacing of 6, scores on validation
            letters are 1.5 points higher, but the computation takes 1.7 times as long.
        contrast (float): Points are left out if the grey values of the covered pixels differ by at
            most this fraction of the full scale.
        root (bool): Whether to use the square roots of the counts, as in the Hellinger kernel.
        kernel (str): :obj:`"linear"` or :obj:`"rbf"`.
        C (float): Penalty for errors.
        class_weight (dict or str, optional): :obj:`"balanced"` gives rare classes the same total
            weight as common ones.
        random_state (int, optional): Seed for k-means and the support vector machine.

    Shapes:
        - **input:** grey values :math:`(S, N, 1)`
        - **output:** predicted labels :math:`(S,)`

    Raises:
        ImportError: If mahotas is missing (extra :obj:`baselines`).
        ValueError: If the layout has no image map, the grey values are not finite or have the wrong
            shape, there are fewer descriptors than words, or an argument is out of range.

    Examples:
        >>> model = SURFSVM(random_state=0).fit(data.x[train], data.y[train])  # doctest: +SKIP
        >>> model.predict(data.x[test])  # doctest: +SKIP
    """

    factor: int = 3
    spacing: int = 8
    scale: float = 3.0
    contrast: float = 0.1
    kernel: Literal["linear", "rbf"] = "rbf"
    C: float = 10.0

    @staticmethod
    def _import_library() -> Any:
        try:
            from mahotas.features import surf
        except ImportError as error:
            raise ImportError(
                "SURF needs mahotas: pip install 'torch-geometric-tactile[baselines]'"
            ) from error
        return surf

    def _check_arguments(self) -> None:
        super()._check_arguments()
        need(self.spacing >= 1, "'spacing' must be at least 1", self.spacing)
        need(1 <= self.scale < math.inf, "'scale' must be at least 1", self.scale)
        need(0 <= self.contrast <= 1, "'contrast' must be between 0 and 1", self.contrast)

    def describe(self, images: np.ndarray) -> Iterator[np.ndarray]:
        r"""Yields the descriptors of the grid points of each image :math:`(P, 64)`.

        Args:
            images (numpy.ndarray): Enlarged images :math:`(S, H, W)`, in :obj:`uint8`.
        """
        surf = self._import_library()
        margin = math.ceil(_MARGIN * self.scale)
        points = _grid_points(images.shape[1], images.shape[2], self.spacing)
        window = max(1, round(_WINDOW * self.scale))
        for image in images:
            local_range = maximum_filter(image, window) - minimum_filter(image, window)
            rows, cols = points[local_range[tuple(points.T)] > 255 * self.contrast].T
            ones = np.ones(len(rows))
            # mahotas takes the row, column, scale, score and sign of the Laplacian for each point.
            interest_points = np.stack(
                [rows + margin, cols + margin, self.scale * ones, ones, ones], axis=1
            )
            padded = np.pad(image, margin, mode="edge")
            yield surf.descriptors(padded, interest_points, descriptor_only=True).astype(np.float32)


def _grid_points(height: int, width: int, spacing: int) -> np.ndarray:
    rows, cols = (np.arange(spacing // 2, size, spacing) for size in (height, width))
    return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
