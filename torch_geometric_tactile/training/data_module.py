r"""The parts of a data set that training, validation and test see."""

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
from torch_geometric_tactile.data._shared_samples import warn_of_shared
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.loader._random_states import kept_rng
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import FittedTransform, fit_parts, fitted_parts

# For a configuration, which holds no list, one kind: its parser tells of a union all that does not
# fit any member of it.
if TYPE_CHECKING:
    _AnyDataset = Dataset | Sequence[Data]
else:
    _AnyDataset = Dataset
_SPLITS = ("frame", "trial", "group")


class TactileDataModule(L.LightningDataModule):
    r"""Splits a data set, fits the scaling on its training part, and loads batches.

    A data set that splits itself, as :class:`~torch_geometric_tactile.datasets.AllegroUSkin`, is
    given in its parts: :obj:`dataset` with :obj:`split="train"`, :obj:`val_dataset` with
    :obj:`split="val"` and :obj:`test_dataset` with :obj:`split="test"`.

    Samples pass the transform of their data set, then :obj:`transform`, and in training batches
    :obj:`train_transform` last. An augmentation so works on scaled readings, where zero is the mean
    of a taxel, and changes neither what the scaling measures nor validation, test and prediction.
    What a random one draws follows from the epoch and the number of the batch alone (see
    :class:`~torch_geometric_tactile.loader.StaticLoader`), however many workers there are.

    Samples of different sensors, with taxels and edges of their own, are given as PyG has them: a
    data set, a :class:`~torch.utils.data.Subset`, a :class:`~torch.utils.data.ConcatDataset` or a
    list of :class:`~torch_geometric.data.Data`. They are loaded by
    :class:`torch_geometric.loader.DataLoader`, transforms run sample by sample, scaling must be
    :obj:`per="channel"`, and models take :obj:`batch`. There is no :obj:`layout` then.

    The state of a fitted :obj:`transform` is stored in checkpoints. For validation, test and
    prediction samples, a transform that works session by session measures the sessions that the
    training part did not have, without labels.

    Args:
        dataset (StaticDataset, Dataset or list of Data): What to train on.
        test_dataset (StaticDataset, Dataset or list of Data, optional): What to test and predict
            on; if left out, a part of :obj:`dataset`.
        split (str, Protocol or Split): What is never torn apart: :obj:`"trial"`, :obj:`"group"`
            (objects), or :obj:`"frame"` (nothing), held out in the parts :obj:`val` and
            :obj:`test`; or a :class:`~torch_geometric_tactile.data.Protocol`, with :obj:`val` and
            :obj:`test` of its own; or the indices themselves.
        val (float, optional): The part of :obj:`dataset` for validation: a tenth if left out, and
            nothing with a :obj:`val_dataset`.
        test (float): The part of :obj:`dataset` for the test.
        transform (BaseTransform, optional): Applied to every batch, after the transform of the data
            set; fitted on the training part where it can be.
        train_transform (BaseTransform, optional): Applied to training batches only, after
            :obj:`transform`, such as an augmentation; never fitted.
        batch_size (int): Number of samples of a batch.
        num_workers (int): Number of processes that load batches; none by default, since a batch is
            one piece of a tensor.
        seed (int): Which of the random splits.
        val_dataset (StaticDataset, Dataset or list of Data, optional): What to validate on; if left
            out, a part of :obj:`dataset`.
        fold (int): Which fold of a protocol with folds is tested on.

    Raises:
        TypeError: If a data set is of another kind.
        ValueError: If :obj:`split` is unknown, a part of :obj:`dataset` is asked for although
            :obj:`val_dataset` or :obj:`test_dataset` is given, the data sets have different
            layouts or names of classes (or of sessions, where these are scaled apart), or
            :obj:`train_transform` has parts that must be fitted.

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
        split: Literal["frame", "trial", "group"] | Protocol | Split = "trial",
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
        samples = _samples(dataset, "dataset")
        held_out = {
            name: None if one is None else _samples(one, f"{name}_dataset", samples)
            for name, one in (("val", val_dataset), ("test", test_dataset))
        }
        if split is None or (isinstance(split, str) and split not in _SPLITS):
            raise ValueError(f"'split' must be one of {list(_SPLITS)} (got {split!r})")
        scalers = [type(part).__name__ for part in fitted_parts(train_transform)]
        if scalers:
            raise ValueError(
                f"'train_transform' must have no parts that are fitted (got {', '.join(scalers)}); "
                "put them into 'transform'"
            )
        val = _val_part(split, val, test, held_out["val"], held_out["test"])
        keys = ("y", *(part.key or "" for part in fitted_parts(transform)))
        for name, size in (("val", val), ("test", test)):
            other = held_out[name]
            if other is None:
                continue
            if size > 0:
                raise ValueError(f"'{name}' must be 0 where '{name}_dataset' is given (got {size})")
            _check_same_layout(samples, other, name)
            check_same_names(samples, other, keys, f"'{name}_dataset'")
        self.dataset = samples
        self.val_dataset = held_out["val"]
        self.test_dataset = held_out["test"]
        self.split = split
        self.val = val
        self.test = test
        self.transform = copy.deepcopy(transform)  # fitting must not change the caller's
        self.train_transform = copy.deepcopy(train_transform)
        self.batch_size = batch_size
        self.num_workers = num_workers
        self.seed = seed
        self.fold = fold
        self._parts: dict[str, SampleSet] = {}

    @property
    def layout(self) -> TaxelLayout | None:
        r"""The layout of the sensor; :obj:`None` where samples may be of several."""
        return self.dataset.layout

    @property
    def class_names(self) -> list[str]:
        r"""The names of the classes or labels, where the data set has them."""
        return self.dataset.class_names

    @property
    def num_classes(self) -> int:
        r"""The number of classes or labels: of the names, where there are some."""
        return len(self.class_names) or self.dataset.num_classes

    @property
    def test_sessions(self) -> dict[int, str]:
        r"""Number and name of each recording session in the test part, once set up; empty where
        samples belong to no session.
        """
        part = self._parts.get("test")
        session = None if part is None else part.column("session")
        if part is None or session is None:
            return {}
        names = dict(enumerate(part.session_names))
        return {i: names.get(i, str(i)) for i in session.unique().tolist()}

    def part(self, name: Literal["train", "val", "test"]) -> SampleSet:
        r"""Returns a part of the data, before :obj:`transform`; it is empty if there is none.

        Args:
            name (str): :obj:`"train"`, :obj:`"val"` or :obj:`"test"`.
        """
        self.setup()
        return self._parts[name]

    def example(self, count: int = 1) -> StaticData | Batch:
        r"""Returns the first samples of :obj:`dataset` as a batch has them, except that scaling is
        left out: it needs no fit, and leaves every shape as it is. No random number is used up.

        Args:
            count (int): Number of samples, at most.
        """
        return self.peek(self.dataset, count, scaled=False)

    def peek(
        self, part: SampleSet, count: int | Tensor, *, scaled: bool = True
    ) -> StaticData | Batch:
        r"""Returns samples of a part as its batches have them, but for :obj:`train_transform`. No
        random number is used up.

        Args:
            part (StaticDataset or GraphSamples): Of :meth:`part`.
            count (int or torch.Tensor): Number of samples at most, evenly spaced; or their indices.
            scaled (bool): Whether to scale them, for which the transform must be fitted.
        """
        index = count if isinstance(count, Tensor) else _spread(len(part), count)
        steps = [step for step in flat(self.transform) if scaled or not _is_fitted(step)]
        part = copy.copy(part)
        with kept_rng():  # a copy, since a transform may have a generator of its own
            part.transform = copy.deepcopy(Compose([*flat(part.transform), *steps]))
            return part.batch(index)

    def setup(self, stage: str | None = None) -> None:
        r"""Splits the data set and fits the scaling."""
        if self._parts:
            return
        parts = self._split()
        fit_parts(self.transform, parts["train"], before=parts["train"].transform)
        self._parts = parts
        self._adapt()

    def _split(self) -> dict[str, SampleSet]:
        split = self.split
        if isinstance(split, str) and self.val == self.test == 0:  # there need be no such unit
            nothing = self.dataset[:0]
            parts: dict[str, SampleSet] = {"train": self.dataset, "val": nothing, "test": nothing}
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

    def _adapt(self) -> None:
        for name in ("val", "test"):
            part = self._parts[name]
            if len(part):
                fit_parts(self.transform, part, adapt=True, before=part.transform)

    @classmethod
    def load_from_checkpoint(cls, *args: Any, **kwargs: Any) -> NoReturn:
        r"""Not supported: Lightning's would call what the file names, and no checkpoint holds data.

        Raises:
            ValueError: Always.
        """
        raise ValueError(
            f"'{cls.__name__}' must be built from its data set: no checkpoint holds data; what a "
            "transform measured is taken from trainer.test(module, datamodule=data, ckpt_path=path)"
        )

    def state_dict(self) -> dict[str, Any]:
        r"""Returns what the transform measured, for a checkpoint."""
        return {"transform": [part.state_dict() for part in fitted_parts(self.transform)]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        r"""Takes over what the transform measured when the checkpoint was written.

        Args:
            state_dict (dict): What :meth:`state_dict` returned.
        """
        parts, states = fitted_parts(self.transform), state_dict["transform"]
        if len(parts) != len(states):
            raise ValueError(
                f"the checkpoint must be of {len(parts)} fitted transforms, as 'transform' "
                f"(got {len(states)})"
            )
        for part, state in zip(parts, states, strict=True):
            part.load_state_dict(state)
        if self._parts:
            self._adapt()

    def train_dataloader(self) -> StaticLoader | DataLoader:
        r"""Loads the training part, in a new order every epoch. A last batch of a single sample is
        left out: batch normalisation finds no spread in it.
        """
        return self._loader("train", self.train_transform, shuffle=True)

    def val_dataloader(self) -> StaticLoader | DataLoader | list[Any]:
        r"""Loads the validation part, if there is one."""
        return self._loader("val") if len(self._parts["val"]) else []

    def test_dataloader(self) -> StaticLoader | DataLoader:
        r"""Loads the test part."""
        if not len(self._parts["test"]):
            raise ValueError("there is no test part: give 'test_dataset', or a 'test' above 0")
        return self._loader("test")

    def predict_dataloader(self) -> StaticLoader | DataLoader:
        r"""Loads the test part."""
        return self.test_dataloader()

    def _loader(
        self, name: str, last: BaseTransform | None = None, shuffle: bool = False
    ) -> StaticLoader | DataLoader:
        part = copy.copy(self._parts[name])
        steps = [step for step in (part.transform, self.transform, last) if step is not None]
        part.transform = Compose(steps) if steps else None
        is_one_left = len(part) > self.batch_size > 1 and len(part) % self.batch_size == 1
        drop_last = shuffle and is_one_left
        if isinstance(part, GraphSamples):
            return DataLoader(
                part,
                batch_size=self.batch_size,
                shuffle=shuffle,
                drop_last=drop_last,
                num_workers=self.num_workers,
                persistent_workers=self.num_workers > 0,
            )
        return StaticLoader(  # by keyword, so that Lightning can build it again with its sampler
            part,
            batch_size=self.batch_size,
            shuffle=shuffle,
            drop_last=drop_last,
            keyed=True,
            num_workers=self.num_workers,
            persistent_workers=self.num_workers > 0,
        )


def _samples(dataset: Any, name: str, first: SampleSet | None = None) -> SampleSet:
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
    if first is not None and isinstance(samples, StaticDataset) != isinstance(first, StaticDataset):
        kind = "StaticDataset" if isinstance(first, StaticDataset) else "data set of PyG"
        raise TypeError(
            f"'{name}' must be a {kind}, as 'dataset' (got {type(dataset).__name__}): both are of "
            "one layout, or both are PyG's"
        )
    return samples


def _check_same_layout(first: SampleSet, other: SampleSet, name: str) -> None:
    if not isinstance(first, StaticDataset) or not isinstance(other, StaticDataset):
        return
    if not first.layout.matches(other.layout):
        raise ValueError(
            f"'{name}_dataset' must have the layout '{first.layout.name}' of 'dataset' "
            f"(got '{other.layout.name}')"
        )


def _val_part(
    split: str | Protocol | Split,
    val: float | None,
    test: float,
    val_dataset: SampleSet | None,
    test_dataset: SampleSet | None,
) -> float:
    # The part of the data set that is held out for validation.
    if not isinstance(split, Protocol):
        if val is None:
            return 0.1 if val_dataset is None else 0.0
        return val
    for name, part in (("val", val), ("test", test)):
        if part:
            raise ValueError(f"'{name}' must be left out with a protocol (got {part})")
    if split.has_test and test_dataset is not None:
        raise ValueError(
            "'test_dataset' must be left out where the protocol holds out a test part "
            f"(got '{split.describe()}')"
        )
    return split.val or 0.0


def _spread(size: int, count: int) -> Tensor:
    return torch.linspace(0, max(size - 1, 0), min(size, count)).long()


def _is_fitted(transform: BaseTransform) -> bool:
    return isinstance(transform, FittedTransform)
