"""The models of the study of the simulated hand: each is trained by one call, and predicts."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, huber_loss

from torch_geometric_tactile.baselines import flat_forest, posed_forest, posed_ridge
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn import PosedTaxelNet, TactileFNN, TaxelNet
from torch_geometric_tactile.nn.models._taxels import taxel_mask
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training import training_recipe
from torch_geometric_tactile.transforms import ZScore

JOINTS = 16
DROPPED = 0.2
_FNN = {"widths": (256, 64), "pools": (1, 1)}


@dataclass
class Network:
    """A network, trained by the recipe of the package."""

    make: Callable[..., nn.Module]
    options: dict[str, Any] = field(default_factory=dict)
    scaled: bool = True
    any_layout: bool = False
    dropped: float = 0.0  # part of the taxels of each sample that a training step does not see

    def fit(self, data: StaticData, y: Tensor, layout: TaxelLayout, task: str, seed: int) -> None:
        self.numbers, self.layout = task != "shape", layout
        self.outputs = 1 if self.numbers else int(y.max()) + 1
        # A scale of one number: nothing is known of the test part.
        self.centre, self.scale = (y.mean(), y.std()) if self.numbers else (0.0, 1.0)
        self.z_score = ZScore(per="channel").fit(data) if self.scaled else None
        torch.manual_seed(seed)
        self.model = self.make(layout, self.outputs, **self.options)
        inputs, target = self.inputs(data), (y - self.centre) / self.scale
        recipe = training_recipe(len(y))
        steps = len(y) // recipe.batch_size
        weights = self.model.parameters()
        optimizer = torch.optim.AdamW(
            weights, recipe.lr, weight_decay=recipe.weight_decay, fused=True
        )
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, recipe.lr, recipe.max_epochs * steps, cycle_momentum=False
        )
        for _ in range(recipe.max_epochs):
            for rows in torch.randperm(len(y)).split(recipe.batch_size)[:steps]:
                optimizer.zero_grad()
                batch = {key: value[rows] for key, value in inputs.items()}
                seen = taxel_mask(batch["x"], self.dropped)
                if seen is not None:
                    batch["x"] = batch["x"] * seen.unsqueeze(-1)
                out = self.model(**batch)
                if self.numbers:
                    loss = huber_loss(out[:, 0], target[rows])
                else:
                    smoothing = recipe.label_smoothing
                    loss = cross_entropy(out, target[rows].long(), label_smoothing=smoothing)
                loss.backward()
                optimizer.step()
                schedule.step()
        self.model.eval()

    def inputs(self, data: StaticData) -> dict[str, Tensor]:
        if self.z_score is not None:
            data = self.z_score(data)
        names: Any = getattr(self.model, "modalities", ())
        return {"x": data.x, **{name: data[name] for name in names}}

    @torch.no_grad()
    def predict(self, data: StaticData) -> np.ndarray:
        inputs = self.inputs(data)
        parts = []
        for rows in torch.arange(len(data.x)).split(256):
            parts.append(self.model(**{key: value[rows] for key, value in inputs.items()}))
        out = torch.cat(parts)
        if not self.numbers:
            return out.argmax(dim=1).numpy()
        return (out[:, 0] * self.scale + self.centre).numpy()

    def on(self, layout: TaxelLayout) -> "Network":
        """The same weights for another layout."""
        other = copy.copy(self)
        other.model = self.make(layout, self.outputs, **self.options).eval()
        other.model.load_state_dict(self.model.state_dict())
        return other

    @property
    def size(self) -> int:
        return sum(weight.numel() for weight in self.model.parameters())


@dataclass
class Forest:
    """A forest or ridge of the package."""

    kind: str
    joints: bool = False
    any_layout: bool = False

    def fit(self, data: StaticData, y: Tensor, layout: TaxelLayout, task: str, seed: int) -> None:
        kind = "multiclass" if task == "shape" else "regression"
        if self.kind == "flat":
            # Of 1,168 numbers, 300 trees of a regression take two minutes.
            trees = 300 if task == "shape" else 100
            self.model: Any = flat_forest(kind, num_trees=trees)[-1]
            self.model.set_params(random_state=seed)
        elif self.kind == "posed":
            self.model = posed_forest(layout, kind)
            self.model[-1].set_params(random_state=seed)
        else:
            self.model = posed_ridge(layout, kind)
        self.model.fit(self.inputs(data), y.numpy())

    def inputs(self, data: StaticData) -> Any:
        if self.kind != "flat":
            return data
        rows = data.x.flatten(1)
        return torch.cat([rows, data.joint], dim=1).numpy() if self.joints else rows.numpy()

    def predict(self, data: StaticData) -> np.ndarray:
        found: np.ndarray = self.model.predict(self.inputs(data))
        return found

    @property
    def size(self) -> int | None:
        return None


def make(name: str) -> Any:
    """A model that is not trained yet."""
    joints = {"num_joints": JOINTS}
    makers: dict[str, Callable[[], Any]] = {
        "flat_forest": lambda: Forest("flat", joints=True),
        "flat_forest_touch": lambda: Forest("flat"),
        "posed_forest": lambda: Forest("posed"),
        "posed_ridge": lambda: Forest("ridge"),
        "fnn": lambda: Network(TactileFNN, {**_FNN, **joints}),
        "fnn_touch": lambda: Network(TactileFNN, _FNN),
        "taxel_net": lambda: Network(TaxelNet, {"taxel_dropout": 0.0}),
        "taxel_net_joint": lambda: Network(TaxelNet, joints),
        "fnn_dropped": lambda: Network(TactileFNN, {**_FNN, **joints}, dropped=DROPPED),
        "taxel_net_dropped": lambda: Network(TaxelNet),
        "posed": lambda: Network(PosedTaxelNet, scaled=False, any_layout=True),
        "open": lambda: Network(PosedTaxelNet, {"posed": False}, scaled=False, any_layout=True),
    }
    return makers[name]()
