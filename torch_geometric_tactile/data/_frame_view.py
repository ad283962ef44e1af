r"""The base class of data sets whose samples are cut from the frames of another data set."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._batches import join_batches
from torch_geometric_tactile.data._trial_runs import TrialRuns
from torch_geometric_tactile.data._window_data import WindowData
from torch_geometric_tactile.data.apply_transform import apply_transform
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset

_logger = logging.getLogger(__name__)
# Attributes of data sets of recordings that also apply to windows of their frames.
_FRAME_DATASET_ATTRIBUTES = (
    "phase_names",
    "placement_names",
    "property_names",
    "size_names",
    "synthetic",
)
_CHUNK_BYTES = 2**26  # size of the windows that are transformed at a time


class FrameView(StaticDataset):
    r"""The base class of data sets whose samples are cut from the frames of another data set at
    each access: :class:`~torch_geometric_tactile.data.Windows` and
    :class:`~torch_geometric_tactile.data.Trials`. A subclass defines :meth:`_window_arguments`.
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
        #: The names of the trials that are left out because they are too short.
        self.too_short: list[str] = []
        super().__init__(None, transform, pre_transform)

    def _window_arguments(self, runs: TrialRuns) -> dict[str, Any]:
        # Returns the arguments of `WindowData` that depend on the subclass, such as `length` and
        # `starts` (W,), the indices of selected frames.
        raise NotImplementedError

    def _record_short_trials(self, runs: TrialRuns, length: int) -> None:
        # Stores and logs the names of the trials that are too short for a window.
        max_length, short = int(runs.length.max()), (runs.length < length).nonzero().view(-1)
        if max_length < length:
            raise ArgumentError(
                Argument("length"),
                f" must be at most {max_length} frames, the length of the longest trial, "
                f"{runs.name(int(runs.length.argmax()))} (got {length})",
            )
        self.too_short = [runs.name(int(i)) for i in short]
        if len(short):
            _logger.warning(
                "%d of %d trials are left out because they have fewer than %d frames: %s",
                len(short),
                len(runs.length),
                length,
                short_list(short.tolist(), 3, runs.name),
            )

    def _label_key(self, runs: TrialRuns, constant: bool) -> str | None:
        # Returns the name of the attribute that labels the windows, or None if the frames have no
        # labels. With `constant`, the attribute must not change within a trial.
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
        r"""The properties of the frames from which the samples are cut."""
        return self._info

    @property
    def data(self) -> StaticData:
        r"""All samples of this selection, cut from the frames, before :obj:`transform`. The samples
        may take much more memory than the frames.
        """
        stored = self._selected()
        return stored.index_select(slice(None)) if isinstance(stored, WindowData) else stored

    @property
    def nbytes(self) -> int:
        r"""The size of the frames in bytes, or of the samples after :obj:`pre_transform`."""
        stored = self._data
        return super().nbytes if isinstance(stored, StaticData) else self.dataset.nbytes

    @property
    def transforms(self) -> list[Transform | None]:
        r"""All transforms that run at every access, starting with those of the frames."""
        return [*self.dataset.transforms, self.transform]

    def __getattr__(self, key: str) -> Any:
        if key in _FRAME_DATASET_ATTRIBUTES:
            return getattr(self.__dict__["dataset"], key)
        return super().__getattr__(key)

    def _selected(self) -> Any:
        if isinstance(self._data, WindowData) and self._indices is not None:
            return self._data.select(self._index())
        return super()._selected()

    def _stored_tensors(self) -> Mapping[str, Any]:
        return (
            self.dataset._stored_tensors()
            if isinstance(self._data, WindowData)
            else super()._stored_tensors()
        )

    def _build(self) -> tuple[Any, dict[str, list[str]]]:
        runs = TrialRuns.from_dataset(self.dataset)
        window_arguments = self._window_arguments(runs)
        order = None if self.dataset._indices is None else self.dataset._index()
        frames = self.dataset._data
        windows = WindowData(
            frames,
            order=order,
            series=self.series,
            transform=self.dataset.transform,
            **window_arguments,
        )
        names = dict(self.dataset._names)
        # Read from the property, since a data set may store the names of 'y' under another key
        # than "class".
        y_names = self.dataset.class_names
        names["class"] = list(y_names if self.target == "y" else names.get(self.target, ()))
        if self.pre_transform is None:
            return windows, names
        return _transform_in_chunks(windows, self.pre_transform), names


def _checked_series(dataset: StaticDataset, series: Sequence[str]) -> tuple[str, ...]:
    if isinstance(series, str):
        raise ValueError(f"'series' must be a list of names (got '{series}')")
    data = dataset._data
    for name in series:
        if name in ("x", "y") or name not in data or data.is_shared(name):
            raise ValueError(
                f"'series' must name attributes that each frame has, except 'x' and 'y' (got "
                f"'{name}')"
            )
        if data.level(name) != "sample":
            raise ValueError(
                f"'series' must name attributes with one row for each frame (got '{name}', with a "
                f"row for each {data.level(name)})"
            )
    return tuple(series)


def _transform_in_chunks(windows: WindowData, transform: Transform) -> StaticData:
    # In chunks, since all windows together may not fit into memory.
    size = windows.length * windows.frames.x[:1].numel() * windows.frames.x.element_size()
    parts = torch.arange(windows.num_samples).split(max(1, _CHUNK_BYTES // max(size, 1)))
    chunks = [apply_transform(transform, windows.index_select(part)) for part in parts]
    return chunks[0] if len(chunks) == 1 else join_batches(chunks, parts)


def innermost(dataset: Any) -> Any:
    r"""Returns the data set at the end of a chain of views, which is not a view itself."""
    while isinstance(dataset, FrameView):
        dataset = dataset.dataset
    return dataset


def dataset_part(dataset: Any) -> str | None:
    r"""Returns the part with which a data set, or the data set behind a view, was built, such as
    :obj:`"train"`. Returns :obj:`None` if the data set has no parts or was built with all of them.
    """
    if not isinstance(dataset, StaticDataset):
        return None
    part = getattr(innermost(dataset), "split", None)
    return part if isinstance(part, str) else None
