r"""One experiment as a value: what is trained and tested, and what came of the training."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple, Self

import numpy as np
import torch
import torch_geometric

from torch_geometric_tactile import __version__
from torch_geometric_tactile._checks import need
from torch_geometric_tactile._sources import UserSources, user_sources
from torch_geometric_tactile._typing import ThresholdMetric
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.studies import Trained
from torch_geometric_tactile.training._collected_metrics import Task
from torch_geometric_tactile.training._config_files import merged

_METRICS = ("accuracy", "balanced_accuracy", "mae")
_MINIROCKET = "torch_geometric_tactile.baselines.minirocket"


@dataclass(frozen=True, eq=False)
class Choice:
    r"""How the settings of a model are chosen: they are trained and scored on :obj:`repeats` cuts
    of the training part, by the protocol of the test, each with at most :obj:`most_samples` samples
    to train on. The first setting, which is the default, stays unless another is better by more
    than the standard error of the difference (the larger of those over cuts and over trials); the
    best of these is trained on the whole training part. A setting that is not ahead of the default
    is tried on no further cut.

    With :obj:`num_validation_cuts`, the setting that is chosen, also a single one, is then trained
    as it will be for the test (all :obj:`members`, no limit of samples) on so many cuts, without
    their validation parts, and scored on these. Models are chosen by these scores where all are
    tested on one given part.

    A setting is merged into the model, but for its :obj:`"transform"` and
    :obj:`"train_transform"`, which take the place of the experiment's. While settings
    are compared, :obj:`draft` is merged into the model first, such as a smaller number of trees;
    the chosen setting is trained without it.
    """

    settings: Sequence[Mapping[str, Any]] = ({},)
    metric: str = "accuracy"
    members: int = 1
    repeats: int = 3
    most_samples: int = 2000
    num_validation_cuts: int = 0
    draft: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.metric not in _METRICS:
            raise ValueError(f"'metric' must be one of {list(_METRICS)} (got '{self.metric}')")
        need(self.settings, "'settings' must hold at least one setting (got none)")
        need(self.members >= 1, "'members' must be at least 1", self.members)
        need(self.repeats >= 1, "'repeats' must be at least 1", self.repeats)
        need(self.most_samples >= 1, "'most_samples' must be at least 1", self.most_samples)
        need(
            self.num_validation_cuts >= 0,
            "'num_validation_cuts' must be at least 0",
            self.num_validation_cuts,
        )

    @property
    def of_numbers(self) -> bool:
        r"""Whether :obj:`y` is numbers, not classes."""
        return self.metric == "mae"

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values."""
        settings = [dict(setting) for setting in self.settings]
        content = {**asdict(self), "settings": settings, "draft": dict(self.draft)}
        for name in ("num_validation_cuts", "draft"):  # runs stored before these stay valid
            if not content[name]:
                del content[name]
        return content


