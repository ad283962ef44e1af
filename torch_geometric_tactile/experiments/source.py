r"""Where the samples of an experiment come from, as a value."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import file_sha256
from torch_geometric_tactile._texts import printable, read_json
from torch_geometric_tactile.data import Protocol, StaticData, StaticDataset
from torch_geometric_tactile.data._frame_view import FrameView, dataset_part, innermost
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet, as_samples
from torch_geometric_tactile.data._shared_samples import sharing_ignored
from torch_geometric_tactile.data.protocol import Split
from torch_geometric_tactile.experiments._building import (
    argument_names,
    build_object,
    check_arguments,
    find_class,
)

_SIMULATION = "simulation.json"
_PLACES = ("root", "path")  # of files, whose content is the fingerprint
_MOST = 4
_LOADED: dict[tuple[str, str, str], SampleSet] = {}  # the last few, the newest last
_INNER = "dataset"  # the argument of a view, such as Trials, that is the data set it shows


@dataclass(frozen=True)
class DataSource:
    r"""A :class:`~torch_geometric_tactile.data.StaticDataset`, ours or a user's, or samples of PyG
    that may have different sensors, by the import path of its class, or of a function that returns
    it, and arguments. That of a view, such as :class:`~torch_geometric_tactile.data.Trials`, has
    the data set that it shows as the argument :obj:`dataset`.
    """

    class_path: str
    arguments: dict[str, Any] = field(default_factory=dict)
    selection: dict[str, Any] = field(default_factory=dict)
    kind: str = ""
    caption: str = ""
    fingerprint: str = ""

    def with_arguments(
        self, arguments: Mapping[str, Any], selection: Mapping[str, Any] | None = None
    ) -> Self:
        r"""Returns the source with other or further arguments. Those that a view does not have,
        such as :obj:`root`, are given to the data set that it shows.
        """
        if arguments:
            self = replace(self, fingerprint="")
        return replace(
            self,
            arguments=_laid_over(self.class_path, self.arguments, arguments),
            selection={**self.selection, **(selection or {})},
        )

    def resolve(self, protocol: Protocol | None = None) -> tuple[Self, "DataFacts"]:
        r"""Loads the data set, which processes or downloads it if that was not done before, so that
        many processes can read it at once, and checks that a protocol can split it. Returns the
        source with its fingerprint, kind and caption, and what it holds.
        """
        check_arguments(self.class_path, {**self.arguments, **self.selection})
        dataset = self.load() if self.fingerprint else self._build(self.arguments)
        code = self.fingerprint or _fingerprint(dataset)
        source = replace(self, fingerprint=code)
        _keep(source._place, dataset)
        count = int(source.is_selected(dataset).sum())
        facts = replace(DataFacts.of(dataset), num_samples=count)
        if protocol is not None:
            facts = replace(facts, num_folds=protocol.num_folds(dataset))
            source.parts(protocol, seed=0, fold=0)
        synthetic = getattr(innermost(dataset), "synthetic", None)
        kind = self.kind or {None: "ours", True: "simulated", False: "measured"}[synthetic]
        caption = self.caption or _caption(dataset, kind, facts)
        return replace(source, kind=kind, caption=caption), facts

    def load(self) -> SampleSet:
        r"""Returns the data set, without :obj:`selection`. A process keeps the last few that it
        loaded.
        """
        dataset = _LOADED.get(self._place)
        dataset = self._build(self.arguments) if dataset is None else dataset
        _keep(self._place, dataset)
        return dataset

    @property
    def _place(self) -> tuple[str, str, str]:
        return self.class_path, json.dumps(self.arguments, sort_keys=True), self.fingerprint

    def split(self, protocol: Protocol, seed: int = 0, fold: int = 0) -> Split:
        r"""Returns the indices of the parts of a split, of the samples that are selected."""
        dataset = self.load()
        with sharing_ignored():
            split = protocol.split(dataset, seed, fold)
        is_selected = self.is_selected(dataset)
        return Split(*(part[is_selected[part]] for part in split))

    def parts(self, protocol: Protocol, seed: int, fold: int) -> tuple[SampleSet, SampleSet]:
        r"""Returns the samples to train on, and those to test on."""
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
        r"""Returns the samples that are selected."""
        dataset = self.load()
        return dataset[self.is_selected(dataset).nonzero().view(-1)]

    def _build(self, arguments: Mapping[str, Any]) -> SampleSet:
        kind = find_class(self.class_path)
        if isinstance(kind, type) and issubclass(kind, FrameView):
            arguments = {**arguments, _INNER: build_object(arguments.get(_INNER))}
            need(
                isinstance(arguments[_INNER], StaticDataset),
                "windows and trials are cut from a StaticDataset of frames, of one layout",
                type(arguments[_INNER]).__name__,
            )
        built = build_object({"class_path": self.class_path, "init_args": arguments})
        try:
            dataset = as_samples(built)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"'class_path' must be a StaticDataset, or a data set of PyG (got "
                f"'{self.class_path}': {error})"
            ) from error
        if isinstance(dataset, StaticData):
            raise ValueError(f"'class_path' must be a StaticDataset (got '{self.class_path}')")
        return dataset

    def is_selected(self, dataset: SampleSet) -> Tensor:
        r"""Returns which samples of the data set are in :obj:`selection` :math:`(S,)`."""
        if not self.selection:
            return torch.ones(len(dataset), dtype=torch.bool)
        chosen = _selected(*self._place, json.dumps(self.selection, sort_keys=True))
        is_chosen = torch.zeros(dataset.len(), dtype=torch.bool)
        is_chosen[chosen] = True
        return is_chosen[torch.as_tensor(list(dataset.indices()))]

    def identity(self) -> dict[str, Any]:
        r"""Returns all of it that a result follows from: not where the files lie, nor captions."""
        return {
            "class_path": self.class_path,
            "arguments": _without_places(self.arguments),
            "selection": self.selection,
            "fingerprint": self.fingerprint,
        }

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments of this class as plain data."""
        return asdict(self)


