r"""Data sources of experiments: a data set, its windows and its selection, as one value."""

import copy
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import file_sha256
from torch_geometric_tactile._texts import printable, read_json
from torch_geometric_tactile.data import Protocol, StaticData, StaticDataset
from torch_geometric_tactile.data._frame_view import FrameView, dataset_part, innermost
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet, as_samples
from torch_geometric_tactile.data._sample_units import TRIAL_PREFIX
from torch_geometric_tactile.data._shared_samples import sharing_ignored
from torch_geometric_tactile.data.protocol import Split
from torch_geometric_tactile.datasets._trial_frames import TrialFrames
from torch_geometric_tactile.experiments._building import (
    argument_names,
    build_object,
    check_arguments,
    find_class,
)
from torch_geometric_tactile.transforms import Tare

_SIMULATION = "simulation.json"
_LOCATION_ARGUMENTS = ("root", "path")  # identities contain a fingerprint of the files instead
_VIEW_ARGUMENT = "dataset"  # the argument of a view, such as Trials, that holds its frames
# Identities of stored runs contain these texts: if the texts change, stored runs are not found.
_TARED = "torch_geometric_tactile.experiments.compared_windows.tared_frames"
_STRIDED = "torch_geometric_tactile.experiments.compared_windows.strided_frames"
_MAX_CACHED_DATASETS = 4


