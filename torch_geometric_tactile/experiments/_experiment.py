r"""An experiment: one model that is trained and tested on one split of a data set."""

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
    r"""Selection of the settings of a model within the training part.

    Each setting is trained and scored on :obj:`repeats` cuts of the training part. The cuts are
    drawn with the protocol of the test. The first setting is the default. It is replaced by the
    best setting whose gain exceeds the standard error of the difference (the larger of the errors
    over cuts and over trials). A setting that is no better than the default is not trained on
    further cuts. The selected setting is then trained on the whole training part.

    Args:
        settings (sequence of Mapping): The settings. A setting is merged into the model; its
            :obj:`"transform"` and :obj:`"train_transform"` replace those of the experiment.
        metric (str): The score: :obj:`"accuracy"`, :obj:`"balanced_accuracy"` or :obj:`"mae"`.
        members (int): Number of networks that are trained and averaged.
        repeats (int): Number of cuts.
        most_samples (int): Largest number of samples to train on in a cut.
        num_validation_cuts (int): Number of cuts on which the selected setting is trained again, as
            for the test (with all :obj:`members` and all samples), and scored on the validation
            parts. Models are compared by these scores if they share a given test part.
        draft (Mapping): Arguments that are merged into the model while settings are compared, such
            as a smaller number of trees. The selected setting is trained without them.
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
    def is_regression(self) -> bool:
        r"""Whether :obj:`y` holds numbers, not classes."""
        return self.metric == "mae"

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values, as they are stored with a run."""
        settings = [dict(setting) for setting in self.settings]
        content = {**asdict(self), "settings": settings, "draft": dict(self.draft)}
        for name in (
            "num_validation_cuts",
            "draft",
        ):  # absent in older runs
            if not content[name]:
                del content[name]
        return content


@dataclass(frozen=True, eq=False)
class Experiment:
    r"""One model that is trained and tested on one split of a data set.

    Args:
        name (str): Name of the model.
        data (DataSource): The samples.
        protocol (Protocol): The splits.
        protocol_name (str): Name of the protocol in the table.
        model (dict): The section :obj:`model` of a configuration, or the :obj:`class_path` and
            :obj:`init_args` of an estimator.
        transform (dict, optional): Transform of all batches, as plain data.
        train_transform (dict, optional): Transform of training batches of a network.
        seed (int): Seed of the split and the training.
        fold (int): Index of the test fold.
        epochs (int): Epochs of a network.
        batch_size (int): Batch size of a network.
        trainer (dict): Further arguments of :class:`lightning.Trainer`.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Number of threads of torch.
        measure_memory (bool): If :obj:`True`, trains in a separate process to measure its peak
            memory.
        choice (Choice, optional): Selection of settings; :obj:`None` for a single setting.
        threshold (str, optional): Metric by which a decision threshold is selected on a validation
            part.
        studies (list of dict): Studies of the trained model, as plain data.
    """

    name: str
    data: DataSource
    protocol: Protocol
    protocol_name: str
    model: dict[str, Any]
    transform: dict[str, Any] | None = None
    train_transform: dict[str, Any] | None = None
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
        r"""Whether the model is a scikit-learn estimator."""
        return "class_path" in self.model

    def with_setting(self, setting: Mapping[str, Any]) -> Self:
        r"""Returns the experiment with a setting of its choice merged into the model."""
        overrides = dict(setting)
        transforms = {
            name: overrides.pop(name, getattr(self, name))
            for name in ("transform", "train_transform")
        }
        return replace(self, model=merged(self.model, overrides), **transforms)

    def identity(self) -> dict[str, Any]:
        r"""Returns everything that determines the result, as JSON values. Names, the number of
        threads and the location of the recordings do not count.
        """
        config = {"model": self.model, "transform": self.transform, "trainer": self.trainer}
        if self.train_transform is not None:
            config["train_transform"] = self.train_transform
        # Empty optional entries are left out, so that runs stored before they existed still match.
        options: dict[str, Any] = {} if self.choice is None else {"choice": self.choice.to_dict()}
        if self.threshold is not None:
            options["threshold"] = self.threshold
        if self.studies:
            options["studies"] = self.studies
        if self.sources.modules:
            options["sources"] = self.sources.modules
        return {
            **options,
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
        r"""The source code of the user's models, estimators, transforms, data sets and studies. It
        is read once; later edits have no effect.
        """
        return self.read_sources()

    def read_sources(self) -> UserSources:
        r"""Reads the current source code of the user's classes and functions."""
        content = [self.model, self.transform, self.train_transform, self.trainer, self.studies]
        content.append(self.data.identity())
        choice = None if self.choice is None else self.choice.to_dict()
        return user_sources(sorted({*_import_paths([*content, choice])}))

    @cached_property
    def code(self) -> str:
        r"""A hash of the identity with 12 hexadecimal digits."""
        return _sha256(self.identity())[:12]

    @property
    def label(self) -> str:
        r"""The name, protocol, seed and fold, for messages and file names."""
        fold = "" if self.protocol.folds is None and not self.fold else f", fold {self.fold}"
        return f"{self.name}, {self.protocol_name}, seed {self.seed}{fold}"

    @property
    def file_name(self) -> str:
        r"""The name of the file of the run."""
        readable = re.sub(r"[^\w.-]+", "-", self.label.replace(", ", "_").replace("seed ", "seed"))
        return f"{readable}_{self.code}.json"


class Fitted(NamedTuple):
    r"""Predictions of a trained model for its test part, with the cost of training.

    Args:
        score (ndarray): Class scores :math:`(S, C)` or :math:`(S,)`. In experiments with a choice,
            these are the predictions.
        prediction (ndarray): Predicted classes or numbers :math:`(S,)`, or labels :math:`(S, C)`.
        y (ndarray): The true values, of the same shape as :obj:`prediction`.
        num_parameters (int, optional): Number of weights of a network, or of fitted numbers of an
            estimator.
        seconds (float): Seconds of training.
        predict_seconds (float): Seconds of predicting the test part.
        task (str): The task.
        threshold (float, optional): The decision threshold.
        loss (float): Cross entropy on the test part. It decides between settings with equal scores.
        peak_memory_mb (float, optional): Peak memory of the training in megabytes.
        measures (str, optional): Name of the measured memory.
        label_names (list of str, optional): Names of the labels of a multi-label task.
        trained (Trained, optional): The model with its samples, for studies.
        is_graph (bool, optional): Whether a network reads edges.
    """

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
    is_graph: bool | None = None


def versions(model: Mapping[str, Any]) -> dict[str, str]:
    r"""Returns the versions of this package and of the libraries that determine a result."""
    libraries = ["scikit-learn"]  # also for networks, since it draws the folds
    path = model.get("class_path")
    if path is None:
        libraries.append("lightning")
    elif path == _MINIROCKET:
        libraries.append("sktime")
    return {
        "torch-geometric-tactile": __version__,
        "torch": torch.__version__,
        "torch-geometric": torch_geometric.__version__,
        **{name: _library_version(name) for name in libraries},
    }


def _library_version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:  # the package of a missing extra: the run raises an error
        return "none"


def _import_paths(content: Any) -> Iterator[str]:
    # Yields every text that contains a dot: it may be the import path of a class or function.
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
