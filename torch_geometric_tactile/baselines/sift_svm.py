r"""Words of SIFT."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from torch_geometric_tactile.baselines._visual_words import VisualWordsSVM

_NONE = np.empty((0, 128), dtype=np.float32)


@dataclass(kw_only=True, repr=False, eq=False)
class SIFTSVM(VisualWordsSVM):
    r"""A support vector machine on words of SIFT, with which the "A Novel Bilinear Feature and
    Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors
    2020, 20, 5822) compares. It says no more than that; everything below is ours, chosen on images
    of drawn letters.

    Readings are grey values in :math:`[0, 1]` on the image map of the layout. Lower ones count as
    0, higher ones as 1, and cells without a taxel are 0; do not scale them before by their mean.
    OpenCV finds keypoints and describes each by 128 numbers. Their words are counted without their
    places. An image without keypoints has a histogram of zeros; :obj:`num_without_words_` counts
    such images of the last call of :meth:`fit`, :meth:`transform` or :meth:`predict`.

    Args:
        layout (TaxelLayout or str or PathLike, optional): The taxels, on an image map;
            :func:`~torch_geometric_tactile.sensors.letter_array` if left out.
        num_words (int): Number of words :math:`K`. 1,000 are a little better (by 0.4 points on
            validation letters) and take longer.
        factor (int): How much an image is enlarged before. SIFT doubles it once more by itself.
        contrast_threshold (float): Contrast that a keypoint must have. OpenCV's own default is
            0.04, for sharp images.
        root (bool): Whether the histograms are those of the Hellinger kernel, roots of the counts.
        kernel (str): :obj:`"linear"` or :obj:`"rbf"`.
        C (float): Penalty of an error.
        class_weight (dict or str, optional): :obj:`"balanced"` makes rare classes count as much.
        random_state (int, optional): Seed of the words and of the machine.

    Shapes:
        - **input:** grey values :math:`(S, N, 1)`
        - **output:** predicted labels :math:`(S,)`

    Raises:
        ImportError: If OpenCV, of the extra :obj:`baselines`, is missing.
        ValueError: If the layout has no image map, the grey values are not finite or have another
            shape, there are fewer descriptors than words, or an argument is out of range.

    Examples:
        >>> model = SIFTSVM(random_state=0).fit(data.x[train], data.y[train])  # doctest: +SKIP
        >>> model.predict(data.x[test])  # doctest: +SKIP
    """

    contrast_threshold: float = 0.01

    @staticmethod
    def _library() -> Any:
        try:
            import cv2
        except ImportError as error:
            raise ImportError(
                "SIFT needs OpenCV: pip install 'torch-geometric-tactile[baselines]'"
            ) from error
        return cv2

    def _check(self) -> None:
        super()._check()
        if not self.contrast_threshold >= 0:
            raise ValueError(
                f"'contrast_threshold' must not be negative (got {self.contrast_threshold})"
            )

    def describe(self, images: np.ndarray) -> Iterator[np.ndarray]:
        r"""Yields the descriptors of the keypoints of each image :math:`(P, 128)`.

        Args:
            images (numpy.ndarray): Enlarged images :math:`(S, H, W)`, in :obj:`uint8`.
        """
        sift = self._library().SIFT_create(contrastThreshold=self.contrast_threshold)
        for image in images:
            found = sift.detectAndCompute(image, None)[1]
            yield _NONE if found is None else found