@dataclass(frozen=True)
class DataSource:
    r"""A description of a data set and of selected samples, which any process can load.

    Two sources with the same :meth:`identity` have the same samples. The identity contains the
    fingerprint of the files, not their location.

    Args:
        class_path (str): Import path of a :class:`~torch_geometric_tactile.data.StaticDataset`, of
            a PyG data set (whose samples may come from different sensors), or of a function that
            returns such a data set.
        arguments (dict): Arguments of the class or function. Objects among them, such as
            transforms, are mappings with :obj:`class_path` and :obj:`init_args`.
        selection (dict): Further arguments that only select samples.
        kind (str): :obj:`"ours"`, :obj:`"simulated"` or :obj:`"measured"`; set by :meth:`resolve`
            if left out.
        caption (str): A sentence that describes the samples; set by :meth:`resolve` if left out.
        fingerprint (str): SHA-256 of the files or samples; set by :meth:`resolve`.
        frames (DataSource, optional): The frames from which a view, such as
            :class:`~torch_geometric_tactile.data.Trials`, is cut. An argument :obj:`dataset` with
            :obj:`class_path` and :obj:`init_args` is used as :obj:`frames`.
        stride (int, optional): Keeps every :obj:`stride`-th sample of each trial, for classes
            without this argument.
        tare (dict, optional): The argument :obj:`first` or :obj:`seconds` of
            :class:`~torch_geometric_tactile.transforms.Tare`. The reading at rest of each trial is
            then subtracted from its frames.
    """

    class_path: str
    arguments: dict[str, Any] = field(default_factory=dict)
    selection: dict[str, Any] = field(default_factory=dict)
    kind: str = ""
    caption: str = ""
    fingerprint: str = ""
    frames: "DataSource | None" = None
    stride: int | None = None
    tare: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        content = self.arguments.get(_VIEW_ARGUMENT)
        if isinstance(content, Mapping) and "class_path" in content:
            frames = DataSource(content["class_path"], dict(content.get("init_args") or {}))
            arguments = {k: v for k, v in self.arguments.items() if k != _VIEW_ARGUMENT}
            object.__setattr__(self, "frames", frames)
            object.__setattr__(self, "arguments", arguments)

    def __hash__(self) -> int:
        return hash((json.dumps(self.identity(), sort_keys=True), self.kind, self.caption))

    def with_arguments(
        self, arguments: Mapping[str, Any], selection: Mapping[str, Any] | None = None
    ) -> Self:
        r"""Returns the source with changed or additional arguments. If the class of a view does not
        have an argument, such as :obj:`root`, the argument is passed on to its frames.
        """
        if arguments:
            self = replace(self, fingerprint="")
        names = None if self.frames is None else argument_names(self.class_path)
        frame_arguments = {
            key: value for key, value in arguments.items() if names is not None and key not in names
        }
        view_arguments = {k: v for k, v in arguments.items() if k not in frame_arguments}
        if frame_arguments and self.frames is not None:
            self = replace(self, frames=self.frames.with_arguments(frame_arguments))
        return replace(
            self,
            arguments={**self.arguments, **view_arguments},
            selection={**self.selection, **(selection or {})},
        )

    @property
    def is_view(self) -> bool:
        r"""Whether the samples are windows or trials cut from frames."""
        constructor = find_class(self.class_path)
        return isinstance(constructor, type) and issubclass(constructor, FrameView)

    def resolve(self, protocol: Protocol | None = None) -> tuple[Self, "DataFacts"]:
        r"""Loads the data set and checks that a protocol can split it. Returns the source with its
        fingerprint, kind and caption, and the facts of the data set. Files are downloaded and
        processed here, before several processes read them.

        Args:
            protocol (Protocol, optional): The protocol to check.

        Raises:
            ValueError: If an argument is unknown, or a part of the first split is empty.
        """
        self._check_arguments()
        dataset = self.load() if self.fingerprint else self._build(self.arguments)
        source = replace(self, fingerprint=self.fingerprint or _fingerprint(dataset))
        source._cache(dataset)
        num_samples = int(source.is_selected(dataset).sum())
        facts = replace(DataFacts.from_dataset(dataset), num_samples=num_samples)
        if protocol is not None:
            facts = replace(facts, num_folds=protocol.num_folds(dataset))
            source.parts(protocol, seed=0, fold=0)
        synthetic = getattr(innermost(dataset), "synthetic", None)
        kind = self.kind or {None: "ours", True: "simulated", False: "measured"}[synthetic]
        caption = self.caption or _caption(dataset, kind, facts)
        return replace(source, kind=kind, caption=caption), facts

    def load(self) -> SampleSet:
        r"""Returns the data set without applying :obj:`selection`. Each process caches the last
        four data sets.
        """
        dataset = _DATASETS.get(self._cache_key)
        dataset = self._build(self.arguments) if dataset is None else dataset
        self._cache(dataset)
        return dataset

    def split(self, protocol: Protocol, seed: int = 0, fold: int = 0) -> Split:
        r"""Returns the indices of the selected samples in each part of a split."""
        dataset = self.load()
        with sharing_ignored():
            split = protocol.split(dataset, seed, fold)
        is_selected = self.is_selected(dataset)
        return Split(*(part[is_selected[part]] for part in split))

    def parts(self, protocol: Protocol, seed: int, fold: int) -> tuple[SampleSet, SampleSet]:
        r"""Returns the training samples and the test samples of a split."""
        dataset = self.load()
        train, _, test = self.split(protocol, seed, fold)
        for name, part in (("train", train), ("test", test)):
            if not len(part):
                raise ValueError(
                    f"'{protocol.describe()}' must leave samples to {name} on (left none of "
                    f"{len(dataset)}; selection: {self.selection or 'none'})"
                )
        return dataset[train], dataset[test]

    def samples(self) -> SampleSet:
        r"""Returns the selected samples."""
        dataset = self.load()
        return dataset[self.is_selected(dataset).nonzero().view(-1)]

    def is_selected(self, dataset: SampleSet) -> Tensor:
        r"""Returns a mask :math:`(S,)` of the selected samples of a data set."""
        if not self.selection:
            return torch.ones(len(dataset), dtype=torch.bool)
        is_stored = torch.zeros(dataset.len(), dtype=torch.bool)
        is_stored[_selected_indices(replace(self, kind="", caption=""))] = True
        return is_stored[torch.as_tensor(list(dataset.indices()))]

    def identity(self) -> dict[str, Any]:
        r"""Returns everything that determines the samples, as plain data. Captions and the location
        of files are not included.
        """
        content = self._to_plain()
        return {
            "class_path": content["class_path"],
            "arguments": content["init_args"],
            "selection": self.selection,
            "fingerprint": self.fingerprint,
        }

    def _to_plain(self) -> dict[str, Any]:
        arguments = {
            key: value for key, value in self.arguments.items() if key not in _LOCATION_ARGUMENTS
        }
        if self.frames is not None:
            arguments[_VIEW_ARGUMENT] = self.frames._to_plain()
        content: dict[str, Any] = {"class_path": self.class_path, "init_args": arguments}
        if self.stride is not None:
            steps = {_VIEW_ARGUMENT: content, "stride": self.stride}
            content = {"class_path": _STRIDED, "init_args": steps}
        if self.tare is not None:
            steps = {_VIEW_ARGUMENT: content, **self.tare}
            content = {"class_path": _TARED, "init_args": steps}
        return content

    @property
    def _cache_key(self) -> "DataSource":
        # Sources that differ only in their captions or selections share a loaded data set.
        return replace(self, selection={}, kind="", caption="")

    def _cache(self, dataset: SampleSet) -> None:
        key = self._cache_key
        _DATASETS.pop(key, None)  # so that the data set becomes the latest entry
        _DATASETS[key] = dataset
        for oldest in list(_DATASETS)[:-_MAX_CACHED_DATASETS]:
            del _DATASETS[oldest]

    def _check_arguments(self) -> None:
        check_arguments(self.class_path, {**self.arguments, **self.selection})
        if self.frames is not None:
            self.frames._check_arguments()

    def _build(self, arguments: Mapping[str, Any]) -> SampleSet:
        dataset = self._build_object(arguments)
        try:
            samples = as_samples(dataset)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"'class_path' must be a StaticDataset or a PyG data set (got "
                f"'{self.class_path}': {error})"
            ) from error
        if isinstance(samples, StaticData):
            raise ValueError(f"'class_path' must be a StaticDataset (got '{self.class_path}')")
        return samples

    def _build_object(self, arguments: Mapping[str, Any]) -> Any:
        arguments = dict(arguments)
        if self.frames is not None:
            arguments[_VIEW_ARGUMENT] = self.frames._build_object(self.frames.arguments)
        frames = arguments.get(_VIEW_ARGUMENT)
        need(
            not self.is_view or isinstance(frames, StaticDataset),
            "windows and trials can be cut only from a StaticDataset of frames with one layout",
            type(frames).__name__,
        )
        dataset = build_object({"class_path": self.class_path, "init_args": arguments})
        if self.stride is not None:
            dataset = _select_every(as_samples(dataset), self.stride)
        return dataset if self.tare is None else _tare_trials(dataset, **self.tare)


