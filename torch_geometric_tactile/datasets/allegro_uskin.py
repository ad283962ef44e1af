r"""Grasps with an Allegro hand covered with uSkin."""

import hashlib
import logging
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import Protocol, Recording, StaticData, StaticDataset
from torch_geometric_tactile.data.static_dataset import load_static
from torch_geometric_tactile.datasets.root import default_root
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin
from torch_geometric_tactile.sim import PROPERTIES, paper8
from torch_geometric_tactile.typing import Filter, PathLike, Transform

_SUFFIXES = (".h5", ".hdf5", ".npz", ".csv")
_STEM = re.compile(r"(.+)_(\d+)")
_PARTS = ("train", "val", "test")
_NUM_CHANNELS = 3
_NUM_JOINTS = 16
_CONTENT = "content=1"  # to be raised when the processed file gets other columns
_FRAMES_PER_BLOCK = 4096
_logger = logging.getLogger(__name__)


class AllegroUSkin(StaticDataset):
    r"""Grasps with a right Allegro hand whose 384 taxels are XELA uSkin, as in the "Tactile Object
    Property Recognition using Geometrical Graph Edge Features and Multi-Thread Graph Convolutional
    Network" and the "Multifingered Object Recognition with Tactile Sensors and Graph Convolutional
    Networks using Topological Graph Segmentation" papers: what is the object, or is it light or
    heavy, hard or soft, slippery or not?

    The recordings of the papers are not public. This class reads a folder of your own, or one that
    ``tactile simulate --out FOLDER`` wrote: one trial a file, in :obj:`root/raw` or in :obj:`root`
    itself, ``.h5``, ``.hdf5``, ``.npz`` or ``.csv`` as
    :func:`~torch_geometric_tactile.io.write_recording` writes a
    :class:`~torch_geometric_tactile.data.Recording`:

    * readings in counts :math:`(T, 384, 3)`, in the order of
      :func:`~torch_geometric_tactile.sensors.allegro_uskin`, and joint angles in radians
      :math:`(T, 16)`;
    * the object's name and the number of the trial in :obj:`meta["object"]` and
      :obj:`meta["trial"]`, or in the name of the file: ``<object>_<number>.h5``;
    * for :obj:`task="property"`, 0 or 1 for each property in :obj:`meta["labels"]`, in the order of
      :obj:`property_names` or of :obj:`meta["label_names"]`; needless for objects named as in
      :func:`~torch_geometric_tactile.sim.paper8`;
    * if known, the integers :obj:`privileged["phase"]` with their :obj:`meta["phase_names"]`.

    A sample is a frame. Beside :obj:`x` and :obj:`y` it has :obj:`joint`, :obj:`time` in seconds,
    :obj:`trial` (the file), :obj:`group` (the object), :obj:`property` and :obj:`phase` where
    known (-1 in files that know none). Missing readings stay NaN. Positions depend on the joint
    angles and are not stored; the transforms of the example below compute them batch by batch.

    All files are processed once, and anew when one of them was added, removed or changed.
    :obj:`task`, :obj:`split`, :obj:`adjacency`, :obj:`phases` and :obj:`stride` select from the
    memory-mapped processed file, without a copy of the readings.

    .. list-table:: STATS
        :header-rows: 1

        * - data
          - #trials
          - #graphs
          - #nodes
          - #edges
          - #features
          - #classes
        * - as the papers describe theirs: 8 objects, about 17 s at 100 Hz
          - 80
          - ~136,000
          - 384
          - 1,401
          - 3
          - 8 objects or 6 properties
        * - ``tactile simulate``: 8 objects, 17 s at 100 Hz
          - 80
          - 136,000
          - 384
          - 1,401
          - 3
          - 8 objects or 6 properties
        * - ``tactile simulate --preset ci``: 8 objects, 5 s at 50 Hz
          - 24
          - 6,000
          - 384
          - 1,401
          - 3
          - 8 objects or 6 properties

    Args:
        root (str or PathLike, optional): Folder of the data set. If left out,
            :obj:`$TACTILE_DATA/AllegroUSkin` or a folder in the user's cache.
        task (str): :obj:`"object"`, where :obj:`y` is the index of the object, or
            :obj:`"property"`, where it has a 0 or 1 for each property.
        split (str, optional): :obj:`"train"`, :obj:`"val"` or :obj:`"test"`; everything with
            :obj:`None`.
        split_by (str): :obj:`"trial"` keeps whole trials together and holds out some of each
            object. :obj:`"frame"` draws single frames, and is the optimistic one: neighbours in
            time are nearly equal, so that the test frames were nearly seen before. The papers do
            not say which of them they used.
        fractions (tuple of float): The parts for training, validation and test. With whole trials,
            each object has at least one to train and to test on, and from three trials on one for
            validation. The second paper has :obj:`(0.6, 0.1, 0.3)`.
        split_seed (int): Which of the random splits. :obj:`phases` and :obj:`stride` move no frame
            to another split.
        adjacency (str): Which edges of the layout.
        layout (TaxelLayout, optional): The taxels;
            :func:`~torch_geometric_tactile.sensors.allegro_uskin` if left out.
        phases (sequence of str, optional): Only the frames in these phases of the grasp.
        stride (int): Only every :obj:`stride`-th frame of each trial.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved (for each
            :obj:`task` and :obj:`adjacency`).
        pre_filter (callable, optional): Tells whether a sample is kept (likewise).
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no trials.
        ValueError: If an argument is unknown or leaves no sample, a file cannot be read or is not
            as described above, two files hold the same trial, or the properties of an object are
            unknown where they are the task.

    Examples:
        >>> from torch_geometric.transforms import Compose
        >>> from torch_geometric_tactile.sensors import HandKinematics
        >>> from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose
        >>> transform = Compose(
        ...     [TaxelPose(allegro_uskin(), HandKinematics.allegro()), GeometricEdgeAttr()]
        ... )
        >>> dataset = AllegroUSkin("sim", task="property", transform=transform)  # doctest: +SKIP
        >>> dataset  # doctest: +SKIP
        AllegroUSkin(95200)
        >>> dataset[0]  # doctest: +SKIP
        Data(x=[384, 3], edge_index=[2, 1401], edge_attr=[1401, 4], y=[1, 6], pos=[384, 3], ...)
    """

    force_reload: bool

    def __init__(
        self,
        root: PathLike | None = None,
        task: Literal["object", "property"] = "object",
        split: Literal["train", "val", "test"] | None = "train",
        split_by: Literal["trial", "frame"] = "trial",
        fractions: tuple[float, float, float] = (0.7, 0.1, 0.2),
        split_seed: int = 0,
        adjacency: str = "original",
        layout: TaxelLayout | None = None,
        phases: Sequence[str] | None = None,
        stride: int = 1,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        if task not in ("object", "property"):
            raise ValueError(f"'task' must be 'object' or 'property' (got '{task}')")
        if split is not None and split not in _PARTS:
            raise ValueError(f"'split' must be 'train', 'val', 'test' or None (got '{split}')")
        if split_by not in ("trial", "frame"):
            raise ValueError(f"'split_by' must be 'trial' or 'frame' (got '{split_by}')")
        if stride < 1:
            raise ValueError(f"'stride' must be at least 1 (got {stride})")
        self.task = task
        self.split = split
        self.split_by = split_by
        self.fractions = _checked_fractions(fractions)
        self.split_seed = split_seed
        self.adjacency = adjacency
        self.layout = allegro_uskin() if layout is None else layout
        self.phases = (phases,) if isinstance(phases, str) else phases and tuple(phases)
        self.stride = stride
        edge_index = self.layout.edge_index(adjacency)
        super().__init__(
            default_root("AllegroUSkin") if root is None else root,
            transform,
            pre_transform,
            pre_filter,
            force_reload,
        )
        if not self._is_filtered:
            self._data.edge_index = edge_index
            self._data.y = self._target(self._data, self._names)
        if len(self.group_names) == 1:
            _logger.warning(
                "'%s' holds one object only, '%s': there is nothing to tell apart",
                self.root,
                self.group_names[0],
            )
        self._select()

    @property
    def raw_dir(self) -> str:
        r"""The folder of the trials: :obj:`root/raw`, or :obj:`root` where that has none."""
        root = Path(self.root)
        return str(root if not _trial_files(root / "raw") and _trial_files(root) else root / "raw")

    @property
    def raw_file_names(self) -> list[str]:
        r"""The files of the trials, in order."""
        return _trial_files(Path(self.raw_dir))

    @property
    def raw_paths(self) -> list[str]:
        r"""Their paths."""
        folder = Path(self.raw_dir)  # looked up once for all
        return [str(folder / name) for name in _trial_files(folder)]

    @property
    def processed_dir(self) -> str:
        r"""The folder of the processed file: one of its own for what a filter or transform saw."""
        folder = Path(self.root, "processed")
        return str(folder / f"{self.task}_{self.adjacency}" if self._is_filtered else folder)

    @property
    def processed_file_names(self) -> str:
        r"""One file for all splits, phases and strides."""
        return "allegro_uskin.pt"

    @property
    def _is_filtered(self) -> bool:
        return self.pre_transform is not None or self.pre_filter is not None

    def _process(self) -> None:
        path, is_there = Path(self.processed_paths[0]), bool(self.raw_paths)
        is_processed = path.is_file() and not self.force_reload
        if not is_there and not is_processed:
            raise FileNotFoundError(
                f"there are no trials in '{Path(self.root, 'raw')}' or '{self.root}': put "
                f"recordings there, <object>_<number> with one of {', '.join(_SUFFIXES)}, or "
                f"simulate some: tactile simulate --out '{self.root}'"
            )
        if is_there and is_processed:
            try:
                _, names = load_static(path)
            except ValueError:
                pass  # is reported when the file is loaded
            else:
                changes = _changes(names.get("raw", []), self._state())
                if changes:
                    _logger.warning("processing '%s' again: %s", self.raw_dir, changes)
                    self.force_reload = True
        super()._process()

    def _state(self) -> list[str]:
        # What the processed file follows from, apart from what PyG watches.
        state = [_CONTENT]
        if self._is_filtered:
            edges = self.layout.edge_index(self.adjacency).numpy()
            state.append(f"edges={hashlib.sha256(edges.tobytes()).hexdigest()}")
        for name in self.raw_paths:
            stat = Path(name).stat()
            state.append(f"{Path(name).name}={stat.st_size},{stat.st_mtime_ns}")
        return state

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all trials."""
        state = self._state()  # a file that changes from here on is read again the next time
        x, trials = self._read_trials()
        _check_together(trials)
        known = [item.name for item in paper8()]
        found = {trial.object_name for trial in trials}
        objects = [name for name in known if name in found] + sorted(found.difference(known))
        phases = [*dict.fromkeys(name for trial in trials for name in trial.phase_names)]
        num_frames = torch.tensor([len(trial.time) for trial in trials])
        unknown = {trial.object_name for trial in trials if trial.labels is None}
        names = {
            "group": objects,
            "trial": [trial.path.stem for trial in trials],
            "phase": phases,
            "unknown": sorted(unknown),
            "synthetic": [trial.path.stem for trial in trials if trial.synthetic],
            "raw": state,
        }
        group = torch.tensor([objects.index(trial.object_name) for trial in trials])
        data = StaticData(
            x=x,
            edge_index=self.layout.edge_index(self.adjacency),
            joint=torch.from_numpy(np.concatenate([trial.joint for trial in trials])),
            time=torch.from_numpy(np.concatenate([trial.time for trial in trials])),
            trial=torch.arange(len(trials)).repeat_interleave(num_frames),
            group=group.repeat_interleave(num_frames),
        )
        if not unknown:
            labels = torch.tensor([trial.labels for trial in trials])
            data.property = labels.repeat_interleave(num_frames, dim=0)
        if phases:
            data.phase = torch.cat([_numbered_phase(trial, phases) for trial in trials])
        data.y = self._target(data, names)
        return data, names

    def _read_trials(self) -> tuple[Tensor, list["_Trial"]]:
        trials, num_missing = [], 0
        folder = Path(self.processed_dir)
        folder.mkdir(parents=True, exist_ok=True)
        # The readings wait on disk, where they may be more than fits into memory.
        with tempfile.TemporaryFile(dir=folder) as file:
            for name in self.raw_paths:
                recording = read_recording(name)
                trials.append(_checked_trial(Path(name), recording, self.layout))
                np.ascontiguousarray(recording.tactile).tofile(file)
                num_missing += int(recording.missing.sum())
            num_frames = sum(len(trial.time) for trial in trials)
            shape = (num_frames, self.layout.num_taxels, _NUM_CHANNELS)
            x = torch.from_numpy(np.memmap(file, np.float32, mode="c", shape=shape))
        if num_missing:
            _logger.warning(
                "%d of %d readings of taxels are missing (NaN); see FillMissing and DropTaxels",
                num_missing,
                num_frames * self.layout.num_taxels,
            )
        return x, trials

    def _target(self, data: StaticData, names: Mapping[str, list[str]]) -> Tensor:
        if self.task == "object":
            return data.group.clone()
        if names["unknown"]:
            raise ValueError(
                f"the properties of {names['unknown']} are unknown: give 0 or 1 for each of "
                f"{list(PROPERTIES)} as 'labels' in the metadata of their recordings, name them as "
                f"one of {[item.name for item in paper8()]}, or choose task='object'"
            )
        target: Tensor = data.property.float()
        return target

    def _select(self) -> None:
        kept = torch.ones(self.len(), dtype=torch.bool)
        if self.split is not None:
            kept &= self._in_split(self.split)
        if self.stride > 1:
            _, counts = self._data.trial.unique_consecutive(return_counts=True)
            first = (counts.cumsum(0) - counts).repeat_interleave(counts)
            kept &= (torch.arange(len(kept)) - first) % self.stride == 0
        if self.phases is not None:
            kept &= self._in_phases(self.phases)
        if not kept.any():
            raise ValueError(
                f"split='{self.split}' with fractions={self.fractions} and phases={self.phases} "
                f"must leave at least one of {len(kept)} samples in "
                f"{len(self._data.trial.unique())} trials (left none)"
            )
        if not kept.all():
            self._indices = kept.nonzero().view(-1).tolist()

    def _in_split(self, split: str) -> Tensor:
        kept = torch.zeros(self.len(), dtype=torch.bool)
        try:
            parts = self.protocol.split(self, self.split_seed)
        except ValueError as error:
            if self.split_by == "frame":
                raise
            raise ValueError(
                f"{error}: record more, or choose split_by='frame' or split=None"
            ) from error
        kept[parts[_PARTS.index(split)]] = True
        return kept

    @property
    def protocol(self) -> Protocol:
        r"""How the samples are split: trials of each object by themselves, or frames."""
        _, val, test = self.fractions
        stratify = "group" if self.split_by == "trial" else None
        return Protocol(self.split_by, val=val, test=test, stratify=stratify)

    def _in_phases(self, phases: Sequence[str]) -> Tensor:
        if not self.phase_names:
            raise ValueError(
                f"'phases' must be None, since no recording in '{self.root}' has "
                f"'phase_names' (got {phases})"
            )
        unknown = [name for name in phases if name not in self.phase_names]
        if unknown or not phases:
            raise ValueError(f"'phases' must be some of {self.phase_names} (got {phases})")
        wanted = torch.tensor([self.phase_names.index(name) for name in phases])
        return torch.isin(self._data.phase, wanted)

    @property
    def class_names(self) -> list[str]:
        r"""The names of the objects, those of the paper first and in its order, or of the
        properties: what the classes of :obj:`y` are.
        """
        return self.group_names if self.task == "object" else self.property_names

    @property
    def num_classes(self) -> int:
        r"""The number of objects or of properties, also where a split lacks one of them."""
        return len(self.class_names)

    @property
    def property_names(self) -> list[str]:
        r"""The names of the columns of :obj:`property`."""
        return list(PROPERTIES)

    @property
    def trial_names(self) -> list[str]:
        r"""The names of the files behind :obj:`trial`, without their suffix."""
        return list(self._names["trial"])

    @property
    def phase_names(self) -> list[str]:
        r"""The names of the phases in :obj:`phase`; empty if no recording knows its phases."""
        return list(self._names["phase"])

    @property
    def synthetic(self) -> bool:
        r"""Whether a simulator made any of the recordings."""
        return bool(self._names["synthetic"])

    @property
    def num_missing(self) -> int:
        r"""How many taxels have no reading, summed over the frames of this selection."""
        blocks = torch.as_tensor(self.indices()).split(_FRAMES_PER_BLOCK)
        return sum(int(self._data.x[block].isnan().any(dim=-1).sum()) for block in blocks)


class _Trial(NamedTuple):
    path: Path
    object_name: str
    number: int
    time: np.ndarray
    joint: np.ndarray
    labels: tuple[int, ...] | None
    phase: np.ndarray | None
    phase_names: tuple[str, ...]
    unit: str | None
    synthetic: bool


def _trial_files(folder: Path) -> list[str]:
    if not folder.is_dir():
        return []
    return sorted(
        path.name
        for path in folder.iterdir()
        if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".") and path.is_file()
    )


def _changes(before: Sequence[str], now: Sequence[str]) -> str:
    old, new = (dict(line.rpartition("=")[::2] for line in lines) for lines in (before, now))
    changes = [
        f"'{key}' was {'added' if key not in old else 'removed' if key not in new else 'changed'}"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    more = f" and {len(changes) - 3} more" if len(changes) > 3 else ""
    return ", ".join(changes[:3]) + more


def _checked_fractions(fractions: Any) -> tuple[float, float, float]:
    try:
        train, val, test = (float(part) for part in fractions)
        is_right = min(train, val, test) >= 0 and train > 0 and abs(train + val + test - 1) < 1e-6
    except (TypeError, ValueError):
        is_right = False
    if not is_right:
        raise ValueError(
            "'fractions' must be three numbers, not negative and the first positive, that add up "
            f"to 1 (got {fractions})"
        )
    return train, val, test


def _checked_trial(path: Path, recording: Recording, layout: TaxelLayout) -> _Trial:
    try:
        recording.check(layout)
    except ValueError as error:
        raise ValueError(f"'{path}': {error}") from error
    meta = recording.meta
    for what, count, expected in (
        ("channels a taxel", recording.num_channels, _NUM_CHANNELS),
        ("joint angles a frame, in 'joint'", recording.num_joints, _NUM_JOINTS),
    ):
        if count != expected:
            raise ValueError(f"'{path}' must have {expected} {what} (got {count or 'none'})")
    if recording.num_frames == 0:
        raise ValueError(f"'{path}' must hold at least one frame (got none)")
    object_name, number = _object_and_trial(path, meta)
    phase, phase_names = recording.privileged.get("phase"), meta.get("phase_names")
    if phase is None or not isinstance(phase_names, list):
        phase, phase_names = None, []
    elif (
        phase.shape != (recording.num_frames,)
        or phase.dtype.kind not in "iu"
        or not 0 <= phase.min() <= phase.max() < len(phase_names)
    ):
        raise ValueError(
            f"'{path}' must hold in 'phase' one index into 'phase_names' a frame, 0 to "
            f"{len(phase_names) - 1} (got {phase.dtype} of shape {phase.shape})"
        )
    return _Trial(
        path=path,
        object_name=object_name,
        number=number,
        time=recording.time,
        joint=recording.joint,  # type: ignore[arg-type]  # counted above
        labels=_labels(path, meta, object_name),
        phase=phase,
        phase_names=tuple(phase_names),
        unit=meta.get("unit"),
        synthetic=bool(meta.get("synthetic", False)),
    )


def _object_and_trial(path: Path, meta: Mapping[str, Any]) -> tuple[str, int]:
    in_name = _STEM.fullmatch(path.stem)
    object_name, number = meta.get("object"), meta.get("trial")
    if object_name is None and in_name:
        object_name = in_name[1]
    if number is None and in_name:
        number = int(in_name[2])
    if not isinstance(object_name, str) or not object_name or type(number) is not int:
        raise ValueError(
            f"'{path}' must tell its object and trial: 'object' (a text) and 'trial' (an integer) "
            "in its metadata, or a file name <object>_<number> such as 'sponge_003.h5' "
            f"(got object {object_name!r}, trial {number!r})"
        )
    return object_name, number


def _labels(path: Path, meta: Mapping[str, Any], object_name: str) -> tuple[int, ...] | None:
    labels, names = meta.get("labels"), meta.get("label_names", PROPERTIES)
    if labels is None or sorted(map(str, names)) != sorted(PROPERTIES):  # or of another kind
        return {item.name: item.labels for item in paper8()}.get(object_name)
    if not isinstance(labels, list) or len(labels) != len(names) or {*labels} - {0, 1}:
        raise ValueError(
            f"'{path}' must have a 0 or 1 in 'labels' for each of {list(names)} (got {labels})"
        )
    return tuple(int(labels[list(names).index(name)]) for name in PROPERTIES)


def _check_together(trials: Sequence[_Trial]) -> None:
    seen: dict[tuple[str, int], Path] = {}
    units: dict[str, Path] = {}
    for trial in trials:
        key = (trial.object_name, trial.number)
        other = seen.setdefault(key, trial.path)
        if other is not trial.path:
            raise ValueError(
                f"trial {trial.number} of '{trial.object_name}' must stand in one file (got "
                f"'{other}' and '{trial.path}')"
            )
        if trial.unit is not None:
            units.setdefault(trial.unit, trial.path)
    if len(units) > 1:
        listed = " and ".join(f"'{unit}' in '{path}'" for unit, path in units.items())
        raise ValueError(f"all recordings must have one unit (got {listed})")


def _numbered_phase(trial: _Trial, names: Sequence[str]) -> Tensor:
    if trial.phase is None:
        return torch.full((len(trial.time),), -1)
    numbers = torch.tensor([names.index(name) for name in trial.phase_names])
    return numbers[torch.from_numpy(trial.phase).long()]
