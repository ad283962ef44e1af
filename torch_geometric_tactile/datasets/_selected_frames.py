r"""Frames of trials, of which some are chosen."""

import copy
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import Protocol, StaticDataset
from torch_geometric_tactile.datasets._chosen_frames import drawn_frames, frames_at_rate
from torch_geometric_tactile.transforms import Tare

PARTS = ("train", "val", "test")
_FRAMES_PER_BLOCK = 4096


class SelectedFrames(StaticDataset):
    r"""A data set whose samples are frames of trials: the frames of a part that a protocol holds
    out, of some phases, at a stride or a rate, or some of each trial. Base class of
    :class:`~torch_geometric_tactile.datasets.RecordingFrames`, which sets the attributes.
    """

    split: Any
    _indices: Any
    protocol: Protocol
    split_seed: int
    fold: int
    phases: Sequence[str] | None
    stride: int
    rate: float | None = None
    samples_per_trial: int | None = None
    sample_seed: int = 0
    tare: float | str | None
    transform: Any

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
            kept &= frames_at_rate(self._data.time, self._data.trial, self.rate)
        if self.phases is not None:
            kept &= self._in_phases(self.phases)
        if self._data.y.is_floating_point():  # what has no target cannot be learned from
            kept &= self._data.y.view(len(kept), -1).isfinite().all(dim=1)
        return kept

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
            raise ValueError(
                f"'tare' must be seconds, or a phase of the recordings: {self.phase_names or None} "
                f"(got '{phase}')"
            )
        kept: Tensor = self._data.phase == self.phase_names.index(phase)
        trials = self._data.trial
        without = trials[~torch.isin(trials, trials[kept])].unique().tolist()
        if without:
            raise ValueError(
                f"'tare' must be a phase that every trial has (got '{phase}', which is not in "
                f"'{self.trial_names[without[0]]}')"
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
    def trial_names(self) -> list[str]:
        r"""The names of the files behind :obj:`trial`, without their suffix."""
        return list(self._names["trial"])

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
