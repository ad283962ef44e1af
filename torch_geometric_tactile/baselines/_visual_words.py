r"""Support vector machines on bags of visual words of pressure images."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal, Self

import numpy as np
import torch
from sklearn.base import ClassifierMixin
from sklearn.cluster import MiniBatchKMeans
from sklearn.svm import SVC, LinearSVC
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted
from torch.nn.functional import interpolate

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._readings import ReadingsEstimator, check_finite, readings
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, letter_array

_MAX_DESCRIPTORS = 200_000  # for k-means; SIFT descriptors then take at most about 100 MB
_IMAGE_BLOCK = 512  # enlarged images are large, so only one block of them is held at a time
_KMEANS_BATCH = 2048  # descriptors in one step of k-means
_MAX_SVM_STEPS = 5000  # scikit-learn's default is 1000
_KERNELS = ("linear", "rbf")


@dataclass(repr=False, eq=False)
class VisualWordsSVM(ClassifierMixin, ReadingsEstimator, ABC):
    r"""A support vector machine on histograms of visual words. This is the base class of
    :class:`~torch_geometric_tactile.baselines.SIFTSVM` and
    :class:`~torch_geometric_tactile.baselines.SURFSVM`, which compute descriptors of points in an
    image.

    Mini-batch k-means clusters the descriptors of the training images. If there are more than
    200,000 descriptors, a random subset of the images is used. Each cluster is a word. An image is
    represented by the histogram of the words that are nearest to its descriptors, scaled to unit
    length.
    """

    layout: TaxelLayout | PathLike | None = None
    _: KW_ONLY
    num_words: int = 500
    factor: int = 1
    root: bool = True
    kernel: Literal["linear", "rbf"] = "linear"
    C: float = 1.0
    class_weight: dict[int, float] | str | None = None
    random_state: int | None = None

    def __post_init__(self) -> None:
        # A missing library is reported when the estimator is created instead of after loading data.
        self._import_library()

    @staticmethod
    @abstractmethod
    def _import_library() -> Any:
        r"""Returns the module that computes descriptors.

        Raises:
            ImportError: If the library is missing. The message names the extra to install.
        """

    @abstractmethod
    def describe(self, images: np.ndarray) -> Iterator[np.ndarray]:
        r"""Yields the descriptors :math:`(P, D)` of each image. :math:`P` may be zero.

        Args:
            images (numpy.ndarray): Enlarged images :math:`(S, H, W)`, in :obj:`uint8`.
        """

    def images(self, x: Any) -> np.ndarray:
        r"""Returns readings as images with integer grey values from 0 to 255. The images are not
        yet enlarged.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.

        Shapes:
            - **output:** :math:`(S, H, W)`, in :obj:`uint8`

        Raises:
            ValueError: If the layout has no image map, or the grey values are not finite or have
                the wrong shape.
        """
        layout = letter_array() if self.layout is None else as_layout(self.layout)
        if layout.image_map is None:
            raise ValueError(
                f"{type(self).__name__} needs a layout with an image map (got none in "
                f"'{layout.name}'); give each taxel a 'cell'"
            )
        values = readings(x)
        if values.shape[1:] != (layout.num_taxels, 1):
            raise ValueError(
                f"'x' must have shape (num_samples, {layout.num_taxels}, 1), one grey value for "
                f"each taxel of layout '{layout.name}' (got {values.shape})"
            )
        check_finite(values, "x")
        rows, cols = layout.image_map.numpy().T
        images = np.zeros((len(values), rows.max() + 1, cols.max() + 1), dtype=np.uint8)
        images[:, rows, cols] = np.rint(255 * values[:, :, 0].clip(0, 1))
        return images

    def fit(self, x: Any, y: Any) -> Self:
        r"""Computes the words, then fits the support vector machine on the histograms of words.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.
            y (array-like): Labels :math:`(S,)`.
        """
        self._check_arguments()
        images, labels = self.images(x), np.asarray(y)
        if labels.shape != (len(images),):
            raise ValueError(f"'y' must have shape ({len(images)},), like 'x' (got {labels.shape})")
        state = check_random_state(self.random_state)
        descriptors = self._sample_descriptors(images, state.permutation(len(images)))
        num_descriptors = sum(map(len, descriptors.values()))
        if num_descriptors < self.num_words:
            raise ValueError(
                f"'num_words' must not exceed the number of descriptors in the training set (got "
                f"{self.num_words} words and {num_descriptors} descriptors in {len(images)} images)"
            )
        self.k_means_ = MiniBatchKMeans(
            self.num_words, batch_size=_KMEANS_BATCH, n_init=1, random_state=state
        ).fit(np.concatenate([descriptors[i] for i in sorted(descriptors)]))
        self.words_ = self.k_means_.cluster_centers_
        self.svm_ = self._create_svm(state).fit(self._histograms(images, descriptors), labels)
        self.classes_ = self.svm_.classes_
        return self

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns the histograms of words and sets :obj:`num_without_words_` to the number of
        images without descriptors.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.

        Shapes:
            - **output:** :math:`(S, K)` of :math:`K` words
        """
        check_is_fitted(self)
        return self._histograms(self.images(x), {})

    def decision_function(self, x: Any) -> np.ndarray:
        r"""Returns the score of each class :math:`(S, C)`. If there are two classes, returns the
        score of the second class :math:`(S,)`.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.
        """
        histograms = self.transform(x)
        if not len(histograms):
            num_classes = len(self.classes_)
            return np.empty(0 if num_classes == 2 else (0, num_classes))
        scores: np.ndarray = self.svm_.decision_function(histograms)
        return scores

    def predict(self, x: Any) -> np.ndarray:
        r"""Returns the predicted labels :math:`(S,)`.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.
        """
        scores = self.decision_function(x)
        class_index = scores > 0 if scores.ndim == 1 else scores.argmax(axis=1)
        labels: np.ndarray = self.classes_[class_index.astype(int)]
        return labels

    def _check_arguments(self) -> None:
        for name in ("num_words", "factor"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1 (got {getattr(self, name)})")
        if self.kernel not in _KERNELS:
            raise ValueError(f"'kernel' must be one of {list(_KERNELS)} (got '{self.kernel}')")

    def _create_svm(self, state: np.random.RandomState) -> Any:
        settings = {"C": self.C, "class_weight": self.class_weight, "random_state": state}
        if self.kernel == "linear":
            return LinearSVC(dual="auto", max_iter=_MAX_SVM_STEPS, **settings)
        return SVC(kernel=self.kernel, **settings)

    def _sample_descriptors(self, images: np.ndarray, order: np.ndarray) -> dict[int, np.ndarray]:
        # Returns descriptors by index of the image. Processes the images in `order`, block by
        # block, until there are _MAX_DESCRIPTORS descriptors.
        sample: dict[int, np.ndarray] = {}
        num_descriptors = 0
        for start in range(0, len(order), _IMAGE_BLOCK):
            block = order[start : start + _IMAGE_BLOCK]
            for index, descriptors in zip(block, self._describe_blocks(images[block]), strict=True):
                sample[int(index)] = descriptors
                num_descriptors += len(descriptors)
            if num_descriptors >= _MAX_DESCRIPTORS:
                break
        return sample

    def _describe_blocks(self, images: np.ndarray) -> Iterator[np.ndarray]:
        for start in range(0, len(images), _IMAGE_BLOCK):
            yield from self.describe(enlarge(images[start : start + _IMAGE_BLOCK], self.factor))

    def _histograms(self, images: np.ndarray, computed: dict[int, np.ndarray]) -> np.ndarray:
        # Returns the histograms (S, K). `computed` holds descriptors from an earlier step, by index
        # of the image, so that `fit` does not compute them twice.
        new_images = np.setdiff1d(np.arange(len(images)), list(computed))
        counts = np.zeros((len(images), self.num_words))
        new_descriptors: Iterable[tuple[int, np.ndarray]] = zip(
            new_images, self._describe_blocks(images[new_images]), strict=True
        )
        for pairs in (computed.items(), new_descriptors):
            for index, descriptors in pairs:
                if len(descriptors):
                    words = self.k_means_.predict(descriptors)
                    counts[index] = np.bincount(words, minlength=self.num_words)
        self.num_without_words_ = int((counts.sum(axis=1) == 0).sum())
        counts = np.sqrt(counts) if self.root else counts
        # The lower bound leaves the histogram of an image without words at zero.
        return counts / np.maximum(np.linalg.norm(counts, axis=1, keepdims=True), 1e-12)


def enlarge(images: np.ndarray, factor: int) -> np.ndarray:
    r"""Returns images with :obj:`factor` times as many rows and columns. Grey values are
    interpolated linearly and rounded to integers.

    Args:
        images (numpy.ndarray): Images :math:`(S, H, W)`, in :obj:`uint8`.
        factor (int): Scale factor for height and width.
    """
    if factor == 1 or not len(images):
        return images
    values = torch.from_numpy(images).unsqueeze(1).float()
    larger_images = interpolate(values, scale_factor=factor, mode="bilinear", align_corners=False)
    grey_values: np.ndarray = larger_images.squeeze(1).round().byte().numpy()
    return grey_values
