r"""Handwritten digits as images of pressure."""

from typing import Literal

import numpy as np
import torch
from sklearn.datasets import load_digits
from torch import Tensor
from torch.nn.functional import interpolate, pad

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._image_dataset import ImageDataset
from torch_geometric_tactile.datasets._raw_files import PublishedFiles
from torch_geometric_tactile.io.idx_file import read_idx
from torch_geometric_tactile.sensors import letter_array

_SOURCES = ("sklearn", "mnist")
_SIZE = 32
_DIGITS = tuple("0123456789")
_SHA256 = {
    "train-images-idx3-ubyte.gz": (
        "440fcabf73cc546fa21475e81ea370265605f56be210a4024d2ca8f203523609"
    ),
    "train-labels-idx1-ubyte.gz": (
        "3552534a0a558bbed6aed32b30c495cca23d567ec52cac8be1a0730e8010255c"
    ),
    "t10k-images-idx3-ubyte.gz": (
        "8d422c7b0a1c1c79245a5bcf07fe86e33eeafee792b84584aec276f5a2dbc4e6"
    ),
    "t10k-labels-idx1-ubyte.gz": (
        "f7ae60f92e00ec6debd23a6088c31dbd2371eca3ffa0defaefb259924204aec6"
    ),
}


class DigitImages(PublishedFiles, ImageDataset):
    r"""Handwritten digits as images of 32 x 32 pixels on the array of
    :class:`~torch_geometric_tactile.datasets.LetterShape`: real data of the same shape for the same
    models. They are ink, not touch.

    * :obj:`"sklearn"`: the 1,797 images of 8 x 8 pixels that come with scikit-learn
      (:func:`sklearn.datasets.load_digits`, the test part of UCI's "Optical Recognition of
      Handwritten Digits"), enlarged four times by linear interpolation. **They do not tell who
      wrote them**, so folds have the same writers in training and test.
    * :obj:`"mnist"`: the 70,000 images of 28 x 28 pixels of MNIST, with two black pixels around
      them. Its training and test part have different writers: :obj:`split` without a :obj:`fold`
      is that split, as is ``Protocol("given")``.

    A sample has grey values :obj:`x`, 0 to 1, and the digit :obj:`y`; :obj:`trial` and :obj:`group`
    number the images. :obj:`data.image` of samples and batches is a view of :obj:`x`.

    .. list-table:: STATS
        :header-rows: 1

        * - source
          - #samples
          - #nodes
          - #features
          - #classes
        * - sklearn
          - 1,797
          - 1,024
          - 1
          - 10
        * - mnist
          - 60,000 + 10,000
          - 1,024
          - 1
          - 10

    Args:
        root (str or PathLike, optional): Folder of the data set; for MNIST only, whose four files
            are in its :obj:`raw` folder or downloaded there. If left out,
            :obj:`$TACTILE_DATA/DigitImages` or a folder in the user's cache.
        fold (int, optional): Which of the :obj:`folds` is tested on.
        split (str, optional): :obj:`"train"` or :obj:`"test"`; everything with :obj:`None`.
        source (str): :obj:`"sklearn"` or :obj:`"mnist"`.
        folds (int): Number of folds, which all have their share of every digit.
        split_seed (int): Which of the random splits.
        adjacency (str, optional): Which edges: :obj:`"original"` joins four neighbours,
            :obj:`"dense"` eight; no edges with :obj:`None`.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.
        checksum (bool): Whether the raw files must be those published.

    Raises:
        ValueError: If an argument is wrong, or a raw file is not as published or cannot be read.
        ConnectionError: If a raw file is missing and cannot be downloaded.

    Examples:
        >>> dataset = DigitImages(fold=0, split="test")
        >>> dataset, dataset.image.shape, dataset.num_classes
        (DigitImages(360), torch.Size([360, 1, 32, 32]), 10)
        >>> dataset[0].image.shape
        torch.Size([1, 1, 32, 32])
    """

    url = "https://ossci-datasets.s3.amazonaws.com/mnist"
    _processed_name = "mnist"
    _sha256 = _SHA256

    def __init__(
        self,
        root: PathLike | None = None,
        fold: int | None = None,
        split: Literal["train", "test"] | None = None,
        *,
        source: Literal["sklearn", "mnist"] = "sklearn",
        folds: int = 5,
        split_seed: int = 0,
        adjacency: str | None = "original",
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
        checksum: bool = True,
    ) -> None:
        need(source in _SOURCES, f"'source' must be one of {list(_SOURCES)} (got {source!r})")
        if source == "sklearn" and root is not None:
            raise ValueError(f"'root' must be None with source='sklearn' (got '{root}')")
        if source == "mnist":
            self._folder = "DigitImages"
        self.fold, self.split, self.folds, self.split_seed = fold, split, folds, split_seed
        self.source = source
        self._has_parts = source == "mnist"
        self.layout = letter_array()
        self.adjacency = adjacency
        self.checksum = checksum
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def part(self) -> Tensor:
        r"""The published part of each image of this selection :math:`(S,)`: 0 to train and 2 to
        test on. Only MNIST has parts.
        """
        session = self.column("session")
        if session is None:
            raise AttributeError("the digits of scikit-learn have no published parts")
        return 2 * session

    @property
    def has_download(self) -> bool:
        r"""Whether there are files to download: not so for the digits of scikit-learn."""
        return self.source == "mnist"

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all images."""
        names = {"class": list(_DIGITS), "group": [], "session": []}
        if self.source == "sklearn":
            digits = load_digits()
            images = torch.from_numpy(digits.images / 16).float().unsqueeze(1)
            large = interpolate(images, size=(_SIZE, _SIZE), mode="bilinear", align_corners=False)
            return self._of_images(large, digits.target), names
        self._verify()
        parts = [self._part(*self.raw_paths[:2]), self._part(*self.raw_paths[2:])]
        images = torch.from_numpy(np.concatenate([images for images, _ in parts]))
        data = self._of_images(
            pad(images.unsqueeze(1), (2, 2, 2, 2)).float() / 255,
            np.concatenate([labels for _, labels in parts]),
        )
        sizes = torch.tensor([len(labels) for _, labels in parts])
        data.session = torch.arange(2).repeat_interleave(sizes)
        return data, names | {"session": ["train", "test"]}

    def _of_images(self, images: Tensor, labels: np.ndarray) -> StaticData:
        number = torch.arange(len(images))
        y = torch.from_numpy(labels).long()
        return self._stacked(x=images.reshape(len(images), -1, 1), y=y, trial=number, group=number)

    @staticmethod
    def _part(images_path: str, labels_path: str) -> tuple[np.ndarray, np.ndarray]:
        images, labels = read_idx(images_path), read_idx(labels_path)
        if images.shape[1:] != (28, 28) or not len(images):
            raise ValueError(
                f"'{images_path}' must hold images of 28 x 28 pixels (got shape {images.shape})"
            )
        if labels.shape != images.shape[:1] or labels.max() > 9:
            raise ValueError(
                f"'{labels_path}' must hold a digit, 0 to 9, for each of {len(images)} images (got "
                f"shape {labels.shape}, up to {labels.max(initial=0)})"
            )
        return images, labels
