r"""Cuts the frames of a recording into windows as in the training data."""

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

_MAX_FRAMES = 10**7  # limits the memory that a damaged file can request
_RAGGED_MODES = ("error", "pad", "crop_start", "crop_end")


@dataclass(frozen=True)
class WindowCut:
    r"""The settings with which :class:`~torch_geometric_tactile.data.Windows` or
    :class:`~torch_geometric_tactile.data.Trials` cut a recording.

    Args:
        length (int): Number of frames per window.
        hop (int): Number of frames from the start of one window to the next; 0 if a recording is
            one sample.
        ragged (str): Treatment of recordings with another length, as in
            :class:`~torch_geometric_tactile.data.Trials`.
    """

    length: int
    hop: int = 1
    ragged: str = "error"

    def __post_init__(self) -> None:
        for name, minimum in (("length", 1), ("hop", 0)):
            num_frames = getattr(self, name)
            if type(num_frames) is not int or not minimum <= num_frames <= _MAX_FRAMES:
                raise ValueError(
                    f"'{name}' must be a number of frames of at least {minimum} (got "
                    f"{str(num_frames)[:80]})"
                )
        if self.ragged not in _RAGGED_MODES:
            raise ValueError(
                f"'ragged' must be one of {list(_RAGGED_MODES)} (got {self.ragged!r:.80})"
            )

    @classmethod
    def from_dataset(cls, dataset: StaticDataset) -> Self | None:
        r"""Returns the settings of a data set, or :obj:`None` if its samples are single frames."""
        if isinstance(dataset, Windows):
            return cls(dataset.length, dataset.hop)
        if isinstance(dataset, Trials):
            return cls(dataset.num_cut, 0, dataset.ragged)
        return None

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Returns settings from the mapping that :meth:`to_dict` returned."""
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
        r"""Whether each recording is one sample."""
        return self.hop == 0

    def cut(
        self, frames: StaticData, layout: TaxelLayout, part: Tensor
    ) -> tuple[StaticData, Tensor]:
        r"""Returns the windows of one recording, and the index of the last frame of each window
        :math:`(W,)`. Windows do not span gaps between continuous parts; trials do.

        Shapes:
            - **part:** The index of the continuous part to which each frame belongs, in increasing
              order :math:`(T,)`.
        """
        num_frames = frames.num_samples
        need(num_frames != 0, "there must be at least one frame to predict (got none)")
        if self.ragged == "error" and self.is_trial and num_frames != self.length:
            raise ValueError(
                f"a recording must have {self.length} frames, like the trials on which the model "
                f"was trained (got {num_frames})"
            )
        lengths = part.unique_consecutive(return_counts=True)[1]
        longest = num_frames if self.is_trial else int(lengths.max())
        if self.ragged != "pad" and longest < self.length:
            between_gaps = f" between {len(lengths) - 1} gaps" if longest < num_frames else ""
            raise ValueError(
                f"a recording must have at least {self.length} frames, the length of a window "
                f"(got {longest}{between_gaps})"
            )
        selected = torch.arange(num_frames)
        if not self.is_trial and int(lengths.min()) < self.length:
            selected = selected[(lengths >= self.length).repeat_interleave(lengths)]
        frames = frames.index_select(slice(None) if len(selected) == num_frames else selected)
        frames.trial = (
            torch.zeros(len(selected), dtype=torch.long) if self.is_trial else part[selected]
        )
        frames.step = selected
        source = StaticDataset._from_samples((frames, {}), layout, None, None, None)
        view: Windows | Trials
        if not self.is_trial:
            view = Windows(source, self.length, self.hop, max_gap=math.inf)
        elif self.ragged == "error":
            view = Trials(source)
        else:
            length = max(self.length, num_frames) if self.ragged == "pad" else self.length
            view = Trials(source, ragged=self.ragged, length=length)  # type: ignore[arg-type]
        windows = view.data
        last: Tensor = windows.step
        del windows.step
        return windows, last


def apply_to_frames(transforms: Sequence[Any], windows: StaticData) -> StaticData:
    r"""Applies transforms of single frames to the frames of windows. Afterwards, all attributes
    except the readings belong to the last frame of each window.
    """
    num_frames = windows.num_frames
    data = copy.copy(windows)
    sample_keys = [
        key
        for key, value in windows.to_dict().items()
        if key != "x" and isinstance(value, Tensor) and not windows.is_shared(key)
    ]
    # They are restored after `x` has changed, because all of them must have one row per sample.
    for key in sample_keys:
        del data[key]
    data.x = split_frames(windows.x, num_frames).transpose(1, 2).flatten(0, 1)  # (B * T, N, C)
    for key in sample_keys:
        data[key] = windows[key].repeat_interleave(num_frames, dim=0)
    for transform in transforms:
        data = apply_transform(transform, data)
    x = data.x.unflatten(0, (-1, num_frames)).transpose(1, 2)
    data = data.index_select(slice(num_frames - 1, None, num_frames))
    data.x = join_frames(x)
    return data
