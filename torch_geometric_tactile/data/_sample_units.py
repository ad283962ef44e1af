r"""Units of samples, such as trials or people: attributes of samples, and metadata of trials."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._texts import short_list
from torch_geometric_tactile.data._frame_view import innermost
from torch_geometric_tactile.data._graph_samples import (
    AnySamples,
    GraphSamples,
    as_samples,
    sample_column,
)
from torch_geometric_tactile.data._label_names import number_labels
from torch_geometric_tactile.data._levels import KNOWN_ATTRIBUTES, NAMED
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset

#: The prefix of keys under which the metadata of trials are stored, as lists of names in the order
#: of the trials.
TRIAL_PREFIX = "trial."
_MAX_LISTED = 3  # trials in a message
# Attributes with a number for each sample that are not units.
_NO_UNITS = ("y", "phase", "part", "num_nodes")


def trial_units(
    metadata: Sequence[Mapping[str, Any]], attributes: Iterable[str]
) -> dict[str, list[str]]:
    r"""Returns the texts and integers in the metadata of trials by name, as lists with an entry for
    each trial. The entry is empty if a trial lacks the name.

    Args:
        metadata (sequence of Mapping): The metadata of each trial.
        attributes (iterable of str): Names of attributes of the samples, which are left out.

    Examples:
        >>> trial_units([{"person": "Ann", "rate": 9.5}, {"person": "ann "}, {}], ["trial"])
        {'trial.person': ['Ann', 'Ann', '']}
    """
    units: dict[str, list[str]] = {}
    excluded = {*attributes, *KNOWN_ATTRIBUTES, "label"} - ({"group", "session"} - {*attributes})
    for key in dict.fromkeys(key for meta in metadata for key in meta):
        if key in excluded:
            continue
        values = [meta.get(key) for meta in metadata]
        is_name = [isinstance(v, str | int) and not isinstance(v, bool) for v in values]
        if any(is_name):
            names, codes = number_labels([v for v, ok in zip(values, is_name, strict=True) if ok])
            code = iter(codes.tolist())
            units[TRIAL_PREFIX + key] = [names[next(code)] if ok else "" for ok in is_name]
    return units


def unit_column(dataset: AnySamples, key: str) -> Tensor | None:
    r"""Returns an attribute of the samples, or numbers for the names in the metadata of their
    trials; :obj:`None` if the samples have neither, or a trial lacks the name.

    Shapes:
        - **output:** :math:`(S, \ldots)`
    """
    column = sample_column(dataset, key)
    values = _trial_values(dataset, key)
    trial = None if values is None else sample_column(dataset, "trial")
    if column is not None or values is None or trial is None:
        return column
    names, codes = np.unique(values, return_inverse=True)
    numbers = torch.from_numpy(codes)[trial.cpu().long()]
    has_all = "" not in values or not (numbers == names.tolist().index("")).any()
    return numbers if has_all else None


def require_units(dataset: AnySamples, key: str, argument: str = "by") -> Tensor:
    r"""Returns the unit of each sample.

    Args:
        dataset (Dataset or StaticData): The samples.
        key (str): Name of the units.
        argument (str): The argument that has this name, for the message.

    Shapes:
        - **output:** :math:`(S,)`

    Raises:
        ArgumentError: If there is no integer or name for each sample. The message lists the units
            that the samples have.
    """
    column = unit_column(dataset, key)
    if column is None or key in _NO_UNITS or not _are_units(column):
        raise missing_unit(dataset, key, argument)
    return column


def unit_names(dataset: AnySamples, key: str) -> list[str]:
    r"""Returns the names of the numbers of :func:`unit_column`. The list is empty if there are no
    names.
    """
    samples = as_samples(dataset)
    if isinstance(samples, StaticData):
        return []
    if isinstance(samples, GraphSamples):
        return samples.names(NAMED.get(key, key))
    if key == "y":  # a data set may store these names elsewhere
        return samples.class_names
    values = _trial_values(samples, key)
    if sample_column(samples, key) is None and values is not None:
        return sorted({*values})
    return list(samples._names.get(NAMED.get(key, key), ()))


def list_units(dataset: AnySamples) -> list[str]:
    r"""Returns the names by which samples can be split: attributes with an integer for each sample,
    and metadata that each trial has. Each has at least two different values.
    """
    samples = as_samples(dataset)
    keys: Iterable[str]
    if isinstance(samples, GraphSamples):
        keys = samples.complete_columns()
    else:
        source = innermost(samples)
        data = source if isinstance(source, StaticData) else source._data
        is_sample = {key: data.level(key) == "sample" for key in data.to_dict()}
        keys = [key for key, is_one in is_sample.items() if is_one and not data.is_shared(key)]
        prefixed = [key for key in _names(samples) if key.startswith(TRIAL_PREFIX)]
        keys += [key.removeprefix(TRIAL_PREFIX) for key in prefixed]
    return [key for key in keys if key not in _NO_UNITS and _has_units(samples, key)]


def _has_units(samples: AnySamples, key: str) -> bool:
    column = unit_column(samples, key)
    return column is not None and _are_units(column) and len(column.unique()) > 1


def _are_units(column: Tensor) -> bool:
    is_whole = not column.is_floating_point() or column.equal(column.round())
    return column.dim() == 1 and is_whole


def missing_unit(dataset: AnySamples, key: str, argument: str = "by") -> ArgumentError:
    r"""Returns the error for samples that cannot be split by a name. The message lists the names by
    which they can be split.

    Args:
        dataset (Dataset or StaticData): The samples.
        key (str): The name.
        argument (str): The argument that has the name.
    """
    values = _trial_values(dataset, key)
    units = ", ".join(f"'{name}'" for name in list_units(dataset)) or "none"
    text = f" must be a unit that all samples have: {units}"
    if values is not None:
        trial_names = _names(dataset).get("trial", [])
        trials = [name for name, value in zip(trial_names, values, strict=False) if not value]
        listed = short_list([f"'{name}'" for name in trials], _MAX_LISTED)
        return ArgumentError(
            Argument(argument),
            f"{text} (got '{key}', which {len(trials)} of {len(values)} trials lack: {listed}); "
            f"correct the names of these files, or add '{key}' in labels.csv",
        )
    advice: tuple[Any, ...] = (f": add an array or attribute '{key}'",)
    if hasattr(innermost(dataset), "pattern") and hasattr(innermost(dataset), "named_units"):
        example = f"'{{{key}}}_{{object}}_{{trial}}'"
        advice = (
            ": name it in the ",
            Argument("pattern"),
            f" of the file names, such as {example}, or add a column '{key}' to labels.csv",
        )
    return ArgumentError(Argument(argument), f"{text} (got '{key}')", *advice)


def _names(dataset: AnySamples) -> dict[str, list[str]]:
    samples = as_samples(dataset)
    return samples._names if isinstance(samples, StaticDataset) else {}


def _trial_values(dataset: AnySamples, key: str) -> list[str] | None:
    return _names(dataset).get(TRIAL_PREFIX + key)