@dataclass(frozen=True, eq=False)
class Experiment:
    r"""What is trained and tested."""

    name: str
    data: DataSource
    protocol: Protocol
    protocol_name: str
    model: dict[str, Any]
    transform: dict[str, Any] | None = None
    train_transform: dict[str, Any] | None = None  # of training batches only; networks
    seed: int = 0
    fold: int = 0
    epochs: int = 0
    batch_size: int = 128
    trainer: dict[str, Any] = field(default_factory=dict)
    accelerator: str = "cpu"
    threads: int = 1
    measure_memory: bool = False
    choice: Choice | None = None
    threshold: ThresholdMetric | None = None
    studies: list[dict[str, Any]] = field(default_factory=list)

    @property
    def is_estimator(self) -> bool:
        r"""Whether the model is scikit-learn's."""
        return "class_path" in self.model

    def with_setting(self, setting: Mapping[str, Any]) -> Self:
        r"""Returns it with a setting of its choice."""
        over = dict(setting)
        transforms = {
            name: over.pop(name, getattr(self, name)) for name in ("transform", "train_transform")
        }
        return replace(self, model=merged(self.model, over), **transforms)

    def identity(self) -> dict[str, Any]:
        r"""Returns all that the result follows from. Two experiments of one configuration are one,
        whatever their names; threads and the place of the recordings do not count.
        """
        config = {"model": self.model, "transform": self.transform, "trainer": self.trainer}
        if self.train_transform is not None:
            config["train_transform"] = self.train_transform
        chosen: dict[str, Any] = {} if self.choice is None else {"choice": self.choice.to_dict()}
        if self.threshold is not None:
            chosen["threshold"] = self.threshold
        if self.studies:
            chosen["studies"] = self.studies
        if self.sources.modules:
            chosen["sources"] = self.sources.modules
        return {
            **chosen,
            "config": _sha256(config),
            "data": self.data.identity(),
            "protocol": self.protocol.to_dict(),
            "seed": self.seed,
            "fold": self.fold,
            "epochs": self.epochs,
            "batch_size": self.batch_size,
            "accelerator": self.accelerator,
            "measure_memory": self.measure_memory,
            "versions": {**self.sources.libraries, **versions(self.model)},
        }

    @cached_property
    def sources(self) -> UserSources:
        r"""The source code of the user's own models, estimators, transforms, data sets and studies,
        when it was first asked for.
        """
        return self.read_sources()

    def read_sources(self) -> UserSources:
        r"""Returns the source code of the user's own classes and functions as it is now."""
        content = [self.model, self.transform, self.train_transform, self.trainer, self.studies]
        content.append(self.data.identity())
        choice = None if self.choice is None else self.choice.to_dict()
        return user_sources(sorted({*_import_paths([*content, choice])}))

    @cached_property
    def code(self) -> str:
        r"""A short code of the identity."""
        return _sha256(self.identity())[:12]

    @property
    def label(self) -> str:
        r"""What a user reads: name, protocol, seed and fold."""
        fold = "" if self.protocol.folds is None and not self.fold else f", fold {self.fold}"
        return f"{self.name}, {self.protocol_name}, seed {self.seed}{fold}"

    @property
    def file_name(self) -> str:
        r"""The name of the file of its result."""
        readable = re.sub(r"[^\w.-]+", "-", self.label.replace(", ", "_").replace("seed ", "seed"))
        return f"{readable}_{self.code}.json"


class Fitted(NamedTuple):
    r"""What a trained model says of the samples that it is judged on, and what that took."""

    score: np.ndarray
    prediction: np.ndarray
    y: np.ndarray
    num_parameters: int | None
    seconds: float
    predict_seconds: float
    task: Task = "multiclass"
    threshold: float | None = None
    loss: float = 0.0
    peak_memory_mb: float | None = None
    measures: str | None = None
    label_names: list[str] | None = None
    trained: Trained | None = None
    is_graph: bool | None = None  # of a network: whether it reads edges


def versions(model: Mapping[str, Any]) -> dict[str, str]:
    r"""Returns the versions of this package and of the libraries that draw splits and train a
    model.
    """
    libraries = ["scikit-learn"]  # draws the folds as well
    path = model.get("class_path")
    if path is None:
        libraries.append("lightning")
    elif path == _MINIROCKET:
        libraries.append("sktime")
    return {
        "torch-geometric-tactile": __version__,
        "torch": torch.__version__,
        "torch-geometric": torch_geometric.__version__,
        **{name: _version(name) for name in libraries},
    }


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:  # an extra that is missing: the run tells
        return "none"


def _import_paths(content: Any) -> Iterator[str]:
    # Every text with a dot: a class, or a function that is given by its import path.
    if isinstance(content, Mapping):
        for value in content.values():
            yield from _import_paths(value)
    elif isinstance(content, list | tuple):
        for value in content:
            yield from _import_paths(value)
    elif isinstance(content, str) and "." in content:
        yield content


def _sha256(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
