r"""Data sets whose samples are cut from the frames of another one."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._batches import joined
from torch_geometric_tactile.data._trial_runs import TrialRuns
from torch_geometric_tactile.data._window_data import WindowData
from torch_geometric_tactile.data.apply_transform import apply_transform
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset

_logger = logging.getLogger(__name__)
# What data sets of recordings tell of themselves, which holds for the windows of their frames.
_OF_FRAMES = (
    "phase_names",
    "placement_names",
    "property_names",
    "size_names",
    "synthetic",
    "trial_names",
)
_BYTES = 2**26  # of the windows that are transformed at a time


class FrameView(StaticDataset):
    r"""A data set whose samples are cut from the frames of another one, when they are asked for:
    the base class of :class:`~torch_geometric_tactile.data.Windows` and
    :class:`~torch_geometric_tactile.data.Trials`, which define :meth:`_choose`.
    """

    def __init__(
        self,
        dataset: StaticDataset,
        target: str = "y",
        series: Sequence[str] = (),
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
    ) -> None:
        if not isinstance(dataset, StaticDataset):
            raise TypeError(
                f"'dataset' must be a StaticDataset of frames (got {type(dataset).__name__})"
            )
        if dataset.column("num_frames") is not None:
            raise ValueError("'dataset' must hold frames (got samples of several frames)")
        need(len(dataset) != 0, "'dataset' must hold at least one frame (got none)")
        self.dataset = dataset
        self.layout = dataset.layout
        self.target = target
        self.series = _checked_series(dataset, series)
        #: The names of the trials that were left out, since they are too short.
        self.too_short: list[str] = []
        super().__init__(None, transform, pre_transform)

    def _choose(self, runs: TrialRuns) -> dict[str, Any]:
        # `starts` (W,), counted in the frames of the selection, and further arguments of WindowData
        raise NotImplementedError

    def _drop_short(self, runs: TrialRuns, length: int) -> None:
        # Counts, names and logs the trials that are left out.
        longest, short = int(runs.length.max()), (runs.length < length).nonzero().view(-1)
        if longest < length:
            raise ArgumentError(
                Argument("length"),
                f" must be at most that of the longest trial, {longest} frames in "
                f"{runs.name(int(runs.length.argmax()))} (got {length})",
            )
        self.too_short = [runs.name(int(i)) for i in short]
        if len(short):
            _logger.warning(
                "%d of %d trials are left out, since they have fewer than %d frames: %s",
                len(short),
                len(runs.length),
                length,
                short_list(short.tolist(), 3, runs.name),
            )

    def _label(self, runs: TrialRuns, constant: bool) -> str | None:
        # The attribute that labels the windows: none if the frames have no labels at all.
        value = self.dataset.column(self.target)
        if value is None and self.target == "y":
            return None
        if not isinstance(value, Tensor) or self.dataset._data.is_shared(self.target):
            raise ValueError(
                f"'target' must name an attribute that each frame has (got '{self.target}')"
            )
        if constant:
            runs.require_constant(self.target, value)
        return self.target

    @property
    def info(self) -> FrameInfo:
        r"""How the frames that the samples are cut from were made."""
        return self._info

    @property
    def data(self) -> StaticData:
        r"""All samples of this selection at once, cut, before :obj:`transform`. They may take much
        more memory than the frames.
        """
        stored = self._selected()
        return stored.index_select(slice(None)) if isinstance(stored, WindowData) else stored

    @property
    def nbytes(self) -> int:
        r"""The bytes of the frames, or of the samples that :obj:`pre_transform` made of them."""
        stored = self._data
        return super().nbytes if isinstance(stored, StaticData) else self.dataset.nbytes

    @property
    def transforms(self) -> list[Transform | None]:
        r"""All transforms that run at every access, of the frames first."""
        return [*self.dataset.transforms, self.transform]

    def __getattr__(self, key: str) -> Any:
        if key in _OF_FRAMES:
            return getattr(self.__dict__["dataset"], key)
        return super().__getattr__(key)

    def _selected(self) -> Any:
        if isinstance(self._data, WindowData) and self._indices is not None:
            return self._data.select(self._index())
        return super()._selected()

    def _watched(self) -> Mapping[str, Any]:
        return self.dataset._watched() if isinstance(self._data, WindowData) else super()._watched()

    def _build(self) -> tuple[Any, dict[str, list[str]]]:
        runs = TrialRuns.of(self.dataset)
        chosen = self._choose(runs)
        order = None if self.dataset._indices is None else self.dataset._index()
        frames = self.dataset._data
        windows = WindowData(
            frames, order=order, series=self.series, transform=self.dataset.transform, **chosen
        )
        names = dict(self.dataset._names)
        of_y = self.dataset.class_names  # which may have another name than "class" there
        names["class"] = list(of_y if self.target == "y" else names.get(self.target, ()))
        if self.pre_transform is None:
            return windows, names
        return _transformed(windows, self.pre_transform), names


def _checked_series(dataset: StaticDataset, series: Sequence[str]) -> tuple[str, ...]:
    if isinstance(series, str):
        raise ValueError(f"'series' must be a list of names (got '{series}')")
    data = dataset._data
    for name in series:
        if name in ("x", "y") or name not in data or data.is_shared(name):
            raise ValueError(
                f"'series' must name attributes that each frame has, but 'x' and 'y' (got '{name}')"
            )
        if data.level(name) != "sample":
            raise ValueError(
                f"'series' must name attributes with one row for each frame (got '{name}', with a "
                f"row for each {data.level(name)})"
            )
    return tuple(series)


def _transformed(windows: WindowData, transform: Transform) -> StaticData:
    # A few at a time, since all windows together may not fit into memory.
    size = windows.length * windows.frames.x[:1].numel() * windows.frames.x.element_size()
    parts = torch.arange(windows.num_samples).split(max(1, _BYTES // max(size, 1)))
    chunks = [apply_transform(transform, windows.index_select(part)) for part in parts]
    return chunks[0] if len(chunks) == 1 else joined(chunks, parts)


def innermost(dataset: Any) -> Any:
    r"""Returns the data set that a view shows, or that this one shows, and so on; the data set
    itself if it is no view.
    """
    while isinstance(dataset, FrameView):
        dataset = dataset.dataset
    return dataset


def dataset_part(dataset: Any) -> str | None:
    r"""Returns the part that a data set, or the one that a view shows, was built with, such as
    :obj:`"train"`; :obj:`None` for all samples, and for what knows no parts.
    """
    if not isinstance(dataset, StaticDataset):
        return None
    part = getattr(innermost(dataset), "split", None)
    return part if isinstance(part, str) else None
