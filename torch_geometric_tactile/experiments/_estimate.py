r"""How long the runs of a comparison will take, measured on a short probe."""

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._held_out import Parts, choice_parts
from torch_geometric_tactile.experiments._run_experiment import fit
from torch_geometric_tactile.training._config_files import merged

_PROBE = 256  # samples
_EPOCHS = 3
_SQUARE = ("rbf_svm", "signal_svm")


def estimate_seconds(todo: Sequence[Experiment]) -> dict[str, float]:
    r"""Returns for how many seconds one process will be busy with the runs of each model, about:
    each model is trained on a few samples, and its time is extrapolated. The test parts are not
    read.
    """
    count = Counter(e.name for e in todo)
    threads = torch.get_num_threads()
    found: dict[str, float] = {}
    warm: set[bool] = set()
    for experiment in {e.name: e for e in reversed(todo)}.values():
        torch.set_num_threads(experiment.threads)
        try:
            if experiment.is_estimator not in warm:  # the first of a kind imports much
                warm.add(experiment.is_estimator)
                _of_run(experiment)
            found[experiment.name] = count[experiment.name] * _of_run(experiment)
        finally:
            torch.set_num_threads(threads)
    return found


def _of_run(experiment: Experiment) -> float:
    choice = experiment.choice
    assert choice is not None
    parts = choice_parts(experiment)
    model = merged(experiment.model, choice.settings[0])
    few = _some(parts.fit, _PROBE)
    tried = len(choice.settings) if len(choice.settings) > 1 else 0  # nothing to choose of one
    finals = 1 if experiment.is_estimator else choice.members
    trainings = tried * len(parts.fit) + finals * len(parts.train)
    try:
        if experiment.is_estimator:
            return _of_estimator(experiment, model, parts, few, trainings)
        probe = replace(experiment, epochs=_EPOCHS, choice=replace(choice, members=1))
        whole, steps = _seconds(probe, model, few, _some(parts.val, 8))
    except ValueError:  # the run tells
        return 0.0
    epochs = experiment.epochs * trainings / (_EPOCHS * len(few))
    return (whole - steps) * (tried + finals) + steps * epochs


def _of_estimator(
    experiment: Experiment,
    model: Mapping[str, object],
    parts: Parts,
    few: StaticDataset,
    trainings: int,
) -> float:
    assert experiment.choice is not None
    last = merged(experiment.model, experiment.choice.settings[-1])  # slower for some
    tried = [_seconds(experiment, m, few, _some(parts.val, 8))[0] for m in (model, last)]
    seconds = sum(tried) / len(tried)
    growth = len(parts.fit) / len(few)
    if str(model["class_path"]).endswith(_SQUARE):
        seconds *= growth
    return seconds / len(few) * trainings


def _seconds(
    experiment: Experiment,
    model: Mapping[str, object],
    train: StaticDataset,
    other: StaticDataset,
) -> tuple[float, float]:
    # In all, and in the steps alone.
    start = time.perf_counter()
    seconds = fit(experiment, model, train, other).seconds
    return time.perf_counter() - start, seconds


def _some(part: StaticDataset, count: int) -> StaticDataset:
    index = torch.linspace(0, len(part) - 1, min(count, len(part))).long()
    return part[index]
