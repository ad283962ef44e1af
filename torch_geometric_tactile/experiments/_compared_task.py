r"""What the models of a comparison have to do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.training.training_recipe import TrainingRecipe, training_recipe

_TRANSFORMS = "torch_geometric_tactile.transforms."
_FEW_SAMPLES = 1000  # to train on: with more, one validation part tells enough
_REPEATS = 3


@dataclass(frozen=True)
class ComparedTask:
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
    def of(
        cls,
        dataset: StaticDataset,
        metric: str,
        part: float,
        num_frames: int | None = None,
        **more: Any,
    ) -> "ComparedTask":
        r"""Returns the task of a data set."""
        num_train = max(1, round(part * len(dataset)))
        width = dataset.batch(torch.tensor([0])).x.shape[-1]
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

    def choice(self, settings: Sequence[dict[str, Any]] = ({},)) -> Choice:
        r"""Returns what is chosen for a model."""
        repeats = _REPEATS if self.num_train <= _FEW_SAMPLES else 1
        return Choice(settings, self.metric, self.members, repeats)

    def transform(
        self,
        *,
        scaled: bool = True,
        posed: bool = False,
        filled: bool = True,
        rooted: bool = False,
        centred: bool = True,
    ) -> dict[str, Any]:
        r"""Returns what every batch goes through, as plain data."""
        steps = [] if self.tare is None else [_step("Tare", self.tare)]
        if rooted:
            steps.append(_step("SquareRoot"))
        if scaled:
            given: dict[str, Any] = {} if self.num_frames is None else {"per": "signal"}
            given |= {"scale_per": "channel"} | ({} if centred else {"with_mean": False})
            steps.append(_step("ZScore", given))
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
    if joint is None or joint.dim() != 2 or joint.shape[1] != hand.num_joints or not is_stock:
        return False
    return len(layout.link_names) > 1 and set(layout.link_names) <= set(hand.link_names)


def _step(name: str, arguments: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"class_path": f"{_TRANSFORMS}{name}", "init_args": arguments or {}}
