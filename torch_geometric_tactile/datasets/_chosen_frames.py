r"""Some of the frames of each trial."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor


def frames_at_rate(time: Tensor, trial: Tensor, rate: float) -> Tensor:
    r"""Tells which frames are the nearest ones in time to the ticks of a clock that starts with the
    first frame of each trial.

    Examples:
        >>> time = torch.tensor([0.0, 0.02, 0.04, 0.06, 0.08, 0.1])
        >>> frames_at_rate(time, torch.zeros(6, dtype=torch.long), 30.0).nonzero().view(-1)
        tensor([0, 2, 3, 5])

    Shapes:
        - **time:** Time of each frame in seconds, not falling in a trial :math:`(S,)`.
        - **trial:** Trial of each frame, those of one trial in a row :math:`(S,)`.
        - **output:** booleans :math:`(S,)`
    """
    kept = torch.zeros(len(time), dtype=torch.bool)
    for rows in _rows(trial):
        ticking = time[rows].double().numpy()
        # The last tick is that of the last frame, also where a number is a hair too small.
        count = int((ticking[-1] - ticking[0]) * rate + 1e-6) + 1
        ticks = ticking[0] + np.arange(count) / rate
        after = np.searchsorted(ticking, ticks).clip(1, max(len(ticking) - 1, 1))
        if len(ticking) > 1:
            is_before = ticks - ticking[after - 1] <= ticking[after] - ticks
            kept[rows.start + torch.from_numpy(after - is_before)] = True
        else:
            kept[rows] = True
    return kept


def drawn_frames(
    candidate: Tensor, trial: Tensor, names: Sequence[str], count: int, seed: int
) -> Tensor:
    r"""Tells which frames are drawn: so many of each trial, or all where there are fewer. What is
    drawn of a trial follows from the seed, its name and its own frames.

    Shapes:
        - **candidate:** Which frames may be drawn :math:`(S,)`.
        - **trial:** Trial of each frame, those of one trial in a row :math:`(S,)`.
        - **output:** booleans :math:`(S,)`
    """
    kept = torch.zeros(len(candidate), dtype=torch.bool)
    for rows in _rows(trial):
        found = rows.start + candidate[rows].nonzero().view(-1)
        rng = np.random.default_rng([seed, *names[int(trial[rows.start])].encode()])
        kept[found[torch.from_numpy(rng.permutation(len(found))[:count])]] = True
    return kept


def check_choice(rate: Any, samples_per_trial: Any, sample_seed: Any) -> None:
    r"""Checks the arguments of a data set that choose frames."""
    is_number = isinstance(rate, int | float) and not isinstance(rate, bool)
    if rate is not None and not (is_number and 0 < rate < float("inf")):
        raise ValueError(f"'rate' must be frames a second, above 0, or None (got {rate!r})")
    if samples_per_trial is not None and not _is_whole(samples_per_trial, 1):
        raise ValueError(
            f"'samples_per_trial' must be a whole number from 1 on, or None (got "
            f"{samples_per_trial!r})"
        )
    if not _is_whole(sample_seed, 0):
        raise ValueError(f"'sample_seed' must be a whole number from 0 on (got {sample_seed!r})")


def _is_whole(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _rows(trial: Tensor) -> list[slice]:
    _, counts = trial.unique_consecutive(return_counts=True)
    ends = counts.cumsum(0).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts.tolist(), strict=True)]
