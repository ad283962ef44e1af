r"""Data sets of handwritten digits as images on a taxel array."""

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
from torch_geometric_tactile.io._idx_file import read_idx
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
    :class:`~torch_geometric_tactile.datasets.LetterShape`. They are real data for the same models,
    but show ink rather than touch.

    * :obj:`"sklearn"`: the 1,797 images of 8 x 8 pixels in scikit-learn
      (:func:`sklearn.datasets.load_digits`, the test part of UCI's "Optical Recognition of
      Handwritten Digits"), enlarged four times by linear interpolation. **The writers are
      unknown**, so folds share writers between training and test.
    * :obj:`"mnist"`: the 70,000 images of 28 x 28 pixels in MNIST, with a border of two black
      pixels. The training and the test part have different writers. Both :obj:`split` without a
      :obj:`fold` and ``Protocol("given")`` use these parts.

    A sample has grey values :obj:`x` from 0 to 1 and the digit :obj:`y`. :obj:`trial` and
    :obj:`group` are the index of the image. :obj:`image` is a view of :obj:`x` as an image, also in
    batches.

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
        root (str or PathLike, optional): Folder of the data set, only for MNIST. Its four files are
            in the subfolder :obj:`raw`, or are downloaded there. The default is
            :obj:`$TACTILE_DATA/DigitImages`, or a folder in the user's cache if that variable is
            not set.
        fold (int, optional): Index of the test fold.
        split (str, optional): :obj:`"train"`, :obj:`"test"`, or :obj:`None` for all images.
        source (str): :obj:`"sklearn"` or :obj:`"mnist"`.
        folds (int): Number of folds. They are stratified by digit.
        split_seed (int): Seed of the random split.
        adjacency (str, optional): The edges: :obj:`"original"` connects each pixel to four
            neighbours, :obj:`"dense"` to eight. With :obj:`None`, there are no edges.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.
        checksum (bool): Whether to verify the published checksums of the raw files.

    Raises:
        ValueError: If an argument is invalid, or a raw file cannot be read or differs from the
            published one.
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
        r"""The published part of each image of this selection :math:`(S,)`, 0 for training and 2
        for test. Only MNIST has parts.
        """
        session = self.column("session")
        if session is None:
            raise AttributeError("the digits of scikit-learn have no published parts")
        return 2 * session

    @property
    def has_download(self) -> bool:
        r"""Whether the files can be downloaded. The digits of scikit-learn come with it."""
        return self.source == "mnist"

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all images."""
        names = {"class": list(_DIGITS), "group": [], "session": []}
        if self.source == "sklearn":
            digits = load_digits()
            images = torch.from_numpy(digits.images / 16).float().unsqueeze(1)
            large = interpolate(images, size=(_SIZE, _SIZE), mode="bilinear", align_corners=False)
            return self._images_to_data(large, digits.target), names
        self._verify()
        parts = [self._read_part(*self.raw_paths[:2]), self._read_part(*self.raw_paths[2:])]
        images = torch.from_numpy(np.concatenate([images for images, _ in parts]))
        data = self._images_to_data(
            pad(images.unsqueeze(1), (2, 2, 2, 2)).float() / 255,
            np.concatenate([labels for _, labels in parts]),
        )
        sizes = torch.tensor([len(labels) for _, labels in parts])
        data.session = torch.arange(2).repeat_interleave(sizes)
        return data, names | {"session": ["train", "test"]}

    def _images_to_data(self, images: Tensor, labels: np.ndarray) -> StaticData:
        index = torch.arange(len(images))
        y = torch.from_numpy(labels).long()
        return self._to_data(x=images.reshape(len(images), -1, 1), y=y, trial=index, group=index)

    @staticmethod
    def _read_part(images_path: str, labels_path: str) -> tuple[np.ndarray, np.ndarray]:
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
