r"""Letters pressed on an array."""

import hashlib
import logging
import string
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor
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
from torch_geometric_tactile.datasets._letter_summary import LetterSummary
from torch_geometric_tactile.datasets.root import default_root
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, letter_array
from torch_geometric_tactile.transforms import (
    RandomContrast,
    RandomInversion,
    RandomMirror,
    RandomShift,
)

_Inversion = Literal["grey", "mirror"]
_CONTENT = "content=2"  # to be raised when the processed file gets other columns
_NAMED = 10
_SAME_PLACE = 1e-6  # m
_logger = logging.getLogger(__name__)


class LetterShape(ImageDataset):
    r"""Letters pressed on an array of 32 x 32 pixels, as of the "A Novel Bilinear Feature and
    Multi-Layer Fused Convolutional Neural Network for Tactile Shape Recognition" paper (Sensors
    2020, 20, 5822).

    **The recordings of the paper are not public.** This class reads a folder of yours, or the one
    that ``tactile simulate --objects letters`` makes.

    The folder has a folder for each letter, :obj:`A` to :obj:`Z`, with files of matrices:

    * ``.csv``, ``.png``: one matrix of 32 x 32,
    * ``.npy``, ``.mat``: one, or a stack of them :math:`(n, 32, 32)`.

    Numbers are pressures in the unit of :obj:`full_scale`, but those of type uint8 or uint16 (all
    of PNG) are parts of full scale. A file that cannot be read or has another size, and a matrix
    with a missing reading (NaN), a negative pressure or one above full scale are left out: a
    warning counts them, and :obj:`left_out` has them all, each with its fault.

    A sample is a press, or an augmented copy of one: :obj:`x` is its pressures as grey values, 0 to
    1, :obj:`y` the number of its letter, :obj:`trial` and :obj:`group` the number of the press,
    which all of its copies share, and :obj:`copy` is 0 for the press as it was recorded. (The
    numbers of all samples are :obj:`dataset.column("copy")`, since :obj:`dataset.copy` is a
    method.) :obj:`data.image` of samples and batches is a view of :obj:`x` as an image.

    Copies are shifted by up to 3 pixels (on grids only) and stretched in contrast, and every second
    one is inverted. The paper names translation, "random inversion" and contrast enhancement, and
    gives no more: sizes and order are ours. A split must keep the copies of a press together, or a
    model is tested on what it was trained on: :obj:`fold` does, and so does ``Protocol("trial",
    folds=5, stratify="y")``, which it is. Test parts have the copies of their presses, too; with
    :obj:`copies=1` the same folds have none.

    .. list-table:: STATS, of the original as published
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

    If the folder has a file :obj:`layout.json` of another sensor's taxels, as
    :meth:`TaxelLayout.save <torch_geometric_tactile.sensors.TaxelLayout.save>` writes it, the files
    are npy with rows of its :math:`N` readings, :math:`(N,)` or :math:`(n, N)`.

    Args:
        root (str or PathLike, optional): Folder of the data set; the folders of the letters are in
            its folder :obj:`raw` or in itself. If left out, :obj:`$TACTILE_DATA/LetterShape` or a
            folder in the user's cache.
        fold (int, optional): Which of the :obj:`folds` is tested on.
        split (str, optional): :obj:`"train"`, all other folds, or :obj:`"test"`; everything with
            :obj:`None`.
        folds (int): Number of folds, which all have their share of every letter.
        split_seed (int): Which of the random splits.
        copies (int): How often a press is stored: once as it was recorded, the others augmented.
        inversion (str, optional): What "random inversion" is taken for: :obj:`"grey"` makes black
            white (:class:`~torch_geometric_tactile.transforms.RandomInversion`), :obj:`"mirror"`
            left right (:class:`~torch_geometric_tactile.transforms.RandomMirror`); none with
            :obj:`None`.
        augment (callable, optional): Makes the copies, in place of all that.
        augment_seed (int): The seed of what is random in it. The copies of a file do not depend on
            other files.
        adjacency (str, optional): Which edges of the layout: :obj:`"original"` joins four
            neighbours, :obj:`"dense"` eight; no edges with :obj:`None`.
        full_scale (float): The pressure whose grey value is 1, in kilopascal as the files.
        letters (sequence of str, optional): The names of the folders, if other classes are pressed.
        layout (TaxelLayout or str or PathLike, optional): The taxels, if there is no
            :obj:`layout.json`.
        variable (str, optional): Name of the variable of MAT files that have several.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no presses.
        ValueError: If a folder is missing or of no letter, a letter has no press that can be used,
            or an argument is wrong.

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
            raise ValueError(f"'copies' must be a whole number, at least 1 (got {copies})")
        need(0 < full_scale < float("inf"), "'full_scale' must be a positive pressure", full_scale)
        root = Path(default_root(self._folder) if root is None else root).expanduser()
        self.fold, self.split, self.folds, self.split_seed = fold, split, folds, split_seed
        self.copies = copies
        self.full_scale = float(full_scale)
        self.letters = _checked_letters(letters)
        self.adjacency = adjacency
        self.layout = _layout(letter_folder(root), layout)
        self.inversion = inversion
        own = letter_augmentation(inversion, layout=self.layout)
        self.augment = own if augment is None else augment
        self.augment_seed = augment_seed
        self.variable = variable
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def raw_dir(self) -> str:
        r"""The folder of the letters: :obj:`root/raw`, or :obj:`root` where that has none."""
        return str(letter_folder(Path(self.root)))

    @property
    def raw_file_names(self) -> list[str]:
        r"""The files of all letters, in order."""
        return letter_files(Path(self.raw_dir), self.letters)

    @property
    def processed_file_names(self) -> str:
        r"""One file for all folds."""
        return f"letter_shape_{self.copies}.pt"

    def raw_state(self) -> list[str]:
        r"""Returns the folders of the letters, and their files with what their contents are known
        by.
        """
        listed = ", ".join(folders(Path(self.raw_dir)))
        return [_CONTENT, f"folders={listed}", *super().raw_state()]

    def _state_names(self) -> list[str]:
        return [LAYOUT, SIMULATION, *self.raw_file_names]

    def _need_files(self) -> None:
        if not folders(Path(self.raw_dir)):
            raise FileNotFoundError(
                f"there are no letters in '{self.raw_dir}': put a folder for each there, "
                f"'{self.letters[0]}' to '{self.letters[-1]}', with CSV, npy, PNG or MAT files of "
                "its presses. The original is not public; simulated presses are made by: tactile "
                "simulate --objects letters"
            )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all presses, and makes the copies."""
        folder = Path(self.raw_dir)
        check_folders(folder, self.letters)
        synthetic = is_synthetic(folder)
        left_out: list[str] = []
        size = (32, 32) if has_image(self.layout) else (self.layout.num_taxels,)
        found = list(
            read_presses(
                folder, self.letters, size, self.full_scale, left_out.append, self.variable
            )
        )
        _report(left_out, folder)
        counts = [0] * len(self.letters)
        for presses in found:
            counts[presses.letter] += len(presses.names)
        self._check_counts(counts, left_out)
        press = torch.arange(sum(counts)).repeat_interleave(self.copies)
        letter = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts))
        data = self._stacked(
            x=torch.cat([self._with_copies(presses) for presses in found]),
            y=letter[press],
            trial=press,
            group=press,
            copy=torch.arange(self.copies).repeat(sum(counts)),
        )
        names = {
            "class": list(self.letters),
            "group": [name for presses in found for name in presses.names],
            "session": [],
            "left_out": left_out,
            "synthetic": [SIMULATION] if synthetic else [],
        }
        return data, names

    def _check_counts(self, counts: Sequence[int], left_out: Sequence[str]) -> None:
        empty = [name for name, count in zip(self.letters, counts, strict=True) if not count]
        if empty:
            why = [text for text in left_out if text.lstrip("'").startswith(f"{empty[0]}/")]
            raise ValueError(
                f"every letter must have a press that can be used (got none of '{empty[0]}' in "
                f"'{self.raw_dir}', {len(empty)} letters in all): "
                f"{why[0] if why else 'its folder is empty'}"
            )

    def _with_copies(self, presses: Presses) -> Tensor:
        # (n * copies, N, 1), the copies of a press behind it.
        data = StaticData(x=torch.from_numpy(presses.grey).unsqueeze(-1))
        out = [data.x]
        text = f"{self.augment_seed} {presses.file}".encode()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int.from_bytes(hashlib.blake2b(text, digest_size=7).digest()))
            for _ in range(self.copies - 1):
                copied = apply_transform(self.augment, data.index_select(slice(None)))
                out.append(copied.x)
        return torch.stack(out, dim=1).flatten(0, 1)

    @property
    def left_out(self) -> list[str]:
        r"""The files and matrices that were left out, each with its fault."""
        return list(self._names["left_out"])

    @property
    def synthetic(self) -> bool:
        r"""Whether a simulator made the presses."""
        return bool(self._names["synthetic"])

    def get_summary(self) -> LetterSummary:
        r"""Collects summary statistics of this selection: PyG's, and the numbers of presses, of
        samples of each letter, and of files left out.
        """
        return LetterSummary.from_letters(self)


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
        shift (int): By how many pixels at most, along rows and along columns.
        contrast (float): The largest factor of contrast, above 1.
        layout (TaxelLayout, optional): The taxels, if others than of the 32 x 32 array. Only on a
            grid without gaps they are shifted: elsewhere, there is no taxel a step away, or the
            step is another one from row to row.

    Raises:
        ValueError: If an argument is none of these, or the layout cannot be mirrored.

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
    parts: list[Transform] = []
    if _is_full_grid(layout):
        parts.append(RandomShift(layout, shift, shift))
    parts.append(RandomContrast(1.0, contrast))
    if inversion == "grey":
        parts.append(RandomInversion())
    elif inversion == "mirror":
        parts.append(RandomMirror(layout))
    return Compose(parts)


