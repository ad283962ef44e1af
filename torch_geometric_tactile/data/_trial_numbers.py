r"""One number for each trial, also where each session numbers its trials from zero."""

import logging
from typing import Any

import torch
from torch import Tensor

_logger = logging.getLogger(__name__)


def with_own_numbers(data: Any, names: dict[str, list[str]]) -> tuple[Any, dict[str, list[str]]]:
    r"""Returns samples in which no two trials have one number. A trial lies in one session; numbers
    that begin anew in each group, in parts of the samples that are apart, are those of other
    trials.
    """
    trial = _column(data, "trial")
    if trial is None or not len(trial):
        return data, names
    keys = [trial]
    session, group = _column(data, "session"), _column(data, "group")
    if session is not None:
        keys.append(session)
    if group is not None and _begins_anew(trial, group):
        keys.append(group)
    of_trial, number = torch.stack(keys, dim=1).unique(dim=0, return_inverse=True)
    if len(of_trial) == len(trial.unique()):
        return data, names
    _logger.info(
        "trial numbers begin anew in each %s: %d trials are numbered from 0 on",
        "group" if len(keys) == 3 or session is None else "session",
        len(of_trial),
    )
    data.trial = number.to(data["trial"].device)
    known = names.get("trial", [])
    if known:
        names = {**names, "trial": [known[i] for i in of_trial[:, 0].tolist()]}
    return data, names


def _column(data: Any, key: str) -> Tensor | None:
    value = data[key] if key in data else None  # noqa: SIM401 - Data is no mapping
    if not isinstance(value, Tensor) or value.dim() != 1 or value.is_floating_point():
        return None
    return value.long().cpu() if len(value) == data.num_samples else None


def _begins_anew(trial: Tensor, group: Tensor) -> bool:
    # Whether the samples of one trial number are in runs that are apart, of other groups.
    changes = (trial[1:] != trial[:-1]).nonzero().view(-1) + 1
    first = torch.cat([torch.zeros(1, dtype=torch.long), changes])
    number, of = trial[first], group[first]
    pairs = torch.stack([number, of], dim=1).unique(dim=0)
    return len(pairs) > len(number.unique())
