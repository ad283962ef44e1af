r"""Cutting the frames of a recording as those of a data set were cut."""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import (
    StaticData,
    StaticDataset,
    Trials,
    Windows,
    apply_transform,
    join_frames,
    split_frames,
)
from torch_geometric_tactile.sensors import TaxelLayout

_MOST = 10**7  # frames
_RAGGED = ("error", "pad", "crop_start", "crop_end")


@dataclass(frozen=True)
class WindowCut:
    r"""What :class:`~torch_geometric_tactile.data.Windows` or
    :class:`~torch_geometric_tactile.data.Trials` cut out of a recording, as a value.
    """

    length: int
    hop: int = 1
    ragged: str = "error"

    def __post_init__(self) -> None:
        for name, least in (("length", 1), ("hop", 0)):
            number = getattr(self, name)
            if type(number) is not int or not least <= number <= _MOST:
                raise ValueError(
                    f"'{name}' must be a number of frames from {least} on (got {str(number)[:80]})"
                )
        if self.ragged not in _RAGGED:
            raise ValueError(f"'ragged' must be one of {list(_RAGGED)} (got {self.ragged!r:.80})")

    @classmethod
    def of_dataset(cls, dataset: StaticDataset) -> Self | None:
        r"""Returns how a data set cuts its frames; :obj:`None` if it does not."""
        if isinstance(dataset, Windows):
            return cls(dataset.length, dataset.hop)
        if isinstance(dataset, Trials):
            return cls(dataset.num_cut, 0, dataset.ragged)
        return None

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds it from what :meth:`to_dict` returns."""
        if not isinstance(content, Mapping) or set(content) != {"length", "hop", "ragged"}:
            raise ValueError(
                f"a window must have 'length', 'hop' and 'ragged' (got {str(content)[:80]})"
            )
        return cls(**content)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values."""
        return asdict(self)

    @property
    def is_trial(self) -> bool:
        r"""Whether a recording as a whole is one sample."""
        return self.hop == 0

    def cut(
        self, frames: StaticData, layout: TaxelLayout, part: Tensor
    ) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of the frames of one recording, and the last frame of each
        :math:`(W,)`. Whole recordings are not cut at gaps.

        Shapes:
            - **part:** The number of the continuous part of each frame, increasing :math:`(T,)`.
        """
        count = frames.num_samples
        need(count != 0, "there must be at least one frame to predict (got none)")
        if self.ragged == "error" and self.is_trial and count != self.length:
            raise ValueError(
                f"a recording must have {self.length} frames, as the trials that the model was "
                f"trained on (got {count})"
            )
        lengths = part.unique_consecutive(return_counts=True)[1]
        longest = count if self.is_trial else int(lengths.max())
        if self.ragged != "pad" and longest < self.length:
            parts = f" between {len(lengths) - 1} gaps" if longest < count else ""
            raise ValueError(
                f"a recording must have at least {self.length} frames, the length of a window "
                f"(got {longest}{parts})"
            )
        kept = torch.arange(count)
        if not self.is_trial and int(lengths.min()) < self.length:
            kept = kept[(lengths >= self.length).repeat_interleave(lengths)]
        frames = frames.index_select(slice(None) if len(kept) == count else kept)
        frames.trial = torch.zeros(len(kept), dtype=torch.long) if self.is_trial else part[kept]
        frames.step = kept
        source = StaticDataset._from_samples((frames, {}), layout, None, None, None)
        view: Windows | Trials
        if not self.is_trial:
            view = Windows(source, self.length, self.hop, max_gap=math.inf)
        elif self.ragged == "error":
            view = Trials(source)
        else:
            length = max(self.length, count) if self.ragged == "pad" else self.length
            view = Trials(source, ragged=self.ragged, length=length)  # type: ignore[arg-type]
        windows = view.data
        last: Tensor = windows.step
        del windows.step
        return windows, last


def frame_by_frame(parts: Sequence[Any], windows: StaticData) -> StaticData:
    r"""Applies transforms of frames to windows. Other attributes become those of the last frame."""
    num_frames = windows.num_frames
    data = copy.copy(windows)
    of_samples = [
        key
        for key, value in windows.to_dict().items()
        if key != "x" and isinstance(value, Tensor) and not windows.is_shared(key)
    ]
    for key in of_samples:  # with which the number of samples would have to agree
        del data[key]
    data.x = split_frames(windows.x, num_frames).transpose(1, 2).flatten(0, 1)  # (B * T, N, C)
    for key in of_samples:
        data[key] = windows[key].repeat_interleave(num_frames, dim=0)
    for part in parts:
        data = apply_transform(part, data)
    x = data.x.unflatten(0, (-1, num_frames)).transpose(1, 2)
    data = data.index_select(slice(num_frames - 1, None, num_frames))
    data.x = join_frames(x)
    return data
