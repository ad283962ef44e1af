r"""The frames of recordings, for any sensor."""

import hashlib
import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.data import Protocol, Recording, StaticData, StaticDataset
from torch_geometric_tactile.data.static_dataset import load_static
from torch_geometric_tactile.datasets.frame_labels import frame_labels
from torch_geometric_tactile.datasets.trial import Trial, check_together, checked_labels, make_trial
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.typing import Filter, PathLike, Transform

_SUFFIXES = (".h5", ".hdf5", ".npz", ".csv")
_PARTS = ("train", "val", "test")
_PATTERN = r"(?P<object>.+)_(?P<trial>\d+)"
_CONTENT = "content=2"  # to be raised when the processed file gets other columns
_FRAMES_PER_BLOCK = 4096
_logger = logging.getLogger(__name__)


class RecordingFrames(StaticDataset):
    r"""The frames of a folder of recordings, or of recordings in memory, for any layout, any number
    of channels and any number of joints (or none). A sample is a frame.

    The folder has one trial a file, in :obj:`root/raw` or in :obj:`root` itself: ``.h5``,
    ``.hdf5``, ``.npz`` or ``.csv``, as :func:`~torch_geometric_tactile.io.read_recording` reads
    them. Beside :obj:`x` and :obj:`y` a sample has :obj:`trial` (the file), :obj:`time` in seconds,
    and, where all files know them, :obj:`joint`, :obj:`group` (the object), :obj:`session` and
    :obj:`property`; :obj:`phase` is -1 in files that know none. Missing readings stay NaN. If the
    layout has one link, the samples share its :obj:`pos` and :obj:`normal`; those of a hand follow
    from the joint angles, see :class:`~torch_geometric_tactile.transforms.TaxelPose`.

    What is known of a recording is read from its metadata or from the name of its file: with the
    :obj:`pattern` that is the default, ``mug_003.csv`` is trial 3 of the object ``mug``.

    All files are processed once, and anew when one of them was added, removed or changed.
    :obj:`split`, :obj:`phases` and :obj:`stride` select from the memory-mapped processed file,
    without a copy of the readings.

    Args:
        root (str or PathLike, optional): Folder of the data set.
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.
        recordings (sequence of Recording, optional): Recordings in memory, in place of
            :obj:`root`.
        target (str): What :obj:`y` is: :obj:`"object"`, its index in :obj:`group_names`;
            :obj:`"property"`, a 0 or 1 for each of the :obj:`"label_names"` in the metadata, from
            the metadata's :obj:`"labels"`; :obj:`"label"`, the label of the recording; or another
            key of the metadata, of the file's name, or of :obj:`privileged` (frame by frame).
        split (str, optional): :obj:`"train"`, :obj:`"val"` or :obj:`"test"`; everything with
            :obj:`None`.
        protocol (Protocol, optional): What is held out; whole trials if left out.
        split_seed (int): Which of the random splits. :obj:`phases` and :obj:`stride` move no frame
            to another split.
        fold (int): Which fold of a protocol with folds is tested on.
        adjacency (str, optional): Which edges of the layout. If left out, its only ones; without
            any, a :obj:`pre_transform` such as
            :class:`~torch_geometric_tactile.transforms.KNNGraph` may add some.
        phases (sequence of str, optional): Only the frames in these phases, of
            :obj:`privileged["phase"]` and :obj:`meta["phase_names"]`.
        stride (int): Only every :obj:`stride`-th frame of each trial.
        pattern (str): Regular expression for the whole name of a file without its suffix. Its named
            groups are known of the recording, such as :obj:`object`, :obj:`trial`, :obj:`session`
            and :obj:`label`. With a :obj:`"/"` in it, files in subfolders are read as well, and
            their names have the folders in front.
        read_options (Mapping, optional): Options of
            :func:`~torch_geometric_tactile.io.read_recording`, such as the names of columns.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once, before the samples are saved.
        pre_filter (callable, optional): Tells whether a sample is kept.
        force_reload (bool): Whether to process the raw files anew.

    Raises:
        FileNotFoundError: If there are no recordings.
        ValueError: If an argument is unknown or leaves no sample, a recording cannot be read or
            does not fit the layout or the others, two hold the same trial, or one does not tell
            what :obj:`target` asks for.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.sensors import grid
        >>> grasps = [
        ...     Recording(time=[0.0, 0.1], tactile=np.zeros((2, 6, 1)), label=label)
        ...     for label in ("slip", "hold", "slip")
        ... ]
        >>> dataset = RecordingFrames(
        ...     layout=grid(2, 3, 0.01), recordings=grasps, target="label", adjacency="original"
        ... )
        >>> dataset, dataset.class_names, dataset.data.y.tolist()
        (RecordingFrames(6), ['hold', 'slip'], [1, 1, 0, 0, 1, 1])
    """

    force_reload: bool

    num_channels: int | None = None  # of a taxel; any number with None
    num_joints: int | None = None
    _needs: tuple[str, ...] = ()  # "object" and "trial", if every recording must know them

    def __init__(
        self,
        root: PathLike | None = None,
        layout: TaxelLayout | PathLike | None = None,
        *,
        recordings: Sequence[Recording] | None = None,
        target: str = "object",
        split: Literal["train", "val", "test"] | None = None,
        protocol: Protocol | None = None,
        split_seed: int = 0,
        fold: int = 0,
        adjacency: str | None = None,
        phases: Sequence[str] | None = None,
        stride: int = 1,
        pattern: str = _PATTERN,
        read_options: Mapping[str, Any] | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
        pre_filter: Filter | None = None,
        force_reload: bool = False,
    ) -> None:
        if split is not None and split not in _PARTS:
            raise ValueError(f"'split' must be 'train', 'val', 'test' or None (got '{split}')")
        if stride < 1:
            raise ValueError(f"'stride' must be at least 1 (got {stride})")
        if (root is None) == (recordings is None):
            both = "none" if root is None else "both"
            raise ValueError(f"one of 'root' and 'recordings' must be given (got {both})")
        if layout is None:
            raise ValueError("'layout' must be the taxels of the recordings (got None)")
        self.layout = as_layout(layout)
        if adjacency is None and len(self.layout.adjacency) == 1:
            (adjacency,) = self.layout.adjacency
        self.target = target
        self.split = split
        self.protocol = Protocol("trial") if protocol is None else protocol
        self.split_seed = split_seed
        self.fold = fold
        self.adjacency = adjacency
        self.phases = (phases,) if isinstance(phases, str) else phases and tuple(phases)
        self.stride = stride
        self.pattern = pattern
        self.read_options = dict(read_options or {})
        self._recordings = None if recordings is None else list(recordings)
        edge_index = None if adjacency is None else self.layout.edge_index(adjacency)
        super().__init__(root, transform, pre_transform, pre_filter, force_reload)
        self._recordings = None
        if not self._is_filtered:
            self._data.edge_index = edge_index
            self._data.y = self._target(self._data, self._names)
        if len(self.group_names) == 1 and target == "object":
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
        inner = root / "raw"
        return str(root if not self._files(inner) and self._files(root) else inner)

    @property
    def raw_file_names(self) -> list[str]:
        r"""The files of the trials, in order."""
        return self._files(Path(self.raw_dir))

    @property
    def raw_paths(self) -> list[str]:
        r"""Their paths."""
        folder = Path(self.raw_dir)  # looked up once for all
        return [str(folder / name) for name in self._files(folder)]

    @property
    def processed_dir(self) -> str:
        r"""The folder of the processed file: one of its own for what a filter or transform saw."""
        folder = Path(self.root, "processed")
        own = f"{self.target}_{self.adjacency}"
        return str(folder / own if self._is_filtered else folder)

    @property
    def processed_file_names(self) -> str:
        r"""One file for all splits, phases and strides."""
        return "recording_frames.pt"

    @property
    def _is_filtered(self) -> bool:
        return self.pre_transform is not None or self.pre_filter is not None

    def _files(self, folder: Path) -> list[str]:
        if not folder.is_dir():
            return []
        found = folder.rglob("*") if "/" in self.pattern else folder.iterdir()
        names = (
            (path, path.relative_to(folder))
            for path in found
            if path.suffix.lower() in _SUFFIXES and path.is_file()
        )
        return sorted(
            name.as_posix()
            for _, name in names
            if name.parts[0] != "processed" and not any(part.startswith(".") for part in name.parts)
        )

    def raw_state(self) -> list[str]:
        r"""Returns the files of the trials with their sizes and times."""
        state = [_CONTENT]
        folder = Path(self.raw_dir)
        for name in self._files(folder):
            stat = (folder / name).stat()
            state.append(f"{name}={stat.st_size},{stat.st_mtime_ns}")
        return state

    def _process(self) -> None:
        path, is_there = Path(self.processed_paths[0]), bool(self.raw_paths)
        is_processed = path.is_file() and not self.force_reload
        if not is_there and not is_processed:
            raise FileNotFoundError(self._no_trials())
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
        state = self.raw_state()
        if self._is_filtered and self.adjacency is not None:
            edges = self.layout.edge_index(self.adjacency).numpy()
            state.append(f"edges={hashlib.sha256(edges.tobytes()).hexdigest()}")
        return state

    def _no_trials(self) -> str:
        return (
            f"there are no trials in '{Path(self.root, 'raw')}' or '{self.root}': put recordings "
            f"there, <object>_<number> with one of {', '.join(_SUFFIXES)}"
        )

    def read_trial(self, path: PathLike) -> Recording:
        r"""Reads the recording in a file; a subclass may read a format of its own.

        Args:
            path (str or PathLike): The file.
        """
        return read_recording(path, **self.read_options)

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Reads all trials."""
        state = [] if self._recordings is not None else self._state()
        x, trials = self._read_trials()
        check_together(trials)
        num_frames = torch.tensor([trial.num_frames for trial in trials])
        names, labels = frame_labels(
            trials,
            self._object_names(trials),
            None if self.target in ("object", "property") else self.target,
            self._properties,
        )
        names["raw"] = state
        data = StaticData(
            x=x,
            time=torch.from_numpy(np.concatenate([trial.time for trial in trials])),
            trial=torch.arange(len(trials)).repeat_interleave(num_frames),
            **labels,
        )
        if self.adjacency is not None:
            data.edge_index = self.layout.edge_index(self.adjacency)
        if len(self.layout.link_names) == 1:
            data.pos, data.normal = self.layout.pos, self.layout.normal
        data.y = self._target(data, names)
        return data, names

    def _object_names(self, trials: Sequence[Trial]) -> list[str]:
        return sorted({trial.object_name for trial in trials if trial.object_name is not None})

    def _properties(self, trial: Trial) -> tuple[tuple[str, ...], tuple[int, ...]] | None:
        # Names and values of the properties of a trial, if they are known.
        labels, names = trial.meta.get("labels"), trial.meta.get("label_names")
        if labels is None or names is None:
            return None
        return tuple(names), checked_labels(trial, names)

    def _trial(self, where: str, name: str, recording: Recording) -> Trial:
        needs = {*self._needs, *(["object"] if self.target == "object" else [])}
        trial = make_trial(
            recording,
            self.layout,
            where=where,
            name=name,
            pattern=self.pattern,
            needs=sorted(needs),
        )
        for what, count, expected in (
            ("channels a taxel", recording.num_channels, self.num_channels),
            ("joint angles a frame, in 'joint'", recording.num_joints, self.num_joints),
        ):
            if expected not in (None, count):
                raise ValueError(f"{where} must have {expected} {what} (got {count or 'none'})")
        return trial

    def _opened(self) -> Iterator[tuple[str, str, Recording]]:
        # What to call each recording in messages, its name, and the recording.
        if self._recordings is not None:
            for i, recording in enumerate(self._recordings):
                yield f"recording {i}", str(i), recording
            return
        folder = Path(self.raw_dir)
        for path in self.raw_paths:
            name = Path(path).relative_to(folder).with_suffix("").as_posix()
            yield f"'{path}'", name, self.read_trial(path)

    def _read_trials(self) -> tuple[Tensor, list[Trial]]:
        trials: list[Trial] = []
        num_missing, num_channels = 0, self.num_channels
        folder = None
        if self._recordings is None:
            folder = Path(self.processed_dir)
            folder.mkdir(parents=True, exist_ok=True)
        # The readings wait on disk, where they may be more than fits into memory.
        with tempfile.TemporaryFile(dir=folder) as file:
            for where, name, recording in self._opened():
                trials.append(self._trial(where, name, recording))
                num_channels = num_channels or recording.num_channels
                if recording.num_channels != num_channels:
                    raise ValueError(
                        f"{where} must have {num_channels} channels a taxel, as {trials[0].where} "
                        f"(got {recording.num_channels})"
                    )
                np.ascontiguousarray(recording.tactile).tofile(file)
                num_missing += int(recording.missing.sum())
            if not trials:
                raise ValueError("'recordings' must hold at least one recording (got none)")
            num_frames = sum(trial.num_frames for trial in trials)
            shape = (num_frames, self.layout.num_taxels, int(num_channels or 1))
            x = torch.from_numpy(np.memmap(file, np.float32, mode="c", shape=shape))
        if num_missing:
            _logger.warning(
                "%d of %d readings of taxels are missing (NaN); see FillMissing and DropTaxels",
                num_missing,
                num_frames * self.layout.num_taxels,
            )
        return x, trials

    def _target(self, data: StaticData, names: Mapping[str, list[str]]) -> Tensor:
        if self.target == "object":
            return data.group.clone()
        if self.target != "property":
            y: Tensor = data.y
            return y
        if names["unknown"]:
            raise ValueError(self._unknown_properties(names["unknown"]))
        target: Tensor = data.property.float()
        return target

    def _unknown_properties(self, unknown: Sequence[str]) -> str:
        return (
            f"the properties of {list(unknown)} are unknown: give 0 or 1 for each as 'labels', and "
            "the same names as 'label_names', in the metadata of all recordings"
        )

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
                f"split='{self.split}' with {self._held_out} and phases={self.phases} must leave "
                f"at least one of {len(kept)} samples in {len(self._data.trial.unique())} trials "
                "(left none)"
            )
        if not kept.all():
            self._indices = kept.nonzero().view(-1).tolist()

    @property
    def _held_out(self) -> str:
        return f"protocol='{self.protocol.describe()}'"

    def _in_split(self, split: str) -> Tensor:
        kept = torch.zeros(self.len(), dtype=torch.bool)
        parts = self.protocol.split(self, self.split_seed, self.fold)
        kept[parts[_PARTS.index(split)]] = True
        return kept

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
        r"""The names of the classes or labels of :obj:`y`."""
        if self.target == "object":
            return self.group_names
        return self.property_names if self.target == "property" else super().class_names

    @property
    def num_classes(self) -> int:
        r"""The number of classes or labels, also where a split lacks one of them."""
        return len(self.class_names)

    @property
    def property_names(self) -> list[str]:
        r"""The names of the columns of :obj:`property`; empty if a recording knows none."""
        return list(self._names["property"])

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


def _changes(before: Sequence[str], now: Sequence[str]) -> str:
    old, new = (dict(line.rpartition("=")[::2] for line in lines) for lines in (before, now))
    changes = [
        f"'{key}' was {'added' if key not in old else 'removed' if key not in new else 'changed'}"
        for key in sorted(old.keys() | new.keys())
        if old.get(key) != new.get(key)
    ]
    more = f" and {len(changes) - 3} more" if len(changes) > 3 else ""
    return ", ".join(changes[:3]) + more
