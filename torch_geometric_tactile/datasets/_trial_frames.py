r"""Base class of data sets of frames: files of trials, and the selection of frames."""

import copy
from collections.abc import Sequence
from functools import partial
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
from torch_geometric_tactile.datasets._frame_reader import UnreadRecording
from torch_geometric_tactile.datasets._raw_files import RawFiles, file_state
from torch_geometric_tactile.datasets._recording_tables import RecordingTables, table_paths
from torch_geometric_tactile.io._folder_tables import TABLES
from torch_geometric_tactile.transforms import Tare

SUFFIXES = (".h5", ".hdf5", ".npz", ".mcap", ".csv")
PARTS = ("train", "val", "test")
_FRAMES_PER_BLOCK = 4096


class TrialFrames(RawFiles):
    r"""A data set whose samples are the frames of trials, one file for each trial.

    Frames are selected by split, phase, stride or rate, or drawn at random from each trial. A
    subclass sets the attributes before it calls :meth:`__init__`.
    """

    group_kind = "object"
    pattern: str
    suffixes: Sequence[str] = SUFFIXES
    _content = "content=7"  # increase when the columns of the processed file change
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
        r"""The folder of the trials: :obj:`root/raw`, or :obj:`root` if only that has trials."""
        root, inner = Path(self.root), Path(self.root, "raw")
        return str(root if not self._files_in(inner) and self._files_in(root) else inner)

    @property
    def raw_file_names(self) -> list[str]:
        r"""The files of the trials, in order."""
        return self._files_in(Path(self.raw_dir))

    def _files_in(self, folder: Path) -> list[str]:
        # Returns sorted paths relative to the folder. With a "/" in the pattern, subfolders are
        # searched as well.
        if not folder.is_dir():
            return []
        names = []
        for path in folder.rglob("*") if "/" in self.pattern else folder.iterdir():
            if path.suffix.lower() not in self.suffixes or path.name in TABLES:
                continue
            if path.is_symlink() and not path.exists():
                raise FileNotFoundError(
                    f"'{path}' is a link to a file that does not exist: remove it"
                )
            name = path.relative_to(folder)
            is_hidden = any(part.startswith(".") for part in name.parts)
            if path.is_file() and name.parts[0] != "processed" and not is_hidden:
                names.append(name.as_posix())
        return sorted(names)

    def raw_state(self) -> list[str]:
        r"""Returns a text for each file and table that changes with the content of the file."""
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

    def _trials_to_read(self) -> list[UnreadRecording]:
        folder, paths = Path(self.raw_dir), [Path(path) for path in self.raw_paths]
        tables = RecordingTables(self._tables(), folder, paths)

        def read(path: Path) -> Recording:
            return tables.add_to(self.read_trial(path), path)

        return [
            UnreadRecording(f"'{path}'", self._trial_name(path), partial(read, path))
            for path in paths
        ]

    def _trial_name(self, path: Path) -> str:
        return path.relative_to(self.raw_dir).with_suffix("").as_posix()

    def _select(self) -> None:
        mask = self._selection_mask()
        if self.samples_per_trial is not None:
            # Drawn before the split, so that the same frames are drawn for all splits.
            trial, names = self._data.trial, self.trial_names
            mask = draw_frames(mask, trial, names, self.samples_per_trial, self.sample_seed)
        if self.split is not None:
            mask &= self._split_mask(self.split)
        if not mask.any():
            raise ValueError(
                f"split='{self.split}' with {self._split_text} and phases={self.phases} must leave "
                f"at least one of {len(mask)} samples in {len(self._data.trial.unique())} trials "
                "(left none)"
            )
        if not mask.all():
            self._indices = mask.nonzero().view(-1).tolist()

    def _selection_mask(self) -> Tensor:
        # Returns which frames are selected by stride, rate, phase and known targets (S,).
        mask = torch.ones(self.len(), dtype=torch.bool)
        if self.stride > 1:
            _, counts = self._data.trial.unique_consecutive(return_counts=True)
            first = (counts.cumsum(0) - counts).repeat_interleave(counts)
            mask &= (torch.arange(len(mask)) - first) % self.stride == 0
        if self.rate is not None:
            self._selected_info = dataset_info(self, self._known_info())
            mask &= selected_at_rate(self._data.time, self._data.trial, self._selected_info)
        if self.phases is not None:
            mask &= self._phase_mask(self.phases)
        if self._data.y.is_floating_point():  # a regression target may be NaN
            mask &= self._data.y.view(len(mask), -1).isfinite().all(dim=1)
        return mask

    def _known_info(self) -> FrameInfo:
        # The rate of the selected frames cannot be measured; the rate before the selection is used.
        if self._selected_info is not None:
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
        # The reading at rest is measured on all frames and subtracted before other transforms.
        if self.tare is None:
            return
        frames = copy.copy(self)
        tare = Tare("trial")
        if isinstance(self.tare, str):
            frames._indices = self._rest_mask(self.tare).nonzero().view(-1).tolist()
            tare.fit(frames)
        else:
            timed_tare = Tare("trial", seconds=self.tare).fit(frames)
            tare.load_state_dict(timed_tare.state_dict())
        self.transform = tare if self.transform is None else Compose([tare, self.transform])

    def _rest_mask(self, phase: str) -> Tensor:
        # Returns which frames are in the phase at rest (S,).
        if phase not in self.phase_names:
            raise ArgumentError(
                Argument("tare"),
                f" must be seconds, or a phase of the recordings: {self.phase_names or None} "
                f"(got '{phase}')",
            )
        mask: Tensor = self._data.phase == self.phase_names.index(phase)
        trials = self._data.trial
        missing_trials = trials[~torch.isin(trials, trials[mask])].unique().tolist()
        if missing_trials:
            raise ArgumentError(
                Argument("tare"),
                f" must be a phase that every trial has (got '{phase}', which is not in "
                f"'{self.trial_names[missing_trials[0]]}')",
            )
        return mask

    @property
    def _split_text(self) -> str:
        # The arguments of the split, for error messages.
        return f"protocol='{self.protocol.describe()}'"

    def _split_mask(self, split: str) -> Tensor:
        mask = torch.zeros(self.len(), dtype=torch.bool)
        parts = self.protocol.split(self, self.split_seed, self.fold)
        mask[parts[PARTS.index(split)]] = True
        return mask

    def _phase_mask(self, phases: Sequence[str]) -> Tensor:
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
        indices = torch.tensor([self.phase_names.index(name) for name in phases])
        return torch.isin(self._data.phase, indices)

    @property
    def phase_names(self) -> list[str]:
        r"""The names of the phases in :obj:`phase`. The list is empty if no phase is known."""
        return list(self._names["phase"])

    @property
    def placement_names(self) -> list[str]:
        r"""The names of the placements in :obj:`placement`. The list is empty if the placement of a
        recording is unknown.
        """
        return list(self._names.get("placement", ()))

    @property
    def size_names(self) -> list[str]:
        r"""The names of the sizes in :obj:`size`. The list is empty if the size of an object is
        unknown.
        """
        return list(self._names.get("size", ()))

    @property
    def property_names(self) -> list[str]:
        r"""The names of the columns of :obj:`property`. The list is empty if the properties of an
        object are unknown.
        """
        return list(self._names["property"])

    @property
    def synthetic(self) -> bool:
        r"""Whether any of the recordings is simulated."""
        return bool(self._names["synthetic"])

    @property
    def num_missing(self) -> int:
        r"""The number of missing taxel readings, summed over the frames of this selection."""
        blocks = torch.as_tensor(self.indices()).split(_FRAMES_PER_BLOCK)
        return sum(int(self._data.x[block].isnan().any(dim=-1).sum()) for block in blocks)


