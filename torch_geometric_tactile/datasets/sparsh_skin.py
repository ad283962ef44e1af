r"""The Sparsh-skin data set of objects handled by an Allegro hand with uSkin."""

from pathlib import Path
from typing import Literal

import numpy as np
import torch

from torch_geometric_tactile._checks import need_argument
from torch_geometric_tactile._typing import Filter, PathLike, Transform
from torch_geometric_tactile.data import FrameInfo, StaticData, measure_rate
from torch_geometric_tactile.datasets._placed_files import PlacedFiles, trials_to_frames
from torch_geometric_tactile.datasets._trial_frames import check_frame_selection
from torch_geometric_tactile.io import read_sparsh_skin
from torch_geometric_tactile.sensors import allegro_uskin_368

_REPOSITORY = "facebook/sparsh-skin-dataset"
_COMMIT = "fc1d668"
_TACTILE_FILE, _JOINT_FILE = "xela/data.pkl", "allegro/data.pkl"
_BASELINE = "baseline"
_DOWNLOAD_COMMAND = (
    f"huggingface-cli download {_REPOSITORY} --repo-type dataset "
    '--include "pretraining/*/*/xela/data.pkl" "pretraining/*/*/allegro/data.pkl" '
    '"pretraining/baseline/xela/data.pkl" --local-dir DIR'
)


