r"""Directions of slip on one BioTac SP."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, frames_of_trials
from torch_geometric_tactile.datasets._trial import check_one_file_each
from torch_geometric_tactile.io import read_biotac_sp_dos_csv
from torch_geometric_tactile.sensors import biotac_sp

#: The names of the directions by those of their folders, in the order of their numbers.
_DIRECTIONS = {
    "n": "north",
    "e": "east",
    "s": "south",
    "w": "west",
    "cw": "clockwise",
    "aw": "anticlockwise",
    "t": "touch",
}
#: The authors' sets of objects. Other objects are of the set "other".
_SETS = {
    "basic": ("case", "hd", "pen", "sponge"),
    "solids": ("bottle", "cardboard"),
    "small": ("brush", "screw"),
    "textures": ("bubbles", "plate", "striped"),
    "other": (),
}
_MISSPELT = {"strippes": "striped"}  # s/strippes305.csv
_NAME = re.compile(r"(?P<object>.*[^0-9])(?P<number>[0-9]{1,9})", re.ASCII)


class _Sequence(NamedTuple):
    direction: str  # the lower-case name of its folder
    object_name: str
    number: int
    path: Path


class BioTacSPDoS(PlacedFiles):
    r"""The BioTac SP DoS data set (`BioTacSP-DoS <https://github.com/yayaneath/BioTacSP-DoS>`_,
    Zapata-Impata, Gil and Torres, 2018): an object is moved on one BioTac SP in a direction, turned
    on it, or held still; about three seconds at 100 readings a second.

    A sample is a frame: 24 electrodes with one channel, in raw counts. :obj:`y` is the direction:
    north, east, south, west, clockwise, anticlockwise or, without slip, touch. :obj:`trial` numbers
    the sequences, :obj:`group` the eleven objects, :obj:`time` are seconds from the start, at the
    nominal rate. Without a :obj:`pre_transform` such as
    :class:`~torch_geometric_tactile.transforms.KNNGraph` there are no edges.

    :obj:`set` is which of the authors' four sets of objects a sample is of: basic (case, hd, pen,
    sponge), solids (bottle, cardboard), small (brush, screw) or textures (bubbles, plate, striped).
    With :obj:`part`, ``Protocol("given")`` trains on the basic objects and tests on the others;
    their repository names the sets, and not what they trained on.

    .. list-table:: STATS, as published
        :header-rows: 1

        * - #sequences
          - #graphs
          - #nodes
          - #features
          - #classes
          - #objects
        * - 306
          - 84,622
          - 24
          - 1
          - 7
          - 11

    All files were read, at commit ``8e6f398``: 43 or 44 sequences of a direction, 27 to 29 of an
    object, of 270 to 281 readings. The file ``s/strippes305.csv`` is counted as striped.

    The files are not downloaded and do not come with this package, since their repository names no
    licence: get them there, and mind that yourself.

    Args:
        root (str or PathLike, optional): Folder of the data set; its folders ``n``, ``e``, ``s``,
            ``w``, ``cw``, ``aw`` and ``t``, with files ``<object><number>.csv``, are in its folder
            :obj:`raw` or :obj:`csvs` or in itself. If left out, :obj:`$TACTILE_DATA/BioTacSPDoS` or
            a folder in the user's cache.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no files, or those of a direction are missing.
        ValueError: If a file cannot be read or has another name, or a sequence is there twice.

    Examples:
        >>> from torch_geometric_tactile.data import Protocol
        >>> dataset = BioTacSPDoS("dos")  # doctest: +SKIP
        >>> Protocol("trial", folds=5, stratify="y").split(dataset)  # doctest: +SKIP
    """

    group_kind = "object"
    _folder = "BioTacSPDoS"
    _folders = ("raw", "csvs", ".")
    _processed_name = "biotac_sp_dos_objects.pt"

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        self.layout = biotac_sp()
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    def _files_in(self, folder: Path) -> list[Path]:
        return [sequence.path for sequence in _sequences(folder)]

    def _need_files(self) -> None:
        folder = Path(self.raw_dir)
        there = {sequence.direction for sequence in _sequences(folder)}
        missing = [name for name in _DIRECTIONS if name not in there]
        if missing:
            raise FileNotFoundError(
                f"'{folder}' must have files <object><number>.csv in a folder for each direction, "
                f"{', '.join(_DIRECTIONS)} (got none in {', '.join(map(repr, missing))}): put the "
                "folder 'csvs' of https://github.com/yayaneath/BioTacSP-DoS there"
            )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all files."""
        sequences = _sequences(Path(self.raw_dir))
        objects = sorted({sequence.object_name for sequence in sequences})
        recordings = [read_biotac_sp_dos_csv(sequence.path) for sequence in sequences]
        directions = [*_DIRECTIONS]
        number = {name: i for i, names in enumerate(_SETS.values()) for name in names}
        sets = [number.get(s.object_name, len(_SETS) - 1) for s in sequences]
        data = StaticData(
            x=torch.from_numpy(np.concatenate([r.tactile for r in recordings])),
            pos=self.layout.pos,
            normal=self.layout.normal,
            time=torch.from_numpy(np.concatenate([r.time for r in recordings])),
            **frames_of_trials(
                [recording.num_frames for recording in recordings],
                y=[directions.index(s.direction) for s in sequences],
                group=[objects.index(s.object_name) for s in sequences],
                set=sets,
                part=[2 * (i > 0) for i in sets],
            ),
        )
        names = [f"{s.direction}/{s.path.stem}" for s in sequences]
        kinds = {"class": [*_DIRECTIONS.values()], "group": objects, "set": [*_SETS]}
        return data, {**kinds, "trial": names}


def _folders(parent: Path) -> list[Path]:
    if not parent.is_dir():
        return []
    return sorted(p for p in parent.iterdir() if p.name.lower() in _DIRECTIONS and p.is_dir())


def _sequences(parent: Path) -> list[_Sequence]:
    found = []
    for folder in _folders(parent):
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() != ".csv" or path.name.startswith("."):
                continue
            name = _NAME.fullmatch(path.stem)
            if name is None:
                raise ValueError(f"'{path}' must be named <object><number>.csv, as 'bottle0.csv'")
            item = _MISSPELT.get(name["object"], name["object"])
            found.append(_Sequence(folder.name.lower(), item, int(name["number"]), path))
    check_one_file_each(
        (s[:3], f"sequence {s.number} of '{s.object_name}'", f"'{s.path}'") for s in found
    )
    order = [*_DIRECTIONS]
    return sorted(found, key=lambda s: (order.index(s.direction), s.object_name, s.number))
