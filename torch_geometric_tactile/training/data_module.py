r"""The parts of a data set that training, validation and test see."""

import copy
from typing import Any, Literal

import lightning as L
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import Split, StaticData, StaticDataset, apply_transform, splits
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import fit_transform, fitted_parts

_SPLITS = {"frame": splits.by_frame, "trial": splits.by_trial, "group": splits.by_group}


class TactileDataModule(L.LightningDataModule):
    r"""Splits a data set, fits the scaling on its training part, and loads batches.

    The state of a fitted :obj:`transform` is stored in checkpoints. Of validation, test and
    prediction samples, a transform that works session by session measures the sessions that the
    training part did not have, without labels.

    Args:
        dataset (StaticDataset): What to train on.
        test_dataset (StaticDataset, optional): What to test and predict on; if left out, a part of
            :obj:`dataset`.
        split (str or Split): What is never torn apart: :obj:`"trial"`, :obj:`"group"` (objects),
            or :obj:`"frame"` (nothing); or the indices themselves.
        val (float): The part of :obj:`dataset` for validation.
        test (float): The part of :obj:`dataset` for the test.
        transform (BaseTransform, optional): Applied to every batch, after the transform of the data
            set; fitted on the training part where it can be.
        batch_size (int): Number of samples of a batch.
        num_workers (int): Number of processes that load batches; none by default, since a batch is
            one piece of a tensor.
        seed (int): Which of the random splits.

    Raises:
        ValueError: If :obj:`split` is unknown, parts of :obj:`dataset` are kept for a test that
            :obj:`test_dataset` is for, the two data sets have different layouts, or the samples
            have no edges.
    """

    def __init__(
        self,
        dataset: StaticDataset,
        test_dataset: StaticDataset | None = None,
        split: Literal["frame", "trial", "group"] | Split = "trial",
        val: float = 0.1,
        test: float = 0.0,
        transform: BaseTransform | None = None,
        batch_size: int = 128,
        num_workers: int = 0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if isinstance(split, str) and split not in _SPLITS:
            raise ValueError(f"'split' must be one of {list(_SPLITS)} (got '{split}')")
        if test_dataset is not None:
            if test > 0:
                raise ValueError(f"'test' must be 0 where 'test_dataset' is given (got {test})")
            if not dataset.layout.matches(test_dataset.layout):
                raise ValueError(
                    f"'test_dataset' must have the layout '{dataset.layout.name}' of 'dataset' "
                    f"(got '{test_dataset.layout.name}')"
                )
        self.dataset = dataset
        self.test_dataset = test_dataset
        self.split = split
        self.val = val
        self.test = test
        self.transform = copy.deepcopy(transform)  # fitting must not change the caller's
        self.batch_size = batch_size
        self.num_workers = num_workers
        self.seed = seed
        self._parts: dict[str, StaticDataset] = {}

    @property
    def layout(self) -> TaxelLayout:
        r"""The layout of the sensor."""
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
        r"""Number and name of each recording session in the test part, once set up."""
        session = self._parts["test"].column("session")
        if session is None:
            return {}
        names = self._parts["test"].session_names
        return {i: names[i] for i in session.unique().tolist()}

    def setup(self, stage: str | None = None) -> None:
        r"""Splits the data set and fits the scaling."""
        if self._parts:
            return
        split = self.split
        if isinstance(split, str):
            split = _SPLITS[split](self.dataset, self.val, self.test, self.seed)
        parts = {name: self.dataset[getattr(split, name)] for name in ("train", "val", "test")}
        if self.test_dataset is not None:
            parts["test"] = self.test_dataset
        if len(parts["train"]) and parts["train"].batch([0]).edge_index is None:
            raise ValueError(
                "'dataset' must have edges (got none); give it, for example, "
                "pre_transform=KNNGraph(k=2)"
            )
        if fitted_parts(self.transform):
            fit_transform(self.transform, _readings(parts["train"]))
        self._parts = parts
        self._adapt()

    def _adapt(self) -> None:
        if fitted_parts(self.transform):
            for name in ("val", "test"):
                if len(self._parts[name]):
                    fit_transform(self.transform, _readings(self._parts[name]), adapt=True)

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

    def train_dataloader(self) -> StaticLoader:
        r"""Loads the training part, in a new order every epoch."""
        return self._loader("train", shuffle=True)

    def val_dataloader(self) -> StaticLoader | list[Any]:
        r"""Loads the validation part, if there is one."""
        return self._loader("val") if len(self._parts["val"]) else []

    def test_dataloader(self) -> StaticLoader:
        r"""Loads the test part."""
        if not len(self._parts["test"]):
            raise ValueError("there is no test part: give 'test_dataset', or a 'test' above 0")
        return self._loader("test")

    def predict_dataloader(self) -> StaticLoader:
        r"""Loads the test part."""
        return self.test_dataloader()

    def _loader(self, name: str, shuffle: bool = False) -> StaticLoader:
        part = copy.copy(self._parts[name])
        part.transform = Compose([t for t in (part.transform, self.transform) if t is not None])
        return StaticLoader(  # by keyword, so that Lightning can build it again with its sampler
            part,
            batch_size=self.batch_size,
            shuffle=shuffle,
            num_workers=self.num_workers,
            persistent_workers=self.num_workers > 0,
        )


def _readings(dataset: StaticDataset) -> StaticData:
    return apply_transform(dataset.transform, dataset.data)