@dataclass(frozen=True)
class DataFacts:
    r"""What a data source holds."""

    num_samples: int
    num_trials: int
    num_groups: int
    num_classes: int
    class_names: tuple[str, ...] = ()
    session_names: tuple[str, ...] = ()
    num_frames: int | None = None
    num_folds: int = 1
    part: str | None = None  # of the data set that the samples are, such as "train"

    @classmethod
    def of(cls, dataset: SampleSet) -> Self:
        r"""Returns the facts of a data set."""
        counts = [_count(dataset.column(key)) for key in ("trial", "group")]
        frames = None if isinstance(dataset, GraphSamples) else dataset.column("num_frames")
        return cls(
            num_samples=len(dataset),
            num_trials=counts[0],
            num_groups=counts[1],
            num_classes=0 if _is_one_number(dataset.column("y")) else dataset.num_classes,
            class_names=tuple(dataset.class_names),
            session_names=tuple(dataset.session_names),
            num_frames=None if frames is None else int(torch.as_tensor(frames).view(-1)[0]),
            part=dataset_part(dataset),
        )

    @property
    def part_note(self) -> str:
        r"""The part of the data set that the samples are, in words for captions; empty for all."""
        return "" if self.part is None else f" (the part '{self.part}' of the data set)"


def _laid_over(
    class_path: str, arguments: Mapping[str, Any], over: Mapping[str, Any]
) -> dict[str, Any]:
    # What the class of a view does not know is an argument of the data set that it shows.
    inner = arguments.get(_INNER)
    if not over or not isinstance(inner, Mapping) or "class_path" not in inner:
        return {**arguments, **over}
    known = argument_names(class_path)
    mine = {key: value for key, value in over.items() if known is None or key in known}
    others = {key: value for key, value in over.items() if key not in mine}
    laid = {**arguments, **mine}
    if others:
        below = _laid_over(inner["class_path"], inner.get("init_args") or {}, others)
        laid[_INNER] = {**inner, "init_args": below}
    return laid


def _without_places(arguments: Mapping[str, Any]) -> dict[str, Any]:
    left = {key: value for key, value in arguments.items() if key not in _PLACES}
    inner = left.get(_INNER)
    if isinstance(inner, Mapping) and "class_path" in inner:
        left[_INNER] = {**inner, "init_args": _without_places(inner.get("init_args") or {})}
    return left


