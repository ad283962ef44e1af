r"""Words of SURF."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.baselines._visual_words import VisualWordsSVM

_MARGIN = 16  # scales around a point, without which mahotas leaves it out
_WINDOW = 20  # scales across the square that a descriptor describes


@dataclass(kw_only=True, repr=False, eq=False)
class SURFSVM(VisualWordsSVM):
    r"""A support vector machine on words of SURF, with which the "A Novel Bilinear Feature and
    Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors
    2020, 20, 5822) compares. It says no more than that; everything below is ours, chosen on images
    of drawn letters.

    The detector of SURF finds nothing on 32 x 32 pixels. So images are enlarged, and mahotas
    describes points on a raster (as its :func:`surf.dense`) by 64 numbers each, but leaves out
    those around which the image is flat. The image is continued beyond its border by the grey
    values there, so that points near it are described, too. All else, and
    :obj:`num_without_words_`, is as in :class:`~torch_geometric_tactile.baselines.SIFTSVM`.

    Args:
        layout (TaxelLayout or str or PathLike, optional): The taxels, on an image map;
            :func:`~torch_geometric_tactile.sensors.letter_array` if left out.
        num_words (int): Number of words :math:`K`.
        factor (int): How much an image is enlarged before.
        spacing (int): Distance of the points in pixels of the enlarged image.
        scale (float): Scale of a descriptor, which describes 20 scales by 20 pixels of the enlarged
            image. A scale of 4 with a spacing of 6 is better (by 1.5 points on validation letters)
            and takes 1.7 times as long.
        contrast (float): A point is left out if the grey values of these pixels differ by no more
            than this part of the full scale.
        root (bool): Whether the histograms are those of the Hellinger kernel, roots of the counts.
        kernel (str): :obj:`"linear"` or :obj:`"rbf"`.
        C (float): Penalty of an error.
        class_weight (dict or str, optional): :obj:`"balanced"` makes rare classes count as much.
        random_state (int, optional): Seed of the words and of the machine.

    Shapes:
        - **input:** grey values :math:`(S, N, 1)`
        - **output:** predicted labels :math:`(S,)`

    Raises:
        ImportError: If mahotas, of the extra :obj:`baselines`, is missing.
        ValueError: If the layout has no image map, the grey values are not finite or have another
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
    def _library() -> Any:
        try:
            from mahotas.features import surf
        except ImportError as error:
            raise ImportError(
                "SURF needs mahotas: pip install 'torch-geometric-tactile[baselines]'"
            ) from error
        return surf

    def _check(self) -> None:
        super()._check()
        need(self.spacing >= 1, "'spacing' must be at least 1", self.spacing)
        need(1 <= self.scale < math.inf, "'scale' must be at least 1", self.scale)
        need(0 <= self.contrast <= 1, "'contrast' must be a part from 0 to 1", self.contrast)

    def describe(self, images: np.ndarray) -> Iterator[np.ndarray]:
        r"""Yields the descriptors of points on a raster of each image :math:`(P, 64)`.

        Args:
            images (numpy.ndarray): Enlarged images :math:`(S, H, W)`, in :obj:`uint8`.
        """
        surf = self._library()
        margin = math.ceil(_MARGIN * self.scale)
        points = _points(images.shape[1], images.shape[2], self.spacing)
        window = max(1, round(_WINDOW * self.scale))
        for image in images:
            spread = maximum_filter(image, window) - minimum_filter(image, window)
            rows, cols = points[spread[tuple(points.T)] > 255 * self.contrast].T
            ones = np.ones(len(rows))
            where = np.stack([rows + margin, cols + margin, self.scale * ones, ones, ones], axis=1)
            padded = np.pad(image, margin, mode="edge")
            yield surf.descriptors(padded, where, descriptor_only=True).astype(np.float32)


def _points(height: int, width: int, spacing: int) -> np.ndarray:
    rows, cols = (np.arange(spacing // 2, size, spacing) for size in (height, width))
    return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
