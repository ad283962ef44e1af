r"""Objects in an Allegro hand with uSkin, the public Sparsh-skin recordings."""

from pathlib import Path
from typing import Literal

import numpy as np
import torch

from torch_geometric_tactile._checks import need_argument
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import FrameInfo, StaticData, measure_rate
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, frames_of_trials
from torch_geometric_tactile.datasets._trial_frames import check_choice
from torch_geometric_tactile.io import read_sparsh_skin
from torch_geometric_tactile.sensors import allegro_uskin_368

_REPOSITORY = "facebook/sparsh-skin-dataset"
_COMMIT = "fc1d668"
_TOUCH, _JOINTS = "xela/data.pkl", "allegro/data.pkl"
_BASELINE = "baseline"
_FETCH = (
    f"huggingface-cli download {_REPOSITORY} --repo-type dataset "
    '--include "pretraining/*/*/xela/data.pkl" "pretraining/*/*/allegro/data.pkl" '
    '"pretraining/baseline/xela/data.pkl" --local-dir DIR'
)


class SparshSkin(PlacedFiles):
    r"""The pretraining recordings of the "Self-supervised perception for tactile skin covered
    dexterous hands" paper (`arXiv 2505.11420 <https://arxiv.org/abs/2505.11420>`_,
    `facebook/sparsh-skin-dataset
    <https://huggingface.co/datasets/facebook/sparsh-skin-dataset>`_): a teleoperated Allegro hand
    with XELA uSkin plays with 14 objects. Which one is it?

    A sample is a frame: 368 taxels (see
    :func:`~torch_geometric_tactile.sensors.allegro_uskin_368`) with three channels in raw counts,
    less the mean of the recording of the untouched hand, as the authors do; the 16 angles
    :obj:`joint` in radians; :obj:`time` in seconds as published, from the start of the episode.
    :obj:`trial` numbers the episodes, :obj:`y` and :obj:`group` the objects: any folder with
    numbered episodes counts as one. Positions depend on the joint angles and are not stored;
    :class:`~torch_geometric_tactile.transforms.TaxelPose` computes them batch by batch.

    .. warning::
        Frames of an episode follow each other and are near copies: **a split by frame tests on what
        was trained on**. Hold out episodes, ``Protocol("trial", stratify="group")``. Whether
        all episodes of an object were recorded in a row, so that drift or the setting tells it, is
        not known here, nor whether any split tests another day or hand.

        **Places within a patch may be permuted**, and the three patches of the palm with each
        other: see :func:`~torch_geometric_tactile.io.read_sparsh_skin`. Digits and phalanges are
        those of the authors' list, so that models of digits and patches see what they should.
        Before you rely on results that need the fine geometry (edge features, positions within a
        patch, images), compare with :obj:`pretraining/urdf` of the data set.

    .. list-table:: STATS, as published, at 10 frames a second
        :header-rows: 1

        * - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - 140 (14 objects)
          - about 144,000 (4 hours)
          - 368
          - 1,272
          - 3
          - 14

    At the full 100 frames a second, :obj:`rate=None`, these are about 1.4 million frames of 4.4 kB,
    6.4 GB, which are held in memory twice while they are processed; at 10 a tenth of it.

    **What was read here**: no file of the data set, and nothing was measured on it. The format is
    that of the authors' published converter and loaders (data at commit ``fc1d668``), the numbers
    above are those that the authors state or follow from them, and tests use made-up files. Also
    unknown here: the order of the joints and whether the hand is a right one, both of which
    :class:`~torch_geometric_tactile.transforms.TaxelPose` takes for granted.

    **The licence was not read**: check it on the card of the data set before use (other data sets
    of the same project are CC BY-NC 4.0). Nothing is downloaded, for that reason and as all of it
    is 54.3 GB; the error for missing files has the command that fetches what is needed.

    Args:
        root (str or PathLike, optional): Folder of the data set; the objects are in its folder
            :obj:`pretraining` or :obj:`xela/pretraining/extracted`, also below :obj:`raw`, or in
            itself. If left out, :obj:`$TACTILE_DATA/SparshSkin` or a folder in the user's cache.
        rate (float, optional): Only the frames that are next in time to the ticks of a clock, so
            many a second, that starts with the first frame of each episode. All with :obj:`None`.
        tare (str, optional): :obj:`"baseline"` subtracts the mean of the recording in
            :obj:`pretraining/baseline`; :obj:`None` keeps counts.
        adjacency (str): Which edges of the layout. They are ours; no paper has any for this hand.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no episodes, one lacks a file, or there is no recording of
            the untouched hand for :obj:`tare`.
        ValueError: If an argument is unknown, or a file cannot be read.

    Examples:
        >>> from torch_geometric.transforms import Compose
        >>> from torch_geometric_tactile.data import Protocol
        >>> from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose
        >>> transform = Compose([TaxelPose("allegro_uskin_368"), GeometricEdgeAttr()])
        >>> dataset = SparshSkin("sparsh-skin", transform=transform)  # doctest: +SKIP
        >>> Protocol("trial", test=0.2, stratify="group").split(dataset)  # doctest: +SKIP
    """

    group_kind = "object"
    _folder = "SparshSkin"
    _folders = tuple(
        f"{above}{name}"
        for above in ("raw/", "")
        for name in ("pretraining", "xela/pretraining/extracted", ".")
    )

    def __init__(
        self,
        root: PathLike | None = None,
        *,
        rate: float | None = 10.0,
        tare: Literal["baseline"] | None = "baseline",
        adjacency: str = "original",
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        check_choice(rate, None, 0)
        need_argument(
            tare in (_BASELINE, None), "tare", f"must be '{_BASELINE}' or None", repr(tare)
        )
        self.layout = allegro_uskin_368()
        self.layout.edge_index(adjacency)  # an unknown one is an error before any file is read
        self.rate = rate
        self._recorded_rate: float | None = None
        self.tare = tare
        self.adjacency = adjacency
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def processed_file_names(self) -> str:
        r"""One file for each rate, tare and adjacency."""
        rate = "all" if self.rate is None else f"{self.rate:g}"
        return f"sparsh_skin_{rate}_{self.tare or 'counts'}_{self.adjacency}.pt"

    def _files_in(self, folder: Path) -> list[Path]:
        files = [path / name for path in _episodes(folder) for name in (_TOUCH, _JOINTS)]
        return [*files, folder / _BASELINE / _TOUCH] if files and self.tare else files

    def _no_files(self) -> str:
        return (
            f"there are no episodes in '{self.root}' or its folders 'pretraining' and "
            f"'xela/pretraining/extracted': check the licence on the card of "
            f"https://huggingface.co/datasets/{_REPOSITORY}, and get what is needed by\n  {_FETCH}"
            f"\n(this class was written for commit {_COMMIT})"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all episodes."""
        folder = Path(self.raw_dir)
        rest = self._rest(folder)
        episodes = _episodes(folder)
        stacked: dict[str, list[np.ndarray]] = {"x": [], "joint": [], "time": []}
        for path in episodes:
            found = read_sparsh_skin(path)
            kept = self._kept(found.time)
            stacked["x"].append(found.tactile[kept] - rest)
            stacked["joint"].append(np.asarray(found.joint)[kept])
            stacked["time"].append(found.time[kept])
        named = [path.parent.name for path in episodes]
        objects = sorted(set(named))
        group = [objects.index(name) for name in named]
        data = StaticData(
            edge_index=self.layout.edge_index(self.adjacency),
            **{key: torch.from_numpy(np.concatenate(rows)) for key, rows in stacked.items()},
            **frames_of_trials([len(rows) for rows in stacked["time"]], y=group, group=group),
        )
        names = [f"{path.parent.name}/{path.name}" for path in episodes]
        known = {"class": objects, "group": objects, "trial": names}
        if self._recorded_rate is not None:
            known["recorded_rate"] = [repr(self._recorded_rate)]
        return data, known

    def _kept(self, time: np.ndarray) -> np.ndarray:
        # Which frames of an episode are samples (T,).
        if self.rate is None:
            return np.ones(len(time), dtype=bool)
        self._recorded_rate = measure_rate(time).rate
        info = FrameInfo(rate=self._recorded_rate, selected_rate=self.rate)
        kept = np.zeros(len(time), dtype=bool)
        kept[info.selected_frames(time, len(time))] = True
        return kept

    def _known_info(self) -> FrameInfo:
        (rate,) = self._names.get("recorded_rate") or (None,)
        return FrameInfo(rate=None if rate is None else float(rate), selected_rate=self.rate)

    def _rest(self, folder: Path) -> np.ndarray:
        # The mean of the hand at rest (368, 3).
        if self.tare is None:
            return np.zeros(3, dtype=np.float32)
        if not (folder / _BASELINE / _TOUCH).is_file():
            raise FileNotFoundError(
                f"'{folder / _BASELINE / _TOUCH}' does not exist, whose mean 'tare' subtracts: get "
                f"it by\n  {_FETCH}\nor pass 'tare=None' for counts"
            )
        readings = read_sparsh_skin(folder / _BASELINE, joints=False).tactile
        return readings.mean(axis=0, dtype=np.float64).astype(np.float32)


def _episodes(folder: Path) -> list[Path]:
    # Numbered folders with touch, object by object.
    found = [path.parents[1] for path in folder.glob(f"*/*/{_TOUCH}")]
    numbered = [path for path in found if path.name.isdecimal()]
    return sorted(numbered, key=lambda path: (path.parent.name, int(path.name)))
