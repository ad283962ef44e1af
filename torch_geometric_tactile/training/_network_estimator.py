r"""What networks as estimators of scikit-learn have in common."""

import copy
from collections.abc import Mapping
from typing import Any

import lightning as L
import numpy as np
import torch
from sklearn.base import BaseEstimator
from sklearn.utils import Tags, check_random_state
from sklearn.utils.validation import check_is_fitted
from torch.nn import Module
from torch_geometric.transforms import Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.baselines._readings import readings
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.training._silent_training import silent_training
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import classifier_from_config
from torch_geometric_tactile.training.one_cycle import OneCycle
from torch_geometric_tactile.training.training_recipe import training_recipe
from torch_geometric_tactile.transforms import FillMissing, KNNGraph, ZScore

_MODELS = "torch_geometric_tactile.nn.models."
_MOST_SEED = 2**31 - 1
_NEIGHBOURS = 6


class NetworkEstimator(BaseEstimator):
    r"""Keeps the arguments, trains a network on arrays, and asks its predictor."""

    def __init__(
        self,
        layout: TaxelLayout | PathLike,
        model: str = "TaxelNet",
        arguments: Mapping[str, Any] | None = None,
        *,
        epochs: int | None = None,
        batch_size: int | None = None,
        lr: float | None = None,
        weight_decay: float | None = None,
        random_state: Any = None,
    ) -> None:
        self.layout = layout
        self.model = model
        self.arguments = arguments
        self.epochs = epochs
        self.batch_size = batch_size
        self.lr = lr
        self.weight_decay = weight_decay
        self.random_state = random_state

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array, tags.input_tags.three_d_array = False, True
        tags.input_tags.allow_nan = True
        tags.non_deterministic = self.random_state is None
        return tags

    def to_predictor(self) -> Predictor:
        r"""Returns the trained network with its preparation, which takes raw readings and can be
        saved.
        """
        check_is_fitted(self, "predictor_")
        predictor: Predictor = copy.deepcopy(self.predictor_)
        return predictor

    def _say(self, x: Any) -> np.ndarray:
        # Probabilities or numbers (S, C).
        check_is_fitted(self, "predictor_")
        values = readings(x).astype(np.float32)
        if values.shape[2] != self.num_channels_:
            raise ValueError(
                f"'x' must have {self.num_channels_} channels, as {type(self).__name__} was fitted "
                f"on (got shape {values.shape})"
            )
        said: np.ndarray = self.predictor_(values).double().numpy()
        return said

    def _train(self, x: Any, y: np.ndarray, **section: Any) -> tuple[StaticDataset, Any, Module]:
        # The samples, the fitted transform, and the trained network.
        values = readings(x).astype(np.float32)
        need(len(values) == len(y), f"'y' must be of {len(values)} samples", len(y))
        need(len(values) >= 1, "'x' must have at least one sample (got none)")
        self.num_channels_ = values.shape[2]
        names = section.pop("class_names", ())
        layout, near = as_layout(self.layout), None
        if layout.default_adjacency is None and layout.num_taxels > 1:
            near = KNNGraph(min(_NEIGHBOURS, layout.num_taxels - 1))
        dataset = StaticDataset.from_arrays(
            values, y, layout=layout, class_names=names, pre_transform=near
        )
        recipe = training_recipe(len(dataset))
        data = TactileDataModule(
            dataset,
            dataset[:0],
            split="frame",
            val_dataset=dataset[:0],
            transform=Compose([ZScore(scale_per="channel"), FillMissing()]),
            batch_size=self.batch_size or recipe.batch_size,
        )
        data.setup()
        optimizer = {
            "lr": recipe.lr if self.lr is None else self.lr,
            "weight_decay": recipe.weight_decay if self.weight_decay is None else self.weight_decay,
        }
        config = {
            "model": {
                "class_path": f"{_MODELS}{self.model}",
                "init_args": dict(self.arguments or {}),
            },
            "optimizer": {"class_path": "torch.optim.AdamW", "init_args": optimizer},
            **section,
        }
        epochs = recipe.max_epochs if self.epochs is None else self.epochs
        seed = int(check_random_state(self.random_state).randint(_MOST_SEED))
        with torch.random.fork_rng(devices=[]):  # the draws of others stay theirs
            torch.manual_seed(seed)
            module = classifier_from_config(config, data)
            with silent_training():
                trainer = L.Trainer(
                    barebones=True,
                    accelerator="cpu",
                    devices=1,
                    max_epochs=epochs,
                    limit_val_batches=0,
                    callbacks=[OneCycle()],
                )
                trainer.fit(module, datamodule=data)
        return dataset, data.transform, module.model.eval().cpu()
