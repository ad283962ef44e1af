r"""A data set whose samples are complete trials."""

from collections.abc import Sequence
from typing import Any, Literal

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._dataset_info import joined_info
from torch_geometric_tactile.data._frame_view import FrameView
from torch_geometric_tactile.data._trial_runs import TrialRuns
from torch_geometric_tactile.data.static_dataset import StaticDataset

_RAGGED = ("error", "pad", "crop_start", "crop_end")


class Trials(FrameView):
    r"""A data set whose samples are complete trials: each sample has all frames of one trial.

    The data set is a view with the same attributes as
    :class:`~torch_geometric_tactile.data.Windows`. The :obj:`target` must be the same in all frames
    of a trial.

    Args:
        dataset (StaticDataset): The frames, or a selection of them.
        ragged (str): The handling of trials with different numbers of frames:

            * :obj:`"error"` raises an error.
            * :obj:`"pad"` pads trials at their end with NaN (integers with their last value) and
              adds the attribute :obj:`valid_frames` :math:`(S,)`.
            * :obj:`"crop_end"` keeps the first :obj:`length` frames of each trial.
            * :obj:`"crop_start"` keeps the last :obj:`length` frames of each trial.
        length (int, optional): Number of frames in a sample :math:`T`. The default is the length of
            the longest trial with :obj:`"pad"`, and of the shortest trial otherwise.
        target (str): Name of the attribute that is the label.
        series (sequence of str): Names of attributes, such as :obj:`"joint"`, that a sample keeps
            for all its frames :math:`(B, T, \ldots)`.
        transform (callable, optional): Applied at every access.
        pre_transform (callable, optional): Applied once to all trials, in chunks. Its output is
            kept in memory.

    Raises:
        TypeError: If :obj:`dataset` is not a :class:`StaticDataset`.
        ValueError: If trials have different numbers of frames with ``ragged="error"``, an argument
            is invalid, frames belong to no trial, the frames of a trial do not follow each other,
            or their :obj:`time` does not increase (without :obj:`time`: they are selected in
            the wrong order).

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.sensors import grid
        >>> trial = torch.tensor([0, 0, 0, 1, 1])
        >>> frames = StaticDataset.from_arrays(
        ...     torch.rand(5, 6, 3), trial, trial=trial, layout=grid(2, 3, 0.002)
        ... )
        >>> trials = Trials(frames, ragged="pad")
        >>> trials, trials[1].x.shape, trials.valid_frames
        (Trials(2), torch.Size([6, 9]), tensor([3, 2]))
    """

    def __init__(
        self,
        dataset: StaticDataset,
        *,
        ragged: Literal["error", "pad", "crop_start", "crop_end"] = "error",
        length: int | None = None,
        target: str = "y",
        series: Sequence[str] = (),
        transform: Transform | None = None,
        pre_transform: Transform | None = None,
    ) -> None:
        need(ragged in _RAGGED, f"'ragged' must be one of {list(_RAGGED)} (got {ragged!r})")
        if length is not None and ragged == "error":
            raise ArgumentError(
                Argument("length"), f" must be left out with ragged='error' (got {length})"
            )
        need_argument(length is None or length >= 1, "length", "must be at least 1", length)
        self.ragged = ragged
        self.length = length
        #: The number of frames in a sample, before any transform.
        self.num_cut = 0
        super().__init__(dataset, target, series, transform, pre_transform)

    def _window_arguments(self, runs: TrialRuns) -> dict[str, Any]:
        self._info = joined_info(self.dataset)
        max_length, min_length = int(runs.length.max()), int(runs.length.min())
        if self.ragged == "error" and max_length != min_length:
            names = [runs.name(int(i)) for i in (runs.length.argmin(), runs.length.argmax())]
            raise ValueError(
                f"'ragged' must be 'pad', 'crop_start' or 'crop_end' if trials have different "
                f"numbers of frames (got {min_length} in {names[0]} and {max_length} in {names[1]})"
            )
        length = self.length or (max_length if self.ragged == "pad" else min_length)
        self.num_cut = length
        arguments = {"length": length, "target": self._label_key(runs, constant=True)}
        if self.ragged == "pad":
            if max_length > length:
                raise ArgumentError(
                    Argument("length"),
                    f" must be at least {max_length} with ragged='pad', the length of the longest "
                    f"trial, {runs.name(int(runs.length.argmax()))} (got {length})",
                )
            if not self.dataset._data["x"].is_floating_point():
                raise ValueError(
                    "'ragged' must not be 'pad' if 'x' holds integers, which have no NaN"
                )
            return {"starts": runs.start, "valid": runs.length, **arguments}
        self._record_short_trials(runs, length)
        is_long_enough = runs.length >= length
        starts = runs.start
        if self.ragged == "crop_start":
            starts = starts + runs.length - length
        return {"starts": starts[is_long_enough], **arguments}
