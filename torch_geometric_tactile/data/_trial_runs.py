r"""The start and the length of each trial of a data set."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile.data.static_dataset import StaticDataset


class TrialRuns(NamedTuple):
    r"""The trials of a data set, in the order of its samples, each a run of frames.

    Shapes:
        - **number:** The number of each trial :math:`(R,)`.
        - **start:** The first frame of each trial :math:`(R,)`.
        - **length:** The number of frames of each trial :math:`(R,)`.
    """

    number: Tensor
    start: Tensor
    length: Tensor
    names: Sequence[str] = ()

    @classmethod
    def from_dataset(cls, dataset: StaticDataset) -> "TrialRuns":
        r"""Checks the order of the frames of a data set and returns its trials.

        The frames of a trial must follow each other, in the order of their :obj:`time`. Without
        :obj:`time`, they must be in the order of the data set from which they are selected.

        Raises:
            ValueError: If the frames have no trials, or are in the wrong order.
        """
        trial = dataset.column("trial")
        if trial is None or trial.dim() != 1:
            raise ValueError(
                "'dataset' must have a 'trial' for each frame, since no window may span two "
                f"trials (got {'none' if trial is None else tuple(trial.shape)})"
            )
        number, length = trial.cpu().unique_consecutive(return_counts=True)
        runs = cls(number, length.cumsum(0) - length, length, dataset._names.get("trial", ()))
        runs._check_unbroken()
        time = dataset.column("time")
        if time is not None:
            runs._check_time(time.cpu())
        elif dataset._indices is not None:
            runs._check_rows(dataset._index())
        return runs

    def cut(self, is_gap: Any) -> "TrialRuns":
        r"""Divides the trials at gaps and returns their continuous parts as trials.

        Shapes:
            - **is_gap:** Whether there is a gap between each frame and the next one
              :math:`(S - 1,)`.
        """
        end = self.start + self.length
        part_starts = torch.as_tensor(is_gap).nonzero().view(-1) + 1
        start = torch.cat([self.start, part_starts]).sort().values
        trial_index = torch.searchsorted(self.start, start, right=True) - 1
        end = torch.cat([start[1:], end[-1:]])
        return TrialRuns(self.number[trial_index], start, end - start, self.names)

    def name(self, i: int) -> str:
        r"""Returns the number of a trial, and its name if it has one, as text for messages."""
        number = int(self.number[i])
        has_name = 0 <= number < len(self.names)
        return f"trial {number} ('{self.names[number]}')" if has_name else f"trial {number}"

    def require_constant(self, key: str, value: Tensor) -> None:
        r"""Checks that an attribute does not change within a trial.

        Args:
            key (str): Name of the attribute.
            value (torch.Tensor): Values of all frames :math:`(S, \ldots)`.

        Raises:
            ValueError: If it changes; the message names the first frame after a change.
        """
        before, after = value[:-1].cpu(), value[1:].cpu()
        is_equal = (before == after) | ((before != before) & (after != after))  # NaN equals NaN
        change = self._first_within(~is_equal.reshape(len(is_equal), -1).all(dim=1))
        if change is not None:
            i, frame = change
            row = int(self.start[i]) + frame
            raise ValueError(
                f"'{key}' must be the same in all frames of a trial to label the trial (got "
                f"{value[row - 1].tolist()} and then {value[row].tolist()} in frame {frame} of "
                f"{self.name(i)}); use label='last'"
            )

    def _check_unbroken(self) -> None:
        order = self.number.sort(stable=True)
        repeats = (order.values[1:] == order.values[:-1]).nonzero().view(-1)
        if len(repeats):
            first, second = (int(order.indices[int(repeats[0]) + k]) for k in (0, 1))
            end = int(self.start[first] + self.length[first])
            raise ValueError(
                f"the frames of a trial must follow each other in 'dataset' (got frames of "
                f"{self.name(first)} up to sample {end - 1}, and again from sample "
                f"{int(self.start[second])} on)"
            )

    def _check_time(self, time: Tensor) -> None:
        violation = self._first_within(~(time[1:] > time[:-1]))
        if violation is not None:
            i, frame = violation
            row = int(self.start[i]) + frame
            before, after = time[row - 1].item(), time[row].item()
            problem = "repeated" if before == after else "not increasing"
            raise ValueError(
                f"'time' must increase within a trial (got {before} s and then {after} s, "
                f"{problem}, in frame {frame} of {self.name(i)})"
            )

    def _check_rows(self, source_row: Tensor) -> None:
        violation = self._first_within(~(source_row[1:] > source_row[:-1]))
        if violation is not None:
            i, frame = violation
            row = int(self.start[i]) + frame
            raise ValueError(
                "frames without 'time' must be in the order of the data set from which they are "
                f"selected (got sample {int(source_row[row])} after sample "
                f"{int(source_row[row - 1])}, in frame {frame} of {self.name(i)}): sort the "
                "selection, and shuffle the windows instead"
            )

    def _first_within(self, is_violation: Tensor) -> tuple[int, int] | None:
        # Returns the trial of the first violation, and the frame within this trial. Each row of
        # `is_violation` compares a frame with the one before, so that the first frame has no row.
        # Comparisons between two trials are ignored.
        if len(self.start) > 1:
            is_violation[self.start[1:] - 1] = False
        rows = is_violation.nonzero().view(-1)
        if not len(rows):
            return None
        frame = int(rows[0]) + 1
        i = int(torch.searchsorted(self.start, frame, right=True)) - 1
        return i, frame - int(self.start[i])
