r"""Frames of trials, of which some are chosen, and the files that the trials are in."""

import copy
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import Argument, ArgumentError, need_argument
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import FrameInfo, Protocol, Recording
from torch_geometric_tactile.data._dataset_info import dataset_info, selected_at_rate
from torch_geometric_tactile.datasets._raw_files import RawFiles, file_state
from torch_geometric_tactile.datasets._recording_tables import RecordingTables, table_paths
from torch_geometric_tactile.io._folder_tables import TABLES
from torch_geometric_tactile.transforms import Tare

SUFFIXES = (".h5", ".hdf5", ".npz", ".mcap", ".csv")
PARTS = ("train", "val", "test")
_FRAMES_PER_BLOCK = 4096


class TrialFrames(RawFiles):
    r"""A data set whose samples are the frames of trials, one trial a file: all of them, or those
    of a part that a protocol holds out, of some phases, at a stride or a rate, or some of each
    trial. A subclass sets the attributes.
    """

    group_kind = "object"
    pattern: str
    suffixes: Sequence[str] = SUFFIXES
    _content = "content=6"  # to be raised when the processed file gets other columns
    split: Any
    _indices: Any
    protocol: Protocol
    split_seed: int
    fold: int
    phases: Sequence[str] | None
    stride: int
    rate: float | None = None
    resample: float | None = None
    samples_per_trial: int | None = None
    sample_seed: int = 0
    tare: float | str | None = None
    transform: Any
    _selected_info: FrameInfo | None = None

    @property
    def raw_dir(self) -> str:
        r"""The folder of the trials: :obj:`root/raw`, or :obj:`root` where that has none."""
        root, inner = Path(self.root), Path(self.root, "raw")
        return str(root if not self._files_in(inner) and self._files_in(root) else inner)

    @property
    def raw_file_names(self) -> list[str]:
        r"""The files of the trials, in order."""
        return self._files_in(Path(self.raw_dir))

    def _files_in(self, folder: Path) -> list[str]:
        # In order; with a "/" in the pattern also those in subfolders, with their names in front.
        if not folder.is_dir():
            return []
        names = []
        for path in folder.rglob("*") if "/" in self.pattern else folder.iterdir():
            if path.suffix.lower() not in self.suffixes or path.name in TABLES:
                continue
            if path.is_symlink() and not path.exists():
                raise FileNotFoundError(
                    f"'{path}' is a link to a file that is not there: remove it"
                )
            name = path.relative_to(folder)
            is_hidden = any(part.startswith(".") for part in name.parts)
            if path.is_file() and name.parts[0] != "processed" and not is_hidden:
                names.append(name.as_posix())
        return sorted(names)

    def raw_state(self) -> list[str]:
        r"""Returns the files of the trials, and the tables that tell of them, with what their
        contents are known by.
        """
        tables = [f"{path.relative_to(self.root)}={file_state(path)}" for path in self._tables()]
        return [self._content, *tables, *super().raw_state()]

    def _tables(self) -> list[Path]:
        folders = {Path(path).parent for path in self.raw_paths}
        return table_paths({Path(self.root), Path(self.raw_dir), *folders})

    def _no_files(self) -> str:
        return (
            f"there are no trials in '{Path(self.root, 'raw')}' or '{self.root}': put recordings "
            f"there, <object>_<number> with one of {', '.join(SUFFIXES)}"
        )

    def read_trial(self, path: PathLike) -> Recording:
        r"""Reads the recording in a file."""
        raise NotImplementedError

    def _opened(self) -> Iterator[tuple[str, str, Recording]]:
        # What to call each recording in messages, its name, and the recording.
        folder, paths = Path(self.raw_dir), [Path(path) for path in self.raw_paths]
        tables = RecordingTables(self._tables(), folder, paths)
        for path in paths:
            name = path.relative_to(folder).with_suffix("").as_posix()
            yield f"'{path}'", name, tables.give(self.read_trial(path), path)

    def _select(self) -> None:
        kept = self._chosen()
        if self.samples_per_trial is not None:
            # Before the split, so that it decides on none of them.
            trial, names = self._data.trial, self.trial_names
            kept = drawn_frames(kept, trial, names, self.samples_per_trial, self.sample_seed)
        if self.split is not None:
            kept &= self._in_split(self.split)
        if not kept.any():
            raise ValueError(
                f"split='{self.split}' with {self._held_out} and phases={self.phases} must leave "
                f"at least one of {len(kept)} samples in {len(self._data.trial.unique())} trials "
                "(left none)"
            )
        if not kept.all():
            self._indices = kept.nonzero().view(-1).tolist()

    def _chosen(self) -> Tensor:
        kept = torch.ones(self.len(), dtype=torch.bool)
        if self.stride > 1:
            _, counts = self._data.trial.unique_consecutive(return_counts=True)
            first = (counts.cumsum(0) - counts).repeat_interleave(counts)
            kept &= (torch.arange(len(kept)) - first) % self.stride == 0
        if self.rate is not None:
            self._selected_info = dataset_info(self, self._known_info())
            kept &= selected_at_rate(self._data.time, self._data.trial, self._selected_info)
        if self.phases is not None:
            kept &= self._in_phases(self.phases)
        if self._data.y.is_floating_point():  # what has no target cannot be learned from
            kept &= self._data.y.view(len(kept), -1).isfinite().all(dim=1)
        return kept

    def _known_info(self) -> FrameInfo:
        if self._selected_info is not None:  # of all trials, by which frames were selected
            return self._selected_info.changed(stride=1)
        (unit,) = self._names.get("unit") or (None,)
        columns = {key: self._names.get(f"{key}_columns") for key in ("tactile", "joint")}
        return FrameInfo(
            rate=self.resample,
            resampled=self.resample is not None,
            selected_rate=self.rate,
            unit=unit,
            columns={key: names for key, names in columns.items() if names},
            rest=float(self.tare) if isinstance(self.tare, int | float) else None,
        )

    def _tare(self) -> None:
        # Rest readings are measured on all frames, and subtracted before any other transform.
        if self.tare is None:
            return
        frames = copy.copy(self)
        tare = Tare("trial")
        if isinstance(self.tare, str):
            frames._indices = self._at_rest(self.tare).nonzero().view(-1).tolist()
            tare.fit(frames)
        else:
            timed = Tare("trial", seconds=self.tare).fit(frames)
            tare.load_state_dict(timed.state_dict())
        self.transform = tare if self.transform is None else Compose([tare, self.transform])

    def _at_rest(self, phase: str) -> Tensor:
        if phase not in self.phase_names:
            raise ArgumentError(
                Argument("tare"),
                f" must be seconds, or a phase of the recordings: {self.phase_names or None} "
                f"(got '{phase}')",
            )
        kept: Tensor = self._data.phase == self.phase_names.index(phase)
        trials = self._data.trial
        without = trials[~torch.isin(trials, trials[kept])].unique().tolist()
        if without:
            raise ArgumentError(
                Argument("tare"),
                f" must be a phase that every trial has (got '{phase}', which is not in "
                f"'{self.trial_names[without[0]]}')",
            )
        return kept

    @property
    def _held_out(self) -> str:
        return f"protocol='{self.protocol.describe()}'"

    def _in_split(self, split: str) -> Tensor:
        kept = torch.zeros(self.len(), dtype=torch.bool)
        parts = self.protocol.split(self, self.split_seed, self.fold)
        kept[parts[PARTS.index(split)]] = True
        return kept

    def _in_phases(self, phases: Sequence[str]) -> Tensor:
        if not self.phase_names:
            raise ArgumentError(
                Argument("phases"),
                f" must be None, since no recording in '{self.root}' has "
                f"'phase_names' (got {phases})",
            )
        unknown = [name for name in phases if name not in self.phase_names]
        need_argument(
            not unknown and phases, "phases", f"must be some of {self.phase_names}", phases
        )
        wanted = torch.tensor([self.phase_names.index(name) for name in phases])
        return torch.isin(self._data.phase, wanted)

    @property
    def phase_names(self) -> list[str]:
        r"""The names of the phases in :obj:`phase`; empty if no recording knows its phases."""
        return list(self._names["phase"])

    @property
    def placement_names(self) -> list[str]:
        r"""The names of the placements in :obj:`placement`; empty if a recording knows none."""
        return list(self._names.get("placement", ()))

    @property
    def size_names(self) -> list[str]:
        r"""The names of the sizes in :obj:`size`; empty if a recording knows none."""
        return list(self._names.get("size", ()))

    @property
    def property_names(self) -> list[str]:
        r"""The names of the columns of :obj:`property`; empty if a recording knows none."""
        return list(self._names["property"])

    @property
    def synthetic(self) -> bool:
        r"""Whether a simulator made any of the recordings."""
        return bool(self._names["synthetic"])

    @property
    def num_missing(self) -> int:
        r"""How many taxels have no reading, summed over the frames of this selection."""
        blocks = torch.as_tensor(self.indices()).split(_FRAMES_PER_BLOCK)
        return sum(int(self._data.x[block].isnan().any(dim=-1).sum()) for block in blocks)


