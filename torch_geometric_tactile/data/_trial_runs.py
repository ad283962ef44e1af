r"""Where each trial of a data set begins and ends."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile.data.static_dataset import StaticDataset


class TrialRuns(NamedTuple):
    r"""The trials of a data set, in the order of its samples.

    Shapes:
        - **number:** The number of each trial :math:`(R,)`.
        - **start:** The first frame of each :math:`(R,)`.
        - **length:** The number of frames of each :math:`(R,)`.
    """

    number: Tensor
    start: Tensor
    length: Tensor
    names: Sequence[str] = ()

    @classmethod
    def of(cls, dataset: StaticDataset) -> "TrialRuns":
        r"""Returns the trials of a data set, after its frames were checked: those of a trial
        follow each other, in the order of their :obj:`time` or, without one, in that of the data
        set that they are chosen from.
        """
        trial = dataset.column("trial")
        if trial is None or trial.dim() != 1:
            raise ValueError(
                "'dataset' must have a 'trial' for each frame, since no window may lie in two "
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
        r"""Returns the continuous parts of the trials, each as a trial of its own.

        Shapes:
            - **is_gap:** Whether something is missing after each frame but the last
              :math:`(S - 1,)`.
        """
        end = self.start + self.length
        gaps = torch.as_tensor(is_gap).nonzero().view(-1) + 1
        start = torch.cat([self.start, gaps]).sort().values
        of = torch.searchsorted(self.start, start, right=True) - 1
        end = torch.cat([start[1:], end[-1:]])
        return TrialRuns(self.number[of], start, end - start, self.names)

    def name(self, i: int) -> str:
        r"""Returns a text that names a trial."""
        number = int(self.number[i])
        known = 0 <= number < len(self.names)
        return f"trial {number} ('{self.names[number]}')" if known else f"trial {number}"

    def require_constant(self, key: str, value: Tensor) -> None:
        r"""Checks that an attribute does not change within a trial.

        Shapes:
            - **value:** Its values :math:`(S, \ldots)`.
        """
        before, after = value[:-1].cpu(), value[1:].cpu()
        same = (before == after) | ((before != before) & (after != after))  # NaN equals NaN here
        changed = self._first(~same.reshape(len(same), -1).all(dim=1))
        if changed is not None:
            i, frame = changed
            at = int(self.start[i]) + frame
            raise ValueError(
                f"'{key}' must be the same in all frames of a trial to label the trial (got "
                f"{value[at - 1].tolist()} and then {value[at].tolist()} in frame {frame} of "
                f"{self.name(i)}); use label='last'"
            )

    def _check_unbroken(self) -> None:
        order = self.number.sort(stable=True)
        again = (order.values[1:] == order.values[:-1]).nonzero().view(-1)
        if len(again):
            first, second = (int(order.indices[int(again[0]) + k]) for k in (0, 1))
            end = int(self.start[first] + self.length[first])
            raise ValueError(
                f"the frames of a trial must follow each other in 'dataset' (got those of "
                f"{self.name(first)} up to sample {end - 1}, and further ones from sample "
                f"{int(self.start[second])} on)"
            )

    def _check_time(self, time: Tensor) -> None:
        found = self._first(~(time[1:] > time[:-1]))
        if found is not None:
            i, frame = found
            at = int(self.start[i]) + frame
            before, after = time[at - 1].item(), time[at].item()
            what = "repeated" if before == after else "not increasing"
            raise ValueError(
                f"'time' must increase within a trial (got {before} s and then {after} s, "
                f"{what}, in frame {frame} of {self.name(i)})"
            )

    def _check_rows(self, row: Tensor) -> None:
        found = self._first(~(row[1:] > row[:-1]))
        if found is not None:
            i, frame = found
            at = int(self.start[i]) + frame
            raise ValueError(
                "the frames of a trial must be in the order of the data set they are chosen from "
                f"where they have no 'time' (got sample {int(row[at])} of it after sample "
                f"{int(row[at - 1])}, in frame {frame} of {self.name(i)}): sort the selection, and "
                "shuffle the windows instead"
            )

    def _first(self, wrong: Tensor) -> tuple[int, int] | None:
        # `wrong` tells of each frame but the first; between two trials anything is right.
        if len(self.start) > 1:
            wrong[self.start[1:] - 1] = False
        at = wrong.nonzero().view(-1)
        if not len(at):
            return None
        frame = int(at[0]) + 1
        i = int(torch.searchsorted(self.start, frame, right=True)) - 1
        return i, frame - int(self.start[i])
