r"""A support vector machine on SIFT visual words."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from torch_geometric_tactile.baselines._visual_words import VisualWordsSVM

_NO_DESCRIPTORS = np.empty((0, 128), dtype=np.float32)


@dataclass(kw_only=True, repr=False, eq=False)
class SIFTSVM(VisualWordsSVM):
    r"""A support vector machine on SIFT visual words, which is a baseline from the "A Novel
    Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for Tactile Shape
    Recognition" paper (Sensors 2020, 20, 5822). The paper gives no details. The defaults of this
    class were chosen on images of drawn letters.

    Readings must be grey values in :math:`[0, 1]` on the image map of the layout. They are clipped
    to this range, so do not standardise them first. Cells without a taxel are 0. OpenCV detects
    keypoints and computes a descriptor of 128 numbers for each keypoint. The histogram of words
    ignores the positions of the keypoints. An image without keypoints has a histogram of zeros. The
    attribute :obj:`num_without_words_` counts these images in the last call of :meth:`fit`,
    :meth:`transform` or :meth:`predict`.

    Args:
        layout (TaxelLayout or str or PathLike, optional): The layout, which must have an image map.
            Defaults to :func:`~torch_geometric_tactile.sensors.letter_array`.
        num_words (int): Number of words :math:`K`. With 1,000 words, scores on validation letters
            are 0.4 points higher, but fitting takes longer.
        factor (int): Factor by which images are enlarged first. SIFT then doubles the size again.
        contrast_threshold (float): Minimum contrast of a keypoint. OpenCV's default, 0.04, suits
            sharper images.
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
        ImportError: If OpenCV is missing (extra :obj:`baselines`).
        ValueError: If the layout has no image map, the grey values are not finite or have the wrong
            shape, there are fewer descriptors than words, or an argument is out of range.

    Examples:
        >>> model = SIFTSVM(random_state=0).fit(data.x[train], data.y[train])  # doctest: +SKIP
        >>> model.predict(data.x[test])  # doctest: +SKIP
    """

    contrast_threshold: float = 0.01

    @staticmethod
    def _import_library() -> Any:
        try:
            import cv2
        except ImportError as error:
            raise ImportError(
                "SIFT needs OpenCV: pip install 'torch-geometric-tactile[baselines]'"
            ) from error
        return cv2

    def _check_arguments(self) -> None:
        super()._check_arguments()
        if not self.contrast_threshold >= 0:
            raise ValueError(
                f"'contrast_threshold' must not be negative (got {self.contrast_threshold})"
            )

    def describe(self, images: np.ndarray) -> Iterator[np.ndarray]:
        r"""Yields the descriptors of the keypoints of each image :math:`(P, 128)`.

        Args:
            images (numpy.ndarray): Enlarged images :math:`(S, H, W)`, in :obj:`uint8`.
        """
        sift = self._import_library().SIFT_create(contrastThreshold=self.contrast_threshold)
        for image in images:
            descriptors = sift.detectAndCompute(image, None)[1]
            yield _NO_DESCRIPTORS if descriptors is None else descriptors