class SparshSkin(PlacedFiles):
    r"""The pretraining recordings of the "Self-supervised perception for tactile skin covered
    dexterous hands" paper (`arXiv 2505.11420 <https://arxiv.org/abs/2505.11420>`_,
    `facebook/sparsh-skin-dataset
    <https://huggingface.co/datasets/facebook/sparsh-skin-dataset>`_). A teleoperated Allegro hand
    with XELA uSkin manipulates 14 objects. The task is to recognise the object.

    A sample is a frame of 368 taxels (see
    :func:`~torch_geometric_tactile.sensors.allegro_uskin_368`) with three channels in raw counts.
    As in the authors' code, the mean of the recording of the untouched hand is subtracted. The
    other attributes are:

    * :obj:`joint`: the 16 joint angles in radians;
    * :obj:`time`: seconds from the start of the episode, as published;
    * :obj:`trial`: the episode;
    * :obj:`y`, :obj:`group`: the object. Each folder with numbered episodes is one object.

    Positions depend on the joint angles and are not stored;
    :class:`~torch_geometric_tactile.transforms.TaxelPose` computes them for each batch.

    .. warning::
        Consecutive frames of an episode are near copies, so **a split by frame tests on training
        data**. Hold out episodes with ``Protocol("trial", stratify="group")``. It is unknown
        whether all episodes of an object were recorded one after the other; if they were, drift or
        the scene may reveal the object. It is also unknown whether any split tests another day or
        hand.

        **Taxels within a patch may be permuted**, and the three patches of the palm may be permuted
        as well: see :func:`~torch_geometric_tactile.io.read_sparsh_skin`. Digits and phalanges
        follow the authors' list and are correct for models of digits and patches. Before you rely
        on results that need the fine geometry (edge features, positions within a patch, images),
        compare it with :obj:`pretraining/urdf` in the data set.

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

    At the full rate of 100 Hz, with :obj:`rate=None`, there are about 1.4 million frames of 4.4 kB,
    or 6.4 GB. Processing holds them in memory twice. At 10 Hz, it needs a tenth of this memory.

    **This class was written without access to the files**, and no results were measured on them.
    The format is taken from the authors' published converter and loaders (data at commit
    ``fc1d668``). The numbers above are stated by the authors or follow from their statements. The
    tests use generated files. :class:`~torch_geometric_tactile.transforms.TaxelPose` assumes an
    order of the joints and a right hand; it is unknown whether the files agree with both.

    **Check the licence** on the card of the data set before use; it was not checked for this class
    (other data sets of the same project are CC BY-NC 4.0). For this reason, and because the
    complete data set has 54.3 GB, nothing is downloaded. The error message for missing files
    contains the command that downloads the required files.

    Args:
        root (str or PathLike, optional): Folder of the data set. The objects are in the subfolder
            :obj:`pretraining` or :obj:`xela/pretraining/extracted`, of this folder or of its
            subfolder :obj:`raw`, or directly in it. The default is :obj:`$TACTILE_DATA/SparshSkin`,
            or a folder in the user's cache if that variable is not set.
        rate (float, optional): Rate in hertz at which frames are selected: the frames nearest in
            time to the ticks of a clock that starts with the first frame of each episode.
            :obj:`None` selects all frames.
        tare (str, optional): :obj:`"baseline"` subtracts the mean of the recording in
            :obj:`pretraining/baseline`; :obj:`None` leaves the counts unchanged.
        adjacency (str): Name of an adjacency of the layout, whose edges are used. The edges are a
            choice of this package; no paper defines edges for this hand.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Returns whether to keep a sample.
        force_reload (bool): Whether to process the raw files again.

    Raises:
        FileNotFoundError: If there are no episodes, an episode lacks a file, or there is no
            recording of the untouched hand for :obj:`tare`.
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
        f"{parent}{name}"
        for parent in ("raw/", "")
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
        check_frame_selection(rate, None, 0)
        need_argument(
            tare in (_BASELINE, None), "tare", f"must be '{_BASELINE}' or None", repr(tare)
        )
        self.layout = allegro_uskin_368()
        self.layout.edge_index(
            adjacency
        )  # raises an error for an unknown one before files are read
        self.rate = rate
        self._recorded_rate: float | None = None
        self.tare = tare
        self.adjacency = adjacency
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)

    @property
    def processed_file_names(self) -> str:
        r"""The processed file. Each rate, tare and adjacency has a separate file."""
        rate = "all" if self.rate is None else f"{self.rate:g}"
        return f"sparsh_skin_{rate}_{self.tare or 'counts'}_{self.adjacency}.pt"

    def _files_in(self, folder: Path) -> list[Path]:
        files = [path / name for path in _episodes(folder) for name in (_TACTILE_FILE, _JOINT_FILE)]
        return [*files, folder / _BASELINE / _TACTILE_FILE] if files and self.tare else files

    def _no_files(self) -> str:
        return (
            f"there are no episodes in '{self.root}' or its folders 'pretraining' and "
            f"'xela/pretraining/extracted': check the licence on the card of "
            f"https://huggingface.co/datasets/{_REPOSITORY}, and download the needed files with"
            f"\n  {_DOWNLOAD_COMMAND}\n(this class was written for commit {_COMMIT})"
        )

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all episodes."""
        folder = Path(self.raw_dir)
        rest = self._rest_reading(folder)
        episodes = _episodes(folder)
        columns: dict[str, list[np.ndarray]] = {"x": [], "joint": [], "time": []}
        for path in episodes:
            recording = read_sparsh_skin(path)
            mask = self._rate_mask(recording.time)
            columns["x"].append(recording.tactile[mask] - rest)
            columns["joint"].append(np.asarray(recording.joint)[mask])
            columns["time"].append(recording.time[mask])
        object_names = [path.parent.name for path in episodes]
        objects = sorted(set(object_names))
        group = [objects.index(name) for name in object_names]
        data = StaticData(
            edge_index=self.layout.edge_index(self.adjacency),
            **{key: torch.from_numpy(np.concatenate(rows)) for key, rows in columns.items()},
            **trials_to_frames([len(rows) for rows in columns["time"]], y=group, group=group),
        )
        trial_names = [f"{path.parent.name}/{path.name}" for path in episodes]
        names = {"class": objects, "group": objects, "trial": trial_names}
        if self._recorded_rate is not None:
            names["recorded_rate"] = [repr(self._recorded_rate)]
        return data, names

    def _rate_mask(self, time: np.ndarray) -> np.ndarray:
        # Returns which frames of an episode are selected by the rate (T,).
        if self.rate is None:
            return np.ones(len(time), dtype=bool)
        self._recorded_rate = measure_rate(time).rate
        info = FrameInfo(rate=self._recorded_rate, selected_rate=self.rate)
        mask = np.zeros(len(time), dtype=bool)
        mask[info.selected_frames(time, len(time))] = True
        return mask

    def _known_info(self) -> FrameInfo:
        (rate,) = self._names.get("recorded_rate") or (None,)
        return FrameInfo(rate=None if rate is None else float(rate), selected_rate=self.rate)

    def _rest_reading(self, folder: Path) -> np.ndarray:
        # Returns the mean reading of the untouched hand (368, 3), or zeros without tare.
        if self.tare is None:
            return np.zeros(3, dtype=np.float32)
        if not (folder / _BASELINE / _TACTILE_FILE).is_file():
            raise FileNotFoundError(
                f"'{folder / _BASELINE / _TACTILE_FILE}' does not exist; 'tare' subtracts its "
                f"mean: download it with\n  {_DOWNLOAD_COMMAND}\nor pass 'tare=None' for counts"
            )
        readings = read_sparsh_skin(folder / _BASELINE, joints=False).tactile
        return readings.mean(axis=0, dtype=np.float64).astype(np.float32)


def _episodes(folder: Path) -> list[Path]:
    # Returns the numbered folders with tactile readings, sorted by object and number.
    folders = [path.parents[1] for path in folder.glob(f"*/*/{_TACTILE_FILE}")]
    numbered = [path for path in folders if path.name.isdecimal()]
    return sorted(numbered, key=lambda path: (path.parent.name, int(path.name)))
