r"""What the models of a comparison have to do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.experiments._facts import num_frames_of
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.training.training_recipe import TrainingRecipe, training_recipe

_TRANSFORMS = "torch_geometric_tactile.transforms."

Settings = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Task:
    r"""What the models of a comparison have to do."""

    layout: TaxelLayout
    metric: str
    num_train: int
    posed: bool = False
    epochs: int | None = None
    tare: dict[str, Any] | None = None
    members: int = 1
    num_frames: int | None = None
    num_channels: int = 1

    @classmethod
    def of(cls, dataset: StaticDataset, metric: str, part: float, **more: Any) -> "Task":
        r"""Returns the task of a data set."""
        num_train = max(1, round(part * len(dataset)))
        num_frames = num_frames_of(dataset)
        width = dataset.batch(torch.tensor([0])).x.size(-1)
        return cls(
            dataset.layout,
            metric,
            num_train,
            posed=num_frames is None and _can_be_posed(dataset),
            num_frames=num_frames,
            num_channels=width // (num_frames or 1),
            **more,
        )

    @property
    def numbers(self) -> bool:
        r"""Whether numbers are predicted, not classes."""
        return self.metric == "mae"

    @property
    def recipe(self) -> TrainingRecipe:
        r"""How networks are trained."""
        recipe = training_recipe(self.num_train)
        return recipe if self.epochs is None else recipe._replace(max_epochs=self.epochs)

    def choice(self, settings: Settings = ({},)) -> Choice:
        r"""Returns what is chosen for a model."""
        return Choice(settings, self.metric, self.members)

    def transform(
        self, *, scaled: bool, posed: bool = False, filled: bool = True
    ) -> dict[str, Any]:
        r"""Returns what every batch goes through, as plain data."""
        steps = [] if self.tare is None else [_step("Tare", self.tare)]
        if scaled:
            of_signals = {} if self.num_frames is None else {"per": "signal"}
            steps.append(_step("ZScore", {**of_signals, "scale_per": "channel"}))
        if filled:
            steps.append(_step("FillMissing"))
        if posed:
            steps.append(_step("TaxelPose", {"layout": self.layout.name, "tangent": True}))
        return {
            "class_path": "torch_geometric.transforms.Compose",
            "init_args": {"transforms": steps},
        }


def _can_be_posed(dataset: StaticDataset) -> bool:
    joint, layout = dataset.column("joint"), dataset.layout
    hand = HandKinematics.allegro()
    try:
        is_stock = stock_layout(layout.name).matches(layout)
    except ValueError:
        return False
    if joint is None or joint.dim() != 2 or joint.size(1) != hand.num_joints or not is_stock:
        return False
    return len(layout.link_names) > 1 and set(layout.link_names) <= set(hand.link_names)


def _step(name: str, arguments: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"class_path": f"{_TRANSFORMS}{name}", "init_args": arguments or {}}
