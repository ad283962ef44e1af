r"""Describes the settings of a choice in words, for reports and terminals."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from torch_geometric_tactile.training._config_files import merged

DEFAULT = "the default"
# Descriptions of arguments whose names are not clear by themselves.
_ARGUMENT_TEMPLATES: dict[str, str] = {
    "C": "C = {}",
    "alpha": "alpha = {}",
    "width": "kernel width {}",
    "num_trees": "{} trees",
    "min_samples_leaf": "leaves of {} samples or more",
    "descriptor_channels": "descriptors in addition to the features ({} channels)",
    "max_taxels": "convolutions down to {} taxels",
    "head_taxels": "pooled to {} taxels or fewer before the head",
    "mixed_channels": "taxels mixed to {} channels",
    "lr": "learning rate {}",
    "pool": "the {} over the frames",
}
_VALUE_WORDS: dict[tuple[str, object], str] = {
    ("balanced", False): "descriptors and readings drawn in proportion to their number",
    ("balanced", True): "descriptors drawn as often as readings",
    ("with_readings", True): "with the readings",
    ("with_readings", False): "without the readings",
    ("conv", "self"): "a convolution without directions",
    ("fusion", "feature"): "a convolution for each channel",
    ("pool", "last"): "only the last frame",
    ("pool", "mean_max"): "the mean and the maximum over the frames",
    ("with_mean", True): "mean of the training part subtracted",
    ("with_mean", False): "zero remains the reading at rest",
}
_CLASS_WORDS = {
    "ZScore": "scaling",
    "SquareRoot": "square roots of the readings",
    "NormalizeRMS": "readings divided by their RMS",
    "RandomShift": "random shifts",
    "RandomMirror": "random mirror images",
    "RandomTimeShift": "random shifts in time",
}
_ABBREVIATIONS = ("RMS", "PCA", "SVM", "CNN", "GCN")
# Defaults of arguments that may be missing from one of two compared configurations.
_IMPLICIT_DEFAULTS = {"with_mean": True}
_TRANSFORMS = ("transform", "train_transform")
_CONTAINERS = ("model", "optimizer", "data", "trainer", "init_args")


def describe_setting(setting: Mapping[str, Any], transform: Mapping[str, Any] | None = None) -> str:
    r"""Returns a setting of a :class:`Choice` in words, with commas between its parts.

    Args:
        setting (Mapping): The setting, as it is merged into a model.
        transform (Mapping, optional): The transform of the experiment. If the setting has another
            transform, only the differences between the two are described.

    Examples:
        >>> describe_setting({})
        'the default'
        >>> describe_setting({"init_args": {"C": 10.0, "width": 0.3}})
        'C = 10, kernel width 0.3'
    """
    return ", ".join(_describe_parts(setting, transform)) or DEFAULT


def _describe_parts(
    setting: Mapping[str, Any], transform: Mapping[str, Any] | None
) -> Iterator[str]:
    for key, value in setting.items():
        if key in _TRANSFORMS:
            default = transform if key == "transform" else None
            yield from _changed_steps(value, default)
        elif key == "class_path":
            yield _class_words(value)
        elif key in _CONTAINERS and isinstance(value, Mapping):
            yield from _describe_parts(value, transform)
        else:
            yield _argument_words(key, value)


def _argument_words(name: str, value: object) -> str:
    if isinstance(value, str | bool) and (name, value) in _VALUE_WORDS:
        return _VALUE_WORDS[name, value]
    if isinstance(value, bool):
        return f"{'with' if value else 'without'} {_plain_words(name)}"
    words = _value_words(value)
    template = _ARGUMENT_TEMPLATES.get(name)
    return f"{_plain_words(name)} {words}" if template is None else template.format(words)


def _value_words(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str):
        return _class_words(value) if re.search(r"\w\.\w", value) else _plain_words(value)
    if isinstance(value, list | tuple):
        return " and ".join(map(_value_words, value)) or "none"
    if isinstance(value, Mapping):
        return _step_words(value) if "class_path" in value else describe_setting(value)
    return str(value)


def _plain_words(name: str) -> str:
    return re.sub(r"[\s_.{}\[\]'\"]+", " ", name).strip()


def _class_words(path: str) -> str:
    name = path.rpartition(".")[2]
    if name in _CLASS_WORDS:
        return _CLASS_WORDS[name]
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|_", " ", name)
    return " ".join(word if word in _ABBREVIATIONS else word.lower() for word in spaced.split())


def _step_words(step: Mapping[str, Any]) -> str:
    arguments = _describe_parts(step.get("init_args") or {}, None)
    inner = ", ".join(arguments)
    return _class_words(step["class_path"]) + (f" ({inner})" if inner else "")


def _changed_steps(
    transform: Mapping[str, Any] | None, default: Mapping[str, Any] | None
) -> Iterator[str]:
    # Describes steps that are missing from the default transform, changed arguments and removed
    # steps.
    steps, default_steps = _steps_by_class(transform), _steps_by_class(default)
    for path, step in steps.items():
        if path not in default_steps:
            yield _step_words(step)
            continue
        arguments = step.get("init_args") or {}
        default_arguments = default_steps[path].get("init_args") or {}
        implicit = {
            key: _IMPLICIT_DEFAULTS[key]
            for key in _IMPLICIT_DEFAULTS
            if key in {**arguments, **default_arguments}
        }
        arguments, default_arguments = (
            merged(implicit, arguments),
            merged(implicit, default_arguments),
        )
        for key in arguments:
            if arguments[key] != default_arguments.get(key):
                yield _argument_words(key, arguments[key])
    for path in default_steps:
        if path not in steps:
            yield f"without {_class_words(path)}"


def _steps_by_class(transform: Mapping[str, Any] | None) -> dict[str, Mapping[str, Any]]:
    # Returns the steps of a transform by the import path of their class.
    if transform is None:
        return {}
    steps = (transform.get("init_args") or {}).get("transforms")
    return {step["class_path"]: step for step in ([transform] if steps is None else steps)}