_DATASETS: dict[DataSource, SampleSet] = {}  # loaded by this process; the latest is last


def _select_every(samples: SampleSet, stride: int) -> SampleSet:
    # Returns every stride-th sample of each trial, starting with its first sample.
    trial = samples.column("trial")
    trial = torch.zeros(len(samples)) if trial is None else trial
    order = trial.argsort(stable=True)
    _, counts = trial[order].unique_consecutive(return_counts=True)
    number = torch.arange(len(order)) - (counts.cumsum(0) - counts).repeat_interleave(counts)
    return samples[order[number % stride == 0].sort().values]


def _tare_trials(
    frames: StaticDataset, first: int | None = None, seconds: float | None = None
) -> StaticDataset:
    r"""Returns a data set that subtracts the reading at rest of each trial from its frames. Other
    trials have no influence.

    Args:
        frames (StaticDataset): The frames.
        first (int, optional): As in :class:`~torch_geometric_tactile.transforms.Tare`.
        seconds (float, optional): As in :class:`~torch_geometric_tactile.transforms.Tare`.
    """
    tare = Tare("trial", first=first, seconds=seconds).fit(frames, frames.transform)
    tared = copy.copy(frames)
    tared.transform = tare if frames.transform is None else Compose([frames.transform, tare])
    return tared


@dataclass(frozen=True)
class DataFacts:
    r"""Numbers and names of the samples of a data source.

    Args:
        num_samples (int): Number of selected samples.
        num_trials (int): Number of trials; 0 without trials.
        num_groups (int): Number of groups; 0 without groups.
        num_classes (int): Number of classes; 0 if the target is a single number.
        class_names (tuple of str): Names of the classes.
        session_names (tuple of str): Names of the sessions.
        num_frames (int, optional): Number of frames per sample; :obj:`None` for single frames.
        num_folds (int): Number of folds of the protocol.
        part (str, optional): The part of the data set, such as :obj:`"train"`; :obj:`None` for all
            samples.
    """

    num_samples: int
    num_trials: int
    num_groups: int
    num_classes: int
    class_names: tuple[str, ...] = ()
    session_names: tuple[str, ...] = ()
    num_frames: int | None = None
    num_folds: int = 1
    part: str | None = None

    @classmethod
    def from_dataset(cls, dataset: SampleSet) -> Self:
        r"""Returns the facts of a data set with all samples selected."""
        counts = [_count_unique(dataset.column(key)) for key in ("trial", "group")]
        frames = None if isinstance(dataset, GraphSamples) else dataset.column("num_frames")
        return cls(
            num_samples=len(dataset),
            num_trials=counts[0],
            num_groups=counts[1],
            num_classes=0 if _is_scalar_target(dataset.column("y")) else dataset.num_classes,
            class_names=tuple(dataset.class_names),
            session_names=tuple(dataset.session_names),
            num_frames=None if frames is None else int(torch.as_tensor(frames).view(-1)[0]),
            part=dataset_part(dataset),
        )

    @property
    def part_note(self) -> str:
        r"""The part of the data set in words, for captions. Empty for all samples."""
        return "" if self.part is None else f" (the part '{self.part}' of the data set)"


