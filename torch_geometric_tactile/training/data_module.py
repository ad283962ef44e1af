r"""The data module: training, validation and test parts of a data set."""

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import Dataset
from torch_geometric.data import Batch, Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import Protocol, Split, StaticData, StaticDataset
from torch_geometric_tactile.data._batches import check_same_names
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet, as_samples
from torch_geometric_tactile.data._sample_units import require_units
from torch_geometric_tactile.data._shared_samples import warn_of_shared
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.loader._random_states import preserve_random_states
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import FittedTransform, fit_parts
from torch_geometric_tactile.transforms.fitting import fitted_parts

# A configuration cannot contain a list of samples. With a single type at runtime, the messages of
# jsonargparse are shorter than with a union, for which it reports the failure of every member.
if TYPE_CHECKING:
    _AnyDataset = Dataset | Sequence[Data]
else:
    _AnyDataset = Dataset
_SPLITS = ("frame", "trial", "group")  # may be missing from the data if nothing is held out


class TactileDataModule(L.LightningDataModule):
    r"""Splits a data set, fits the scaling on its training part, and loads batches.

    If a data set has a published split, as
    :class:`~torch_geometric_tactile.datasets.AllegroUSkin` does, pass its parts separately:
    :obj:`dataset` with :obj:`split="train"`, :obj:`val_dataset` with :obj:`split="val"` and
    :obj:`test_dataset` with :obj:`split="test"`.

    Transforms are applied in this order: the transform of the data set, then :obj:`transform`, and
    in training batches finally :obj:`train_transform`. An augmentation therefore works on scaled
    readings, where zero is the mean of a taxel. It affects neither the fit of the scaling nor
    validation, test and prediction. The random numbers of an augmentation depend only on the epoch
    and the number of the batch, not on the number of workers (see
    :class:`~torch_geometric_tactile.loader.StaticLoader`).

    Samples from different sensors, which differ in their taxels and edges, are passed as a PyG data
    set, a :class:`~torch.utils.data.Subset`, a :class:`~torch.utils.data.ConcatDataset` or a list
    of :class:`~torch_geometric.data.Data`. They are loaded by
    :class:`torch_geometric.loader.DataLoader`, and transforms are applied to single samples. In
    this case, scaling must be :obj:`per="channel"`, models must accept :obj:`batch`, and
    :obj:`layout` is :obj:`None`.

    Checkpoints store the state of a fitted :obj:`transform`. A transform that is fitted to each
    session is also fitted, without labels, to sessions of validation, test and prediction samples
    that are missing from the training part.

    Args:
        dataset (StaticDataset, Dataset or list of Data): The training data.
        test_dataset (StaticDataset, Dataset or list of Data, optional): The data for test and
            prediction. Defaults to a part of :obj:`dataset`.
        split (str, Protocol or Split): How :obj:`dataset` is split. A text names the unit that is
            never divided between parts: :obj:`"trial"`, :obj:`"group"` (objects), :obj:`"frame"`
            (single frames) or another unit of :class:`~torch_geometric_tactile.data.Protocol`, such
            as :obj:`"person"`; the fractions :obj:`val` and :obj:`test` are then held out. A
            :class:`~torch_geometric_tactile.data.Protocol` has its own :obj:`val` and :obj:`test`.
            A :class:`~torch_geometric_tactile.data.Split` has the indices of the parts.
        val (float, optional): Fraction of :obj:`dataset` for validation. Defaults to 0.1, or to 0
            with a :obj:`val_dataset`.
        test (float): Fraction of :obj:`dataset` for the test.
        transform (BaseTransform, optional): Transform of every batch, which is applied after the
            transform of the data set. It is fitted on the training part if it needs fitting.
        train_transform (BaseTransform, optional): Transform of training batches only, such as an
            augmentation. It is applied after :obj:`transform` and never fitted.
        batch_size (int): Number of samples per batch.
        num_workers (int): Number of processes that load batches. Defaults to 0, because a batch is
            a single indexing operation on a tensor.
        seed (int): Seed of the random split.
        val_dataset (StaticDataset, Dataset or list of Data, optional): The validation data.
            Defaults to a part of :obj:`dataset`.
        fold (int): Index of the test fold, for a protocol with folds.

    Raises:
        TypeError: If a data set has an unsupported type.
        ValueError: If :obj:`split` is unknown; if a fraction of :obj:`dataset` is held out although
            :obj:`val_dataset` or :obj:`test_dataset` is given; if the data sets differ in layout,
            class names or, with scaling per session, session names; or if :obj:`train_transform`
            has parts that must be fitted.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> data = TactileDataModule(FakeTactileDataset(100), split="group", batch_size=16)
        >>> data.setup("fit")
        >>> next(iter(data.train_dataloader())).x.shape
        torch.Size([16, 24, 3])
    """

    def __init__(
        self,
        dataset: _AnyDataset,
        test_dataset: _AnyDataset | None = None,
        *,
        split: str | Protocol | Split = "trial",
        val: float | None = None,
        test: float = 0.0,
        transform: BaseTransform | None = None,
        train_transform: BaseTransform | None = None,
        batch_size: int = 128,
        num_workers: int = 0,
        seed: int = 0,
        val_dataset: _AnyDataset | None = None,
        fold: int = 0,
    ) -> None:
        super().__init__()
        samples = _to_samples(dataset, "dataset")
        held_out = {
            name: None if part is None else _to_samples(part, f"{name}_dataset", samples)
            for name, part in (("val", val_dataset), ("test", test_dataset))
        }
        if split is None:
            raise ValueError("'split' must be a unit, a Protocol or a Split (got None)")
        if isinstance(split, str) and split not in _SPLITS:
            require_units(samples, split, "split")
        scalers = [type(part).__name__ for part in fitted_parts(train_transform)]
        if scalers:
            raise ValueError(
                f"'train_transform' must not have fitted parts (got {', '.join(scalers)}); "
                "put them into 'transform'"
            )
        val = _val_fraction(split, val, test, held_out["val"], held_out["test"])
        keys = ("y", *(part.key or "" for part in fitted_parts(transform)))
        for name, fraction in (("val", val), ("test", test)):
            part = held_out[name]
            if part is None:
                continue
            if fraction > 0:
                raise ValueError(
                    f"'{name}' must be 0 if '{name}_dataset' is given (got {fraction})"
                )
            _check_same_layout(samples, part, name)
            check_same_names(samples, part, keys, f"'{name}_dataset'")
        self.dataset = samples
        self.val_dataset = held_out["val"]
        self.test_dataset = held_out["test"]
        self.split = split
        self.val = val
        self.test = test
        self.transform = copy.deepcopy(transform)  # fitting must not change the caller's transform
        self.train_transform = copy.deepcopy(train_transform)
        self.batch_size = batch_size
        self.num_workers = num_workers
        self.seed = seed
        self.fold = fold
        self._parts: dict[str, SampleSet] = {}

    @property
    def layout(self) -> TaxelLayout | None:
        r"""The layout of the sensor; :obj:`None` if samples may have different layouts."""
        return self.dataset.layout

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes or labels; empty if the data set has no names."""
        return self.dataset.class_names

    @property
    def num_classes(self) -> int:
        r"""The number of classes or labels. If the data set has names, the number of names."""
        return len(self.class_names) or self.dataset.num_classes

    @property
    def test_sessions(self) -> dict[int, str]:
        r"""The number and name of each recording session in the test part. Empty before
        :meth:`setup`, or if samples belong to no session.
        """
        part = self._parts.get("test")
        session = None if part is None else part.column("session")
        if part is None or session is None:
            return {}
        names = dict(enumerate(part.session_names))
        return {i: names.get(i, str(i)) for i in session.unique().tolist()}

    def part(self, name: Literal["train", "val", "test"]) -> SampleSet:
        r"""Returns a part of the data, without :obj:`transform` applied. It may be empty.

        Args:
            name (str): :obj:`"train"`, :obj:`"val"` or :obj:`"test"`.
        """
        self.setup()
        return self._parts[name]

    def example(self, count: int = 1) -> StaticData | Batch:
        r"""Returns samples of :obj:`dataset` as a batch, without applying fitted transforms. The
        shapes are the same as in training, but no fit is needed. Random number generators are not
        advanced.

        Args:
            count (int): Maximum number of samples, evenly spaced.
        """
        return self.peek(self.dataset, count, scaled=False)

    def peek(
        self, part: SampleSet, count: int | Tensor, *, scaled: bool = True
    ) -> StaticData | Batch:
        r"""Returns samples of a part as a batch, with all transforms except :obj:`train_transform`.
        Random number generators are not advanced.

        Args:
            part (StaticDataset or GraphSamples): A part, from :meth:`part`.
            count (int or torch.Tensor): Maximum number of samples, evenly spaced; or their indices.
            scaled (bool): If :obj:`False`, fitted transforms are not applied, and no fit is needed.
        """
        index = count if isinstance(count, Tensor) else _evenly_spaced(len(part), count)
        steps = [step for step in flat(self.transform) if scaled or not _is_fitted(step)]
        part = copy.copy(part)
        with preserve_random_states():
            # The transforms are copied, because a transform may have its own generator.
            part.transform = copy.deepcopy(Compose([*flat(part.transform), *steps]))
            return part.batch(index)

    def setup(self, stage: str | None = None) -> None:
        r"""Splits the data set and fits the scaling."""
        if self._parts:
            return
        parts = self._split()
        fit_parts(self.transform, parts["train"], before=parts["train"].transform)
        self._parts = parts
        self._fit_new_sessions()

    def _split(self) -> dict[str, SampleSet]:
        split = self.split
        if isinstance(split, str) and self.val == self.test == 0:  # trials or groups not needed
            empty = self.dataset[:0]
            parts: dict[str, SampleSet] = {"train": self.dataset, "val": empty, "test": empty}
        else:
            if isinstance(split, str):
                split = Protocol(split, val=self.val, test=self.test)
            if isinstance(split, Protocol):
                split = split.split(self.dataset, self.seed, self.fold)
            else:
                warn_of_shared(self.dataset, split, with_units=True)
            names = ("train", "val", "test")
            parts = {name: self.dataset[getattr(split, name)] for name in names}
        held_out = {"val": self.val_dataset, "test": self.test_dataset}
        return parts | {name: part for name, part in held_out.items() if part is not None}

    def _fit_new_sessions(self) -> None:
        for name in ("val", "test"):
            part = self._parts[name]
            if len(part):
                fit_parts(self.transform, part, adapt=True, before=part.transform)

    @classmethod
    def load_from_checkpoint(cls, *args: Any, **kwargs: Any) -> NoReturn:
        r"""Raises an error: a checkpoint contains no data, and Lightning's method may run code from
        the file.

        Raises:
            ValueError: Always.
        """
        raise ValueError(
            f"'{cls.__name__}' must be built from its data set, because checkpoints contain no "
            "data; trainer.test(module, datamodule=data, ckpt_path=path) restores fitted transforms"
        )

    def state_dict(self) -> dict[str, Any]:
        r"""Returns the states of the fitted transforms, for a checkpoint."""
        return {"transform": [part.state_dict() for part in fitted_parts(self.transform)]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        r"""Restores the states of the fitted transforms from a checkpoint.

        Args:
            state_dict (dict): Output of :meth:`state_dict`.
        """
        parts, states = fitted_parts(self.transform), state_dict["transform"]
        if len(parts) != len(states):
            raise ValueError(
                f"the checkpoint must have {len(parts)} fitted transforms, like 'transform' "
                f"(got {len(states)})"
            )
        for part, state in zip(parts, states, strict=True):
            part.load_state_dict(state)
        if self._parts:
            self._fit_new_sessions()

    def train_dataloader(self) -> StaticLoader | DataLoader:
        r"""Returns a loader of the training part with a new order in every epoch. A last batch with
        a single sample is dropped, because batch normalisation needs at least two samples.
        """
        return self._loader("train", self.train_transform, shuffle=True)

    def val_dataloader(self) -> StaticLoader | DataLoader | list[Any]:
        r"""Returns a loader of the validation part, or an empty list if there is none."""
        return self._loader("val") if len(self._parts["val"]) else []

    def test_dataloader(self) -> StaticLoader | DataLoader:
        r"""Returns a loader of the test part."""
        if not len(self._parts["test"]):
            raise ValueError("there is no test part: set 'test_dataset', or 'test' above 0")
        return self._loader("test")

    def predict_dataloader(self) -> StaticLoader | DataLoader:
        r"""Returns a loader of the test part for prediction."""
        return self.test_dataloader()

    def _loader(
        self, name: str, train_transform: BaseTransform | None = None, shuffle: bool = False
    ) -> StaticLoader | DataLoader:
        part = copy.copy(self._parts[name])
        steps = [
            step for step in (part.transform, self.transform, train_transform) if step is not None
        ]
        part.transform = Compose(steps) if steps else None
        leaves_single_sample = len(part) > self.batch_size > 1 and len(part) % self.batch_size == 1
        drop_last = shuffle and leaves_single_sample
        if isinstance(part, GraphSamples):
            return DataLoader(
                part,
                batch_size=self.batch_size,
                shuffle=shuffle,
                drop_last=drop_last,
                num_workers=self.num_workers,
                persistent_workers=self.num_workers > 0,
            )
        return StaticLoader(  # by keyword: Lightning rebuilds the loader with its own sampler
            part,
            batch_size=self.batch_size,
            shuffle=shuffle,
            drop_last=drop_last,
            keyed=True,
            num_workers=self.num_workers,
            persistent_workers=self.num_workers > 0,
        )


def _to_samples(dataset: Any, name: str, train_samples: SampleSet | None = None) -> SampleSet:
    if isinstance(dataset, StaticData):
        raise TypeError(
            f"'{name}' must be a data set (got StaticData): give "
            "StaticDataset.from_arrays(x, y, layout=...)"
        )
    try:
        samples = as_samples(dataset)
    except (TypeError, ValueError) as error:
        raise type(error)(str(error).replace("'dataset'", f"'{name}'")) from error
    assert not isinstance(samples, StaticData)
    if train_samples is not None and isinstance(samples, StaticDataset) != isinstance(
        train_samples, StaticDataset
    ):
        kind = "StaticDataset" if isinstance(train_samples, StaticDataset) else "PyG data set"
        raise TypeError(
            f"'{name}' must be a {kind}, like 'dataset' (got {type(dataset).__name__}): either all "
            "data sets must be StaticDatasets, or all must be PyG data sets"
        )
    return samples


def _check_same_layout(train_samples: SampleSet, samples: SampleSet, name: str) -> None:
    if not isinstance(train_samples, StaticDataset) or not isinstance(samples, StaticDataset):
        return
    if not train_samples.layout.matches(samples.layout):
        raise ValueError(
            f"'{name}_dataset' must have the layout '{train_samples.layout.name}' of 'dataset' "
            f"(got '{samples.layout.name}')"
        )


def _val_fraction(
    split: str | Protocol | Split,
    val: float | None,
    test: float,
    val_dataset: SampleSet | None,
    test_dataset: SampleSet | None,
) -> float:
    # The fraction of the data set that is held out for validation.
    if not isinstance(split, Protocol):
        if val is None:
            return 0.1 if val_dataset is None else 0.0
        return val
    for name, part in (("val", val), ("test", test)):
        if part:
            raise ValueError(f"'{name}' must be left out with a protocol (got {part})")
    if split.has_test and test_dataset is not None:
        raise ValueError(
            "'test_dataset' must be left out if the protocol holds out a test part "
            f"(got '{split.describe()}')"
        )
    return split.val or 0.0


def _evenly_spaced(size: int, count: int) -> Tensor:
    return torch.linspace(0, max(size - 1, 0), min(size, count)).long()


def _is_fitted(transform: BaseTransform) -> bool:
    return isinstance(transform, FittedTransform)