def draw_frames(
    candidate: Tensor, trial: Tensor, names: Sequence[str], num_draws: int, seed: int
) -> Tensor:
    r"""Draws frames of each trial at random, without replacement. The frames drawn from a trial
    depend only on the seed, its name and its candidates, not on other trials.

    Args:
        candidate (Tensor): Which frames may be drawn.
        trial (Tensor): Trial of each frame. The frames of a trial must be consecutive.
        names (sequence of str): Names of the trials.
        num_draws (int): Number of frames of each trial. If a trial has fewer candidates, all of
            them are drawn.
        seed (int): Seed of the draws.

    Shapes:
        - **candidate:** booleans :math:`(S,)`
        - **trial:** indices into :obj:`names` :math:`(S,)`
        - **output:** which frames are drawn, as booleans :math:`(S,)`
    """
    mask = torch.zeros(len(candidate), dtype=torch.bool)
    for rows in _trial_slices(trial):
        candidates = rows.start + candidate[rows].nonzero().view(-1)
        rng = np.random.default_rng([seed, *names[int(trial[rows.start])].encode()])
        mask[candidates[torch.from_numpy(rng.permutation(len(candidates))[:num_draws])]] = True
    return mask


def check_frame_selection(rate: Any, samples_per_trial: Any, sample_seed: Any) -> None:
    r"""Checks the arguments of a data set that select frames."""
    is_number = isinstance(rate, int | float) and not isinstance(rate, bool)
    if rate is not None and not (is_number and 0 < rate < float("inf")):
        raise ValueError(
            f"'rate' must be a number of frames per second above 0, or None (got {rate!r})"
        )
    if samples_per_trial is not None and not _is_integer(samples_per_trial, 1):
        raise ValueError(
            f"'samples_per_trial' must be an integer, at least 1, or None (got "
            f"{samples_per_trial!r})"
        )
    if not _is_integer(sample_seed, 0):
        raise ValueError(f"'sample_seed' must be an integer, at least 0 (got {sample_seed!r})")


def _is_integer(value: Any, minimum: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= minimum


def _trial_slices(trial: Tensor) -> list[slice]:
    _, counts = trial.unique_consecutive(return_counts=True)
    ends = counts.cumsum(0).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts.tolist(), strict=True)]
