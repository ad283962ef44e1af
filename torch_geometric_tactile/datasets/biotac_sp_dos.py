r"""The BioTac SP data set of slip directions."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, trials_to_frames
from torch_geometric_tactile.datasets._trial import check_unique_trials
from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_dos_csv
from torch_geometric_tactile.sensors import biotac_sp

#: The names of the directions by the names of their folders, in the order of the class indices.
_DIRECTIONS = {
    "n": "north",
    "e": "east",
    "s": "south",
    "w": "west",
    "cw": "clockwise",
    "aw": "anticlockwise",
    "t": "touch",
}
#: The authors' sets of objects. All remaining objects are in the set "other".
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
    r"""The BioTac SP DoS data set of slip directions (`BioTacSP-DoS
    <https://github.com/yayaneath/BioTacSP-DoS>`_, Zapata-Impata, Gil and Torres, 2018). An object
    is moved over one BioTac SP in a direction, turned on it, or held still, for about three seconds
    at 100 readings per second.

    A sample is a frame of 24 electrodes with one channel in raw counts. The other attributes are:

    * :obj:`y`: the direction, which is north, east, south, west, clockwise, anticlockwise or,
      without slip, touch;
    * :obj:`trial`: the sequence;
    * :obj:`group`: one of the eleven objects;
    * :obj:`set`: the authors' set to which the object belongs, which is basic (case, hd, pen,
      sponge), solids (bottle, cardboard), small (brush, screw) or textures (bubbles, plate,
      striped);
    * :obj:`part`: 0 for the basic objects and 2 for all others. ``Protocol("given")`` uses it to
      train on the basic objects and test on the others. This split is a choice of this package: the
      repository names the sets but not the training objects;
    * :obj:`time`: seconds from the start at the nominal rate.

    The layout has no edges. To add edges, use a :obj:`pre_transform` such as
    :class:`~torch_geometric_tactile.transforms.KNNGraph`.

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

    These numbers agree with commit ``8e6f398``, which has 43 or 44 sequences of each direction and
    27 to 29 sequences of each object. A sequence has 270 to 281 readings. The file
    ``s/strippes305.csv`` is counted as striped.

    The repository names no licence. The files are therefore neither downloaded nor part of this
    package: get them with ``git clone``, and check whether you may use them.

    Args:
        root (str or PathLike, optional): Folder of the data set. Its folders ``n``, ``e``, ``s``,
            ``w``, ``cw``, ``aw`` and ``t``, with files ``<object><number>.csv``, are in the
            subfolder :obj:`raw` or :obj:`csvs`, or directly in it. The default is
            :obj:`$TACTILE_DATA/BioTacSPDoS`, or a folder in the user's cache if that variable is
            not set.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If a direction has no files.
        ValueError: If a file cannot be read or is not named as above, or two files hold the same
            sequence.

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
        directions = {sequence.direction for sequence in _sequences(folder)}
        missing = [name for name in _DIRECTIONS if name not in directions]
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
        set_index = {name: i for i, names in enumerate(_SETS.values()) for name in names}
        sets = [set_index.get(s.object_name, len(_SETS) - 1) for s in sequences]
        data = StaticData(
            x=torch.from_numpy(np.concatenate([r.tactile for r in recordings])),
            pos=self.layout.pos,
            normal=self.layout.normal,
            time=torch.from_numpy(np.concatenate([r.time for r in recordings])),
            **trials_to_frames(
                [recording.num_frames for recording in recordings],
                y=[directions.index(s.direction) for s in sequences],
                group=[objects.index(s.object_name) for s in sequences],
                set=sets,
                part=[2 * (i > 0) for i in sets],
            ),
        )
        trial_names = [f"{s.direction}/{s.path.stem}" for s in sequences]
        names = {"class": [*_DIRECTIONS.values()], "group": objects, "set": [*_SETS]}
        return data, {**names, "trial": trial_names}


def _direction_folders(parent: Path) -> list[Path]:
    if not parent.is_dir():
        return []
    return sorted(p for p in parent.iterdir() if p.name.lower() in _DIRECTIONS and p.is_dir())


def _sequences(parent: Path) -> list[_Sequence]:
    sequences = []
    for folder in _direction_folders(parent):
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() != ".csv" or path.name.startswith("."):
                continue
            match = _NAME.fullmatch(path.stem)
            if match is None:
                raise ValueError(f"'{path}' must be named <object><number>.csv, like 'bottle0.csv'")
            object_name = _MISSPELT.get(match["object"], match["object"])
            sequences.append(
                _Sequence(folder.name.lower(), object_name, int(match["number"]), path)
            )
    check_unique_trials(
        (s[:3], f"sequence {s.number} of '{s.object_name}'", f"'{s.path}'") for s in sequences
    )
    order = [*_DIRECTIONS]
    return sorted(sequences, key=lambda s: (order.index(s.direction), s.object_name, s.number))
