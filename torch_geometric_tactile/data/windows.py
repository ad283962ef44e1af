r"""Windows of consecutive frames as samples."""

import logging
from collections.abc import Sequence
from typing import Any, Literal

import torch

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._dataset_info import selected_frames
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.data._trial_runs import TrialRuns
from torch_geometric_tactile.data._window_data import WindowData
from torch_geometric_tactile.data.static_dataset import StaticDataset

_LABELS = ("last", "trial", "ahead")
_logger = logging.getLogger(__name__)


class Windows(FrameView):
    r"""A data set whose samples are windows of :obj:`length` consecutive frames, one window every
    :obj:`hop` frames. No window spans two trials or a gap in time.

    The data set is a view: each access cuts windows from the frames, and a memory-mapped data set
    is not loaded. A window has :obj:`x` of shape :math:`(N, C \cdot T)`: each taxel has all frames
    of its first channel, then all frames of its second channel (see
    :func:`~torch_geometric_tactile.data.split_frames`). Its :obj:`num_frames` is :math:`T`. All
    other attributes are taken from the last frame, except :obj:`y` and the attributes in
    :obj:`series`. Attributes that all frames share are shared by all windows.

    The transform of :obj:`dataset` is applied to each frame when a window is cut.

    Args:
        dataset (StaticDataset): The frames, or a selection of them. Frames of a trial that follow
            each other in the selection are consecutive in a window, unless the selection leaves out
            more than five frames in a row between them.
        length (int): Number of frames in a window :math:`T`.
        hop (int): Number of frames from the start of one window to the start of the next.
        label (str): The frame that labels a window: its last frame (:obj:`"last"`), any frame of
            the trial if all have the same label (:obj:`"trial"`), or the frame :obj:`horizon`
            frames after the last one (:obj:`"ahead"`). Windows for which this frame lies beyond a
            gap or the end of the trial are left out and counted in :obj:`num_beyond`.
        horizon (int): Distance from the last frame of the window to the labelled frame, in frames.
            Must be at least 1 with :obj:`"ahead"`.
        target (str): Name of the attribute that is the label, such as :obj:`"annotation"` of a
            :class:`~torch_geometric_tactile.datasets.RecordingFrames` with that target.
        series (sequence of str): Names of attributes, such as :obj:`"joint"`, that a window keeps
            for all its frames :math:`(B, T, \ldots)`.
        max_gap (float, optional): The largest time in seconds between two frames of one window. A
            longer pause ends a window, like the end of a trial. The default is the duration of five
            frames at the rate of the recordings. Event data, whose frames are irregular, have no
            limit by default.
        transform (callable, optional): Applied to windows at every access.
        pre_transform (callable, optional): Applied once to all windows, in chunks. Its output is
            kept in memory.

    Raises:
        TypeError: If :obj:`dataset` is not a :class:`StaticDataset`.
        ValueError: If an argument is invalid, frames belong to no trial, the frames of a trial do
            not follow each other, their :obj:`time` does not increase (without :obj:`time`: they
            are selected in the wrong order), the recordings have several rates, the time between
            frames is irregular, or all trials are shorter than a window.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> x, trial = torch.rand(20, 6, 3), torch.arange(2).repeat_interleave(10)
        >>> frames = StaticDataset.from_arrays(x, trial, trial=trial, layout=grid(2, 3, 0.002))
        >>> windows = Windows(frames, length=4, hop=2)
        >>> windows, windows[0].x.shape, windows.y
        (Windows(8), torch.Size([6, 12]), tensor([0, 0, 0, 0, 1, 1, 1, 1]))
    """

    def __init__(
        self,
        dataset: StaticDataset,
        length: int,
        hop: int = 1,
        *,
        label: Literal["last", "trial", "ahead"] = "last",
        horizon: int = 0,
        target: str = "y",
        series: Sequence[str] = (),
        max_gap: float | None = None,
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
    ) -> None:
        need(label in _LABELS, f"'label' must be one of {list(_LABELS)} (got {label!r})")
        for name, number in (("length", length), ("hop", hop)):
            if number < 1:
                raise ArgumentError(Argument(name), f" must be at least 1 (got {number})")
        if (horizon < 1) if label == "ahead" else (horizon != 0):
            allowed = "at least 1" if label == "ahead" else "0"
            raise ArgumentError(
                Argument("horizon"), f" must be {allowed} with label='{label}' (got {horizon})"
            )
        need(max_gap is None or max_gap > 0, "'max_gap' must be positive, in seconds", max_gap)
        self.length = length
        self.max_gap = max_gap
        self.hop = hop
        self.label = label
        self.horizon = horizon
        #: The number of windows left out because their label is beyond the end of their trial.
        self.num_beyond = 0
        #: The number of gaps in time that end a window.
        self.num_gaps = 0
        super().__init__(dataset, target, series, transform, pre_transform)

    @property
    def overlap(self) -> bool:
        r"""Whether two windows of this selection share a frame."""
        stored = self._selected()
        if not isinstance(stored, WindowData):
            return self.hop < self.length
        starts = stored.starts.sort().values
        return bool((starts.diff() < self.length).any())

    def _window_arguments(self, runs: TrialRuns) -> dict[str, Any]:
        target = self._label_key(runs, constant=self.label == "trial")
        selected = selected_frames(self.dataset, self.dataset.info, self.max_gap)
        self._info, self.num_gaps = selected.info, int(selected.is_gap.sum())
        if self.num_gaps:
            _logger.info("%d gaps in time end windows", self.num_gaps)
            runs = runs.cut(selected.is_gap)
        self._record_short_trials(runs, self.length)
        # The number of windows in each trial, and the number of windows whose label is within the
        # trial. A start of -1 gives no window.
        last_start = (runs.length - self.length).clamp(min=-1)
        num_windows = torch.div(last_start, self.hop, rounding_mode="floor") + 1
        last_labelled = (last_start - self.horizon).clamp(min=-1)
        num_labelled = torch.div(last_labelled, self.hop, rounding_mode="floor") + 1
        self.num_beyond = int((num_windows - num_labelled).sum())
        if int(num_labelled.sum()) == 0:
            raise ArgumentError(
                Argument("horizon"),
                f" must be within the trial of at least one window (got {self.horizon} frames "
                f"after windows of {self.length} in trials of at most {int(runs.length.max())})",
            )
        if self.num_beyond:
            _logger.info(
                "%d windows are left out because their label is beyond their trial",
                self.num_beyond,
            )
        first = (num_labelled.cumsum(0) - num_labelled).repeat_interleave(num_labelled)
        step = torch.arange(int(num_labelled.sum())) - first
        return {
            "starts": runs.start.repeat_interleave(num_labelled) + self.hop * step,
            "length": self.length,
            "target": target,
            "horizon": self.horizon,
        }