def drawn_frames(
    candidate: Tensor, trial: Tensor, names: Sequence[str], count: int, seed: int
) -> Tensor:
    r"""Tells which frames are drawn: so many of each trial, or all where there are fewer. What is
    drawn of a trial follows from the seed, its name and its own frames.

    Shapes:
        - **candidate:** Which frames may be drawn :math:`(S,)`.
        - **trial:** Trial of each frame, those of one trial in a row :math:`(S,)`.
        - **output:** booleans :math:`(S,)`
    """
    kept = torch.zeros(len(candidate), dtype=torch.bool)
    for rows in _rows(trial):
        found = rows.start + candidate[rows].nonzero().view(-1)
        rng = np.random.default_rng([seed, *names[int(trial[rows.start])].encode()])
        kept[found[torch.from_numpy(rng.permutation(len(found))[:count])]] = True
    return kept


def check_choice(rate: Any, samples_per_trial: Any, sample_seed: Any) -> None:
    r"""Checks the arguments of a data set that choose frames."""
    is_number = isinstance(rate, int | float) and not isinstance(rate, bool)
    if rate is not None and not (is_number and 0 < rate < float("inf")):
        raise ValueError(f"'rate' must be frames a second, above 0, or None (got {rate!r})")
    if samples_per_trial is not None and not _is_whole(samples_per_trial, 1):
        raise ValueError(
            f"'samples_per_trial' must be a whole number from 1 on, or None (got "
            f"{samples_per_trial!r})"
        )
    if not _is_whole(sample_seed, 0):
        raise ValueError(f"'sample_seed' must be a whole number from 0 on (got {sample_seed!r})")


def _is_whole(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _rows(trial: Tensor) -> list[slice]:
    _, counts = trial.unique_consecutive(return_counts=True)
    ends = counts.cumsum(0).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts.tolist(), strict=True)]