def _keep(key: tuple[str, str, str], dataset: SampleSet) -> None:
    _LOADED.pop(key, None)
    _LOADED[key] = dataset
    for old in list(_LOADED)[:-_MOST]:
        _LOADED.pop(old, None)


@lru_cache(maxsize=16)
def _selected(class_path: str, arguments: str, fingerprint: str, selection: str) -> Tensor:
    given = {**json.loads(arguments), **json.loads(selection)}
    return torch.as_tensor(list(DataSource(class_path)._build(given).indices()))


def _count(column: Tensor | None) -> int:
    return 0 if column is None else len(column.unique())


def _is_one_number(y: Tensor | None) -> bool:
    return y is not None and y.dim() == 1 and y.is_floating_point()


def _caption(dataset: SampleSet, kind: str, facts: DataFacts) -> str:
    held = f"{facts.num_trials} trials" if facts.num_trials else f"{len(dataset):,} samples"
    if kind != "simulated":
        return f"Recordings of your own: {held}."
    root = Path(innermost(dataset).root)
    found = [path for path in (root / _SIMULATION, root / "raw" / _SIMULATION) if path.is_file()]
    if not found:
        return f"**Simulated**, not a result of a real sensor: {held}."
    try:
        simulation = read_json(found[0])
        made = _made(simulation)
        sensor = "array" if simulation.get("generator") == "letters" else "hand"
        said = f"**Simulated**, not a result of a real {sensor}: {held}"
    except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"'{found[0]}' is not what 'tactile simulate' writes ({error}): delete it, or run the "
            "command again"
        ) from error
    return f"{said} of `tactile simulate` ({printable(made)})."


def _made(simulation: Mapping[str, Any]) -> str:
    if simulation.get("generator") == "letters":
        return f"letters on `{simulation['layout']}`, seed {simulation['seed']}"
    end = f"MuJoCo {simulation['mujoco']}"
    if "preset" in simulation:
        preset = simulation["preset"]
        return (
            f"objects `{simulation['object_set']}`, seed {simulation['seed']}, "
            f"{preset['duration']:g} s at {preset['rate']:g} Hz, {end}"
        )
    rates = (
        f"{name} {counts['grasps']}, of which {100 * counts['successes'] / counts['grasps']:.1f} % "
        "are a success"
        for name, counts in simulation["objects"].items()
    )
    return f"{'; '.join(rates)}; seed {simulation['seed']}, {end}"


def _fingerprint(dataset: SampleSet) -> str:
    code = hashlib.sha256()
    if isinstance(dataset, GraphSamples):
        stored = dataset.stored()
        for i in range(len(stored)):
            attributes = stored[i].to_dict()
            _add_tensors(code, attributes)
            plain = {k: v for k, v in attributes.items() if isinstance(v, str | int | float)}
            code.update(f"{sorted(plain.items())!r}\n".encode())
        return code.hexdigest()
    inner: StaticDataset = innermost(dataset)
    files = _files(inner)
    for file in files:
        stat = file.stat()
        code.update(f"{file.name} {_sha256(file, stat.st_size, stat.st_mtime_ns)}\n".encode())
    if not files:
        _add_tensors(code, inner.data.to_dict())
    return code.hexdigest()


def _add_tensors(code: Any, attributes: Mapping[str, Any]) -> None:
    for key, value in sorted(attributes.items()):
        if isinstance(value, Tensor):
            code.update(f"{key} {value.dtype} {tuple(value.shape)}\n".encode())
            code.update(value.contiguous().numpy(force=True).tobytes())


def _files(dataset: StaticDataset) -> list[Path]:
    # The raw files; if they are gone, what was made of them; none of what lives in memory.
    if not dataset.has_process:
        return []
    raw = [Path(name) for name in dataset.raw_paths]
    found = [path for path in raw if path.is_file()]
    return found or [Path(dataset.processed_paths[0])]


@lru_cache(maxsize=10_000)
def _sha256(path: Path, size: int, changed: int) -> str:
    return file_sha256(path)  # sources of one folder share its files