@lru_cache(maxsize=16)
def _selected_indices(source: DataSource) -> Tensor:
    dataset = source._build({**source.arguments, **source.selection})
    return torch.as_tensor(list(dataset.indices()))


def _count_unique(column: Tensor | None) -> int:
    return 0 if column is None else len(column.unique())


def _is_scalar_target(y: Tensor | None) -> bool:
    return y is not None and y.dim() == 1 and y.is_floating_point()


def _caption(dataset: SampleSet, kind: str, facts: DataFacts) -> str:
    size = f"{facts.num_trials} trials" if facts.num_trials else f"{len(dataset):,} samples"
    if kind != "simulated":
        return f"Your own recordings: {size}."
    root = Path(innermost(dataset).root)
    summaries = [
        path for path in (root / _SIMULATION, root / "raw" / _SIMULATION) if path.is_file()
    ]
    if not summaries:
        return f"**Simulated**, not a result of a real sensor: {size}."
    try:
        simulation = read_json(summaries[0])
        settings = _simulation_settings(simulation)
        sensor = "array" if simulation.get("generator") == "letters" else "hand"
    except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"'{summaries[0]}' must be a summary of 'tactile simulate' ({error}): delete it, or "
            "run the command again"
        ) from error
    return (
        f"**Simulated**, not a result of a real {sensor}: {size} of `tactile simulate` "
        f"({printable(settings)})."
    )


def _simulation_settings(simulation: Mapping[str, Any]) -> str:
    if simulation.get("generator") == "letters":
        return f"letters on `{simulation['layout']}`, seed {simulation['seed']}"
    simulator = f"MuJoCo {simulation['mujoco']}"
    if "preset" in simulation:
        preset = simulation["preset"]
        return (
            f"objects `{simulation['object_set']}`, seed {simulation['seed']}, "
            f"{preset['duration']:g} s at {preset['rate']:g} Hz, {simulator}"
        )
    success_rates = (
        f"{name} {counts['grasps']}, of which {100 * counts['successes'] / counts['grasps']:.1f} % "
        "are successful"
        for name, counts in simulation["objects"].items()
    )
    return f"{'; '.join(success_rates)}; seed {simulation['seed']}, {simulator}"


def _fingerprint(dataset: SampleSet) -> str:
    digest = hashlib.sha256()
    if isinstance(dataset, GraphSamples):
        stored = dataset.stored()
        for i in range(len(stored)):
            attributes = stored[i].to_dict()
            _add_tensors(digest, attributes)
            plain = {k: v for k, v in attributes.items() if isinstance(v, str | int | float)}
            digest.update(f"{sorted(plain.items())!r}\n".encode())
        return digest.hexdigest()
    inner: StaticDataset = innermost(dataset)
    files = _data_files(inner)
    has_folders = isinstance(inner, TrialFrames) and "/" in inner.pattern  # which name trials
    for file in files:
        stat = file.stat()
        name = file.relative_to(inner.root) if has_folders else file.name
        digest.update(f"{name} {_sha256(file, stat.st_size, stat.st_mtime_ns)}\n".encode())
    if not files:
        _add_tensors(digest, inner.data.to_dict())
        units = {key: names for key, names in inner._names.items() if key.startswith(TRIAL_PREFIX)}
        digest.update(json.dumps(units, sort_keys=True).encode() if units else b"")
    return digest.hexdigest()


def _add_tensors(digest: Any, attributes: Mapping[str, Any]) -> None:
    for key, value in sorted(attributes.items()):
        if isinstance(value, Tensor):
            digest.update(f"{key} {value.dtype} {tuple(value.shape)}\n".encode())
            digest.update(value.contiguous().numpy(force=True).tobytes())


def _data_files(dataset: StaticDataset) -> list[Path]:
    # The raw files or, if they were deleted, the processed file. Data in memory has no files.
    if not dataset.has_process:
        return []
    raw_paths = [Path(name) for name in dataset.raw_paths]
    if isinstance(dataset, TrialFrames):
        raw_paths += dataset._tables()  # labels and metadata of the recordings
    existing_paths = [path for path in raw_paths if path.is_file()]
    return existing_paths or [Path(dataset.processed_paths[0])]


@lru_cache(maxsize=10_000)
def _sha256(path: Path, size: int, mtime_ns: int) -> str:
    return file_sha256(path)  # cached, because several sources may read the files of one folder