def _is_full_grid(layout: TaxelLayout) -> bool:
    # Whether each cell of the map has a taxel, and a step on the map is the same step everywhere.
    if layout.image_map is None:
        return False
    rows, columns = (layout.image_map.amax(dim=0) + 1).tolist()
    if rows * columns != layout.num_taxels:
        return False
    cells = torch.cat([layout.image_map, torch.ones_like(layout.image_map[:, :1])], dim=1).double()
    places = layout.pos.double()
    steps = torch.linalg.pinv(cells) @ places
    return torch.allclose(cells @ steps, places, rtol=0.0, atol=_SAME_PLACE)


def _checked_letters(letters: Sequence[str] | None) -> tuple[str, ...]:
    names = tuple(string.ascii_uppercase) if letters is None else tuple(letters)
    are_names = all(isinstance(name, str) and name and "/" not in name for name in names)
    if not names or not are_names or len(set(names)) < len(names):
        raise ValueError(f"'letters' must be names of folders, each once (got {letters!r})")
    return names


def _layout(folder: Path, layout: TaxelLayout | PathLike | None) -> TaxelLayout:
    if layout is not None:
        return as_layout(layout)
    path = folder / LAYOUT
    return TaxelLayout.load(path) if path.is_file() else letter_array()


def _report(left_out: Sequence[str], folder: Path) -> None:
    if left_out:
        _logger.warning(
            "'%s': %d files or matrices are left out: %s",
            folder,
            len(left_out),
            short_list(left_out, _NAMED, ending="; and {} more", separator="; "),
        )
