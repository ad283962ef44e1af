r"""Renumbers trials whose numbers begin again in each session or group."""

import logging
from typing import Any

import torch
from torch import Tensor

_logger = logging.getLogger(__name__)


def with_unique_trials(data: Any, names: dict[str, list[str]]) -> tuple[Any, dict[str, list[str]]]:
    r"""Returns samples in which each trial has a unique number, and the names with those of the
    trials in the new order.

    Equal numbers in different sessions are different trials. Equal numbers in different groups are
    different trials if the samples of the groups are not in one run.
    """
    trial = _column(data, "trial")
    if trial is None or not len(trial):
        return data, names
    keys = [trial]
    session, group = _column(data, "session"), _column(data, "group")
    if session is not None:
        keys.append(session)
    if group is not None and _restarts_by_group(trial, group):
        keys.append(group)
    trial_keys, number = torch.stack(keys, dim=1).unique(dim=0, return_inverse=True)
    if len(trial_keys) == len(trial.unique()):
        return data, names
    _logger.info(
        "trial numbers begin again in each %s: %d trials are numbered from 0 on",
        "group" if len(keys) == 3 or session is None else "session",
        len(trial_keys),
    )
    data.trial = number.to(data["trial"].device)
    trial_names = names.get("trial", [])
    if trial_names:
        names = {**names, "trial": [trial_names[i] for i in trial_keys[:, 0].tolist()]}
    return data, names


def _column(data: Any, key: str) -> Tensor | None:
    value = data[key] if key in data else None  # noqa: SIM401 - Data is no mapping
    if not isinstance(value, Tensor) or value.dim() != 1 or value.is_floating_point():
        return None
    return value.long().cpu() if len(value) == data.num_samples else None


def _restarts_by_group(trial: Tensor, group: Tensor) -> bool:
    # Whether the samples of a trial number are in several runs that belong to different groups.
    changes = (trial[1:] != trial[:-1]).nonzero().view(-1) + 1
    first = torch.cat([torch.zeros(1, dtype=torch.long), changes])
    run_trial, run_group = trial[first], group[first]
    pairs = torch.stack([run_trial, run_group], dim=1).unique(dim=0)
    return len(pairs) > len(run_trial.unique())
