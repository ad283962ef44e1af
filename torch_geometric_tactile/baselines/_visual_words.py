r"""Bags of visual words of pressure images."""

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
from torch_geometric_tactile.baselines._readings import TakesReadings, check_finite, readings
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, letter_array

_MOST_DESCRIPTORS = 200_000  # that words are made of, and that are kept while a machine is fitted
_BLOCK = 512  # images enlarged at once
_BATCH = 2048  # descriptors of a step of k-means
_MOST_STEPS = 5000
_KERNELS = ("linear", "rbf")


@dataclass(repr=False, eq=False)
class VisualWordsSVM(ClassifierMixin, TakesReadings, ABC):
    r"""A support vector machine on histograms of visual words, the base of
    :class:`~torch_geometric_tactile.baselines.SIFTSVM` and
    :class:`~torch_geometric_tactile.baselines.SURFSVM`, which describe points of an image.

    Descriptors of the training images are clustered by mini-batch k-means (of images drawn at
    random, if there are more than 200,000 descriptors); a cluster is a word. An image is the
    histogram of the words that its descriptors are nearest to, scaled to unit length.
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
        self._library()

    @staticmethod
    @abstractmethod
    def _library() -> Any:
        r"""Returns the library that describes points, or raises an :class:`ImportError` that names
        its extra.
        """

    @abstractmethod
    def describe(self, images: np.ndarray) -> Iterator[np.ndarray]:
        r"""Yields the descriptors of each image :math:`(P, D)`, which may be none.

        Args:
            images (numpy.ndarray): Enlarged images of whole grey values
                :math:`(S, H, W)`, in :obj:`uint8`.
        """

    def images(self, x: Any) -> np.ndarray:
        r"""Returns readings as images of whole grey values, 0 to 255, before they are enlarged.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.

        Shapes:
            - **output:** :math:`(S, H, W)`, in :obj:`uint8`
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
        r"""Finds the words, and fits the machine on their histograms.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.
            y (array-like): Labels :math:`(S,)`.
        """
        self._check()
        images, labels = self.images(x), np.asarray(y)
        if labels.shape != (len(images),):
            raise ValueError(f"'y' must have shape ({len(images)},), as 'x' (got {labels.shape})")
        state = check_random_state(self.random_state)
        known = self._some(images, state.permutation(len(images)))
        found = sum(map(len, known.values()))
        if found < self.num_words:
            raise ValueError(
                f"'num_words' must not be above the descriptors of the training part (got "
                f"{self.num_words} words of {found} descriptors in {len(images)} images)"
            )
        self.k_means_ = MiniBatchKMeans(
            self.num_words, batch_size=_BATCH, n_init=1, random_state=state
        ).fit(np.concatenate([known[i] for i in sorted(known)]))
        self.words_ = self.k_means_.cluster_centers_
        self.svm_ = self._machine(state).fit(self._histograms(images, known), labels)
        self.classes_ = self.svm_.classes_
        return self

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns the histograms of words, and sets :obj:`num_without_words_`.

        Args:
            x (StaticData or array-like): Samples, or grey values :math:`(S, N, 1)`.

        Shapes:
            - **output:** :math:`(S, K)` of :math:`K` words
        """
        check_is_fitted(self)
        return self._histograms(self.images(x), {})

    def decision_function(self, x: Any) -> np.ndarray:
        r"""Returns the score of each class :math:`(S, C)`, or of the second of two :math:`(S,)`.

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
        chosen = scores > 0 if scores.ndim == 1 else scores.argmax(axis=1)
        labels: np.ndarray = self.classes_[chosen.astype(int)]
        return labels

    def _check(self) -> None:
        for name in ("num_words", "factor"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1 (got {getattr(self, name)})")
        if self.kernel not in _KERNELS:
            raise ValueError(f"'kernel' must be one of {list(_KERNELS)} (got '{self.kernel}')")

    def _machine(self, state: np.random.RandomState) -> Any:
        settings = {"C": self.C, "class_weight": self.class_weight, "random_state": state}
        if self.kernel == "linear":
            return LinearSVC(dual="auto", max_iter=_MOST_STEPS, **settings)
        return SVC(kernel=self.kernel, **settings)

    def _some(self, images: np.ndarray, order: np.ndarray) -> dict[int, np.ndarray]:
        # The descriptors of images drawn at random, until there are enough.
        known: dict[int, np.ndarray] = {}
        found = 0
        for start in range(0, len(order), _BLOCK):
            chosen = order[start : start + _BLOCK]
            for number, descriptors in zip(chosen, self._described(images[chosen]), strict=True):
                known[int(number)] = descriptors
                found += len(descriptors)
            if found >= _MOST_DESCRIPTORS:
                break
        return known

    def _described(self, images: np.ndarray) -> Iterator[np.ndarray]:
        for start in range(0, len(images), _BLOCK):
            yield from self.describe(enlarged(images[start : start + _BLOCK], self.factor))

    def _histograms(self, images: np.ndarray, known: dict[int, np.ndarray]) -> np.ndarray:
        others = np.setdiff1d(np.arange(len(images)), list(known))
        counts = np.zeros((len(images), self.num_words))
        described: Iterable[tuple[int, np.ndarray]] = zip(
            others, self._described(images[others]), strict=True
        )
        for part in (known.items(), described):
            for number, descriptors in part:
                if len(descriptors):
                    words = self.k_means_.predict(descriptors)
                    counts[number] = np.bincount(words, minlength=self.num_words)
        self.num_without_words_ = int((counts.sum(axis=1) == 0).sum())
        counts = np.sqrt(counts) if self.root else counts
        return counts / np.maximum(np.linalg.norm(counts, axis=1, keepdims=True), 1e-12)


def enlarged(images: np.ndarray, factor: int) -> np.ndarray:
    r"""Returns images with :obj:`factor` times as many rows and columns, by linear interpolation,
    rounded to whole grey values.

    Shapes:
        - **images:** Images :math:`(S, H, W)`, in :obj:`uint8`.
    """
    if factor == 1 or not len(images):
        return images
    values = torch.from_numpy(images).unsqueeze(1).float()
    larger = interpolate(values, scale_factor=factor, mode="bilinear", align_corners=False)
    out: np.ndarray = larger.squeeze(1).round().byte().numpy()
    return out
