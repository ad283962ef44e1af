r"""A data set of letters pressed on a taxel array."""

import hashlib
import logging
import string
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import torch
from torch import Tensor
from torch_geometric.data.summary import Stats, Summary
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.datasets._image_dataset import ImageDataset, has_image
from torch_geometric_tactile.datasets._letter_files import (
    LAYOUT,
    SIMULATION,
    Presses,
    check_folders,
    folders,
    is_synthetic,
    letter_files,
    letter_folder,
    read_presses,
)
from torch_geometric_tactile.datasets._root import default_root
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, letter_array
from torch_geometric_tactile.transforms import (
    RandomContrast,
    RandomInversion,
    RandomMirror,
    RandomShift,
)

_Inversion = Literal["grey", "mirror"]
_CONTENT = "content=2"  # increase when the columns of the processed file change
_MAX_LOGGED_FAULTS = 10
_GRID_TOLERANCE = 1e-6  # metres
_logger = logging.getLogger(__name__)


class LetterShape(ImageDataset):
    r"""Letters pressed on an array of 32 x 32 pixels, as in the "A Novel Bilinear Feature and
    Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors
    2020, 20, 5822).

    **The recordings of the paper are not public.** This class reads a folder of your own
    recordings, or of presses simulated by ``tactile simulate --objects letters``.

    The folder has a subfolder for each letter, :obj:`A` to :obj:`Z`, with files of matrices:

    * ``.csv``, ``.png``: one matrix of 32 x 32,
    * ``.npy``, ``.mat``: one matrix, or a stack of matrices :math:`(n, 32, 32)`.

    Numbers of type uint8 or uint16, as in PNG files, are fractions of full scale. All other numbers
    are pressures in the unit of :obj:`full_scale`. Unreadable files and files of the wrong size are
    left out. Matrices with a missing reading (NaN), a negative pressure or a pressure above full
    scale are left out as well. A warning reports their number, and :obj:`left_out` lists the
    reasons.

    A sample is a press or an augmented copy of a press:

    * :obj:`x`: pressures as grey values from 0 to 1;
    * :obj:`y`: the letter;
    * :obj:`trial`, :obj:`group`: the index of the press, which its copies share;
    * :obj:`copy`: 0 for the recorded press. For all samples, use :obj:`dataset.column("copy")`,
      since :obj:`dataset.copy` is a method;
    * :obj:`image`: a view of :obj:`x` as an image, also in batches.

    Copies are shifted by up to 3 pixels (on grids only), stretched in contrast, and inverted with a
    probability of 0.5. The paper names translation, "random inversion" and contrast enhancement;
    their sizes and order are choices of this package. Copies of a press must be on the same side of
    a split. :obj:`fold` ensures this, since it uses the split of ``Protocol("trial", folds=5,
    stratify="y")``. Test parts include the copies of their presses. Use :obj:`copies=1` for the
    same folds without copies.

    .. list-table:: STATS of the original, as published
        :header-rows: 1

        * - #letters
          - #presses
          - #samples
          - #nodes
          - #features
          - #classes
        * - 26
          - 13,000
          - 39,000
          - 1,024
          - 1
          - 26

    For another sensor, the folder has a file :obj:`layout.json`, written by
    :meth:`TaxelLayout.save <torch_geometric_tactile.sensors.TaxelLayout.save>`. The other files
    are then npy files with the :math:`N` readings of that sensor, :math:`(N,)` or :math:`(n, N)`.

    Args:
        root (str or PathLike, optional): Folder of the data set. The folders of the letters are in
            its subfolder :obj:`raw` or directly in it. The default is
            :obj:`$TACTILE_DATA/LetterShape`, or a folder in the user's cache if that variable is
            not set.
        fold (int, optional): Index of the test fold.
        split (str, optional): :obj:`"train"` (all other folds), :obj:`"test"`, or :obj:`None` for
            all samples.
        folds (int): Number of folds. They are stratified by letter.
        split_seed (int): Seed of the random split.
        copies (int): Number of samples of each press: the recorded press and its augmented copies.
        inversion (str, optional): The meaning of "random inversion": :obj:`"grey"` swaps black and
            white (:class:`~torch_geometric_tactile.transforms.RandomInversion`), :obj:`"mirror"`
            swaps left and right (:class:`~torch_geometric_tactile.transforms.RandomMirror`), and
            :obj:`None` is no inversion.
        augment (callable, optional): The transform that creates the copies. The default is
            :func:`letter_augmentation`.
        augment_seed (int): Seed of the augmentation. The copies in a file do not depend on other
            files.
        adjacency (str, optional): The edges: :obj:`"original"` connects each pixel to four
            neighbours, :obj:`"dense"` to eight. With :obj:`None`, there are no edges.
        full_scale (float): Pressure of the grey value 1 in kilopascals, as in the files.
        letters (sequence of str, optional): Names of the folders, if they are not letters.
        layout (TaxelLayout or str or PathLike, optional): The taxels, if there is no
            :obj:`layout.json`.
        variable (str, optional): Name of the variable in MAT files with several variables.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no presses.
        ValueError: If a folder is missing or has an unknown name, a letter has no valid press, or
            an argument is invalid.

    Examples:
        >>> dataset = LetterShape("letters", fold=0, split="train")  # doctest: +SKIP
        >>> dataset[0].image.shape  # doctest: +SKIP
        torch.Size([1, 1, 32, 32])
    """

    _folder = "LetterShape"

    def __init__(
        self,
        root: PathLike | None = None,
        fold: int | None = None,
        split: Literal["train", "test"] | None = None,
        *,
        folds: int = 5,
        split_seed: int = 0,
        copies: int = 3,
        inversion: _Inversion | None = "grey",
        augment: Transform | None = None,
        augment_seed: int = 0,
        adjacency: str | None = "original",
        full_scale: float = 100.0,
        letters: Sequence[str] | None = None,
        layout: TaxelLayout | PathLike | None = None,
        variable: str | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        if isinstance(copies, bool) or not isinstance(copies, int) or copies < 1:
            raise ValueError(f"'copies' must be an integer, at least 1 (got {copies})")
        need(0 < full_scale < float("inf"), "'full_scale' must be a positive pressure", full_scale)
        root = Path(default_root(self._folder) if root is None else root).expanduser()
        self.fold, self.split, self.folds, self.split_seed = fold, split, folds, split_seed
        self.copies = copies
        self.full_scale = float(full_scale)
        self.letters = _checked_letters(letters)
        self.adjacency = adjacency
        self.layout = _load_layout(letter_folder(root), layout)
        self.inversion = inversion
        # Always built, so that an invalid 'inversion' is an error even if 'augment' replaces it.
        default_augment = letter_augmentation(inversion, layout=self.layout)
        self.augment = default_augment if augment is None else augment
        self.augment_seed = augment_seed
        self.variable = variable
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def raw_dir(self) -> str:
        r"""The folder of the letters: :obj:`root/raw`, or :obj:`root` if only that has letters."""
        return str(letter_folder(Path(self.root)))

    @property
    def raw_file_names(self) -> list[str]:
        r"""The sorted files of all letters."""
        return letter_files(Path(self.raw_dir), self.letters)

    @property
    def processed_file_names(self) -> str:
        r"""The processed file of all folds. Each number of copies has a separate file."""
        return f"letter_shape_{self.copies}.pt"

    def raw_state(self) -> list[str]:
        r"""Returns the names of the folders, and a text for each file that changes with its
        content.
        """
        names = ", ".join(folders(Path(self.raw_dir)))
        return [_CONTENT, f"folders={names}", *super().raw_state()]

    def _state_names(self) -> list[str]:
        return [LAYOUT, SIMULATION, *self.raw_file_names]

    def _need_files(self) -> None:
        if not folders(Path(self.raw_dir)):
            raise FileNotFoundError(
                f"there are no letters in '{self.raw_dir}': put a folder for each letter there, "
                f"'{self.letters[0]}' to '{self.letters[-1]}', with CSV, npy, PNG or MAT files of "
                "its presses. The original is not public; to simulate presses, run: tactile "
                "simulate --objects letters"
            )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all presses and creates their copies."""
        folder = Path(self.raw_dir)
        check_folders(folder, self.letters)
        synthetic = is_synthetic(folder)
        left_out: list[str] = []
        size = (32, 32) if has_image(self.layout) else (self.layout.num_taxels,)
        press_files = list(
            read_presses(
                folder, self.letters, size, self.full_scale, left_out.append, self.variable
            )
        )
        _warn_of_faults(left_out, folder)
        num_presses = [0] * len(self.letters)
        for presses in press_files:
            num_presses[presses.letter] += len(presses.names)
        self._check_counts(num_presses, left_out)
        press = torch.arange(sum(num_presses)).repeat_interleave(self.copies)
        letter = torch.arange(len(num_presses)).repeat_interleave(torch.tensor(num_presses))
        data = self._to_data(
            x=torch.cat([self._with_copies(presses) for presses in press_files]),
            y=letter[press],
            trial=press,
            group=press,
            copy=torch.arange(self.copies).repeat(sum(num_presses)),
        )
        names = {
            "class": list(self.letters),
            "group": [name for presses in press_files for name in presses.names],
            "session": [],
            "left_out": left_out,
            "synthetic": [SIMULATION] if synthetic else [],
        }
        return data, names

    def _check_counts(self, num_presses: Sequence[int], left_out: Sequence[str]) -> None:
        empty = [name for name, count in zip(self.letters, num_presses, strict=True) if not count]
        if empty:
            faults = [text for text in left_out if text.lstrip("'").startswith(f"{empty[0]}/")]
            raise ValueError(
                f"every letter must have a valid press (got none of '{empty[0]}' in "
                f"'{self.raw_dir}', {len(empty)} letters in all): "
                f"{faults[0] if faults else 'its folder is empty'}"
            )

    def _with_copies(self, presses: Presses) -> Tensor:
        # Returns the readings (n * copies, N, 1); each press is followed by its augmented copies.
        data = StaticData(x=torch.from_numpy(presses.grey).unsqueeze(-1))
        readings = [data.x]
        # A seed for each file, so that its copies do not change when files are added.
        seed_text = f"{self.augment_seed} {presses.file}".encode()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int.from_bytes(hashlib.blake2b(seed_text, digest_size=7).digest()))
            for _ in range(self.copies - 1):
                copy = apply_transform(self.augment, data.index_select(slice(None)))
                readings.append(copy.x)
        return torch.stack(readings, dim=1).flatten(0, 1)

    @property
    def left_out(self) -> list[str]:
        r"""The files and matrices that are left out, each with the reason."""
        return list(self._names["left_out"])

    @property
    def synthetic(self) -> bool:
        r"""Whether the presses are simulated."""
        return bool(self._names["synthetic"])

    def get_summary(self) -> "_LetterSummary":
        r"""Returns summary statistics of this selection: PyG's statistics, the numbers of presses
        and samples of each letter, and the files that are left out.
        """
        return _LetterSummary.from_letters(self)


@dataclass(repr=False, kw_only=True)
class _LetterSummary(Summary):
    r"""PyG's summary of a data set, with the numbers of letters and presses."""

    num_presses: int
    copies: int
    num_samples_per_letter: dict[str, int]
    num_presses_per_letter: dict[str, int]
    left_out: list[str]
    synthetic: bool

    @classmethod
    def from_letters(cls, dataset: LetterShape) -> Self:
        r"""Returns the summary of a selection. Samples are not loaded one by one, since all have
        the same numbers of nodes and edges.
        """
        y, trial = dataset.column("y"), dataset.column("trial")
        assert y is not None
        assert trial is not None
        presses = torch.stack([trial, y]).unique(dim=1)
        num_classes = len(dataset.class_names)
        num_edges = 0 if dataset._data.edge_index is None else dataset._data.edge_index.size(1)
        return cls(
            name=type(dataset).__name__,
            num_graphs=len(dataset),
            num_nodes=_constant_stats(dataset.layout.num_taxels),
            num_edges=_constant_stats(num_edges),
            num_presses=presses.size(1),
            copies=dataset.copies,
            num_samples_per_letter=_counts(y.bincount(minlength=num_classes), dataset.class_names),
            num_presses_per_letter=_counts(
                presses[1].bincount(minlength=num_classes), dataset.class_names
            ),
            left_out=dataset.left_out,
            synthetic=dataset.synthetic,
        )

    def format(self, fmt: str = "psql") -> str:
        r"""Formats the summary as lines of text."""
        origin = "simulated" if self.synthetic else "recorded"
        letters = ", ".join(
            f"{name} {count} ({self.num_presses_per_letter[name]})"
            for name, count in self.num_samples_per_letter.items()
        )
        return (
            f"{self.name} (#graphs={self.num_graphs}): {self.num_presses} {origin} presses, stored "
            f"{self.copies} times\n"
            f"#nodes={self.num_nodes.mean:.0f}, #edges={self.num_edges.mean:.0f}\n"
            f"samples (presses) of each letter: {letters}\n"
            f"files or matrices left out: {len(self.left_out)}"
        )


def _counts(counts: Any, names: list[str]) -> dict[str, int]:
    return dict(zip(names, counts.tolist(), strict=True))


def _constant_stats(value: int) -> Stats:
    number = float(value)
    return Stats(number, 0.0, number, number, number, number, number)


def letter_augmentation(
    inversion: _Inversion | None = "grey",
    *,
    shift: int = 3,
    contrast: float = 1.5,
    layout: TaxelLayout | None = None,
) -> Compose:
    r"""Returns the augmentation of :class:`LetterShape`: translation, then contrast, then
    inversion.

    Args:
        inversion (str, optional): :obj:`"grey"`, :obj:`"mirror"` or :obj:`None`.
        shift (int): Largest translation in pixels, along rows and along columns.
        contrast (float): Largest factor of contrast, above 1.
        layout (TaxelLayout, optional): The taxels; the 32 x 32 array by default. The translation is
            left out unless the taxels form a regular grid without gaps, since otherwise a taxel may
            have no neighbour from which to take its reading.

    Raises:
        ValueError: If an argument is invalid, or the layout cannot be mirrored.

    Examples:
        >>> letter_augmentation()
        Compose([
          RandomShift('letter_array', rows=3, columns=3, value=0.0),
          RandomContrast(low=1.0, high=1.5, center=None),
          RandomInversion(p=0.5, low=0.0, high=1.0)
        ])
    """
    if inversion not in ("grey", "mirror", None):
        raise ValueError(f"'inversion' must be 'grey', 'mirror' or None (got {inversion!r})")
    layout = letter_array() if layout is None else layout
    transforms: list[Transform] = []
    if _is_full_grid(layout):
        transforms.append(RandomShift(layout, shift, shift))
    transforms.append(RandomContrast(1.0, contrast))
    if inversion == "grey":
        transforms.append(RandomInversion())
    elif inversion == "mirror":
        transforms.append(RandomMirror(layout))
    return Compose(transforms)


def _is_full_grid(layout: TaxelLayout) -> bool:
    # Returns whether each cell of the image map has a taxel and the positions are an affine
    # function of row and column, which is fitted by least squares.
    if layout.image_map is None:
        return False
    rows, columns = (layout.image_map.amax(dim=0) + 1).tolist()
    if rows * columns != layout.num_taxels:
        return False
    cells = torch.cat([layout.image_map, torch.ones_like(layout.image_map[:, :1])], dim=1).double()
    pos = layout.pos.double()
    steps = torch.linalg.pinv(cells) @ pos
    return torch.allclose(cells @ steps, pos, rtol=0.0, atol=_GRID_TOLERANCE)


def _checked_letters(letters: Sequence[str] | None) -> tuple[str, ...]:
    names = tuple(string.ascii_uppercase) if letters is None else tuple(letters)
    are_names = all(isinstance(name, str) and name and "/" not in name for name in names)
    if not names or not are_names or len(set(names)) < len(names):
        raise ValueError(f"'letters' must be different names of folders (got {letters!r})")
    return names


def _load_layout(folder: Path, layout: TaxelLayout | PathLike | None) -> TaxelLayout:
    if layout is not None:
        return as_layout(layout)
    path = folder / LAYOUT
    return TaxelLayout.load(path) if path.is_file() else letter_array()


def _warn_of_faults(left_out: Sequence[str], folder: Path) -> None:
    if left_out:
        _logger.warning(
            "'%s': %d files or matrices are left out: %s",
            folder,
            len(left_out),
            short_list(left_out, _MAX_LOGGED_FAULTS, ending="; and {} more", separator="; "),
        )
