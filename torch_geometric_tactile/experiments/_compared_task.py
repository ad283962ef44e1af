r"""What the models of a comparison have to do."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import torch

from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.nn.models.bmf_cnn import MIN_MAP_SIZE
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.training.training_recipe import TrainingRecipe, training_recipe

_TRANSFORMS = "torch_geometric_tactile.transforms."
# To train on. With more, an average of networks gains little, and one validation part has to do
# for them. Estimators are tried on several, which may hold out few trials or persons each.
_FEW_SAMPLES = 1000
_MEMBERS = 3
_REPEATS = 3
_REPEATS_OF_MANY = 2  # of estimators
# On which models are scored to choose one, where there is one given test part: all fifths of few
# samples, since each has very few, unless samples of many taxels take long.
_VALIDATION_CUTS, _VALIDATION_CUTS_OF_FEW = 3, 5
_MOST_TRIED = 1000  # samples of a cut that an estimator is trained on
# With more taxels and readings of all training samples, a network is one, of the first setting.
MANY_TAXELS = 500
_MANY_READINGS = 500_000
# Why nothing is saved.
NO_PREDICTOR = (
    "a predictor is of one layout, and the samples have none that all share: train the network "
    "with TactileModule, and keep its checkpoint"
)
_MIN_IMAGE_SIZE = 8  # rows and columns of an image that may be shifted in training
_ROCKET_FRAMES = 9  # that a kernel of MiniRocket spans


@dataclass(frozen=True)
class ComparedTask:
    r"""What the models of a comparison have to do."""

    layout: TaxelLayout | None  # None where samples may be of several sensors
    metric: str
    num_train: int
    posed: bool = False
    epochs: int | None = None
    tare: dict[str, Any] | None = None
    members: int | None = 1
    num_frames: int | None = None
    num_channels: int = 1
    several: str = ""  # without a layout, the numbers of taxels in words
    most_taxels: int = 1  # without a layout
    has_given_parts: bool = False

    @classmethod
    def of(
        cls,
        dataset: SampleSet,
        metric: str,
        num_train: int,
        num_frames: int | None = None,
        **more: Any,
    ) -> "ComparedTask":
        r"""Returns the task of a data set, of which so many samples are trained on."""
        width = dataset.batch(torch.tensor([0])).x.shape[-1]
        if isinstance(dataset, GraphSamples):
            more["several"] = dataset.describe_taxels()
            more["most_taxels"] = dataset.num_taxels[1]
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
    def num_taxels(self) -> int:
        r"""The number of taxels, or that of the sample with most."""
        return self.most_taxels if self.layout is None else self.layout.num_taxels

    @property
    def numbers(self) -> bool:
        r"""Whether numbers are predicted, not classes."""
        return self.metric == "mae"

    @property
    def recipe(self) -> TrainingRecipe:
        r"""How networks are trained."""
        recipe = training_recipe(self.num_train)
        return recipe if self.epochs is None else recipe._replace(max_epochs=self.epochs)

    @property
    def is_few(self) -> bool:
        r"""Whether the samples to train on are few."""
        return self.num_train <= _FEW_SAMPLES

    @property
    def is_large(self) -> bool:
        r"""Whether a sample has many taxels."""
        return self.num_taxels > MANY_TAXELS

    @property
    def is_slow(self) -> bool:
        r"""Whether a sample has many taxels, and the readings to train a network on are many."""
        return self.is_large and self.num_taxels * self.num_train > _MANY_READINGS

    @property
    def is_quick(self) -> bool:
        r"""Whether the samples to train on are few, and do not have many readings."""
        return self.is_few and not self.is_slow

    @property
    def num_blocks(self) -> int:
        r"""The blocks of a TemporalTaxelNet whose answer rests on all frames, also more than 64."""
        return max(2, math.ceil(math.log2((self.num_frames or 1) / 16)))

    @property
    def map_size(self) -> tuple[int, int]:
        r"""Rows and columns of the layout's image map; none without one."""
        if self.layout is None or self.layout.image_map is None:
            return 0, 0
        rows, columns = (self.layout.image_map.amax(dim=0) + 1).tolist()
        return rows, columns

    @property
    def is_image(self) -> bool:
        r"""Whether the readings are an image of at least 8 x 8 cells, on one patch."""
        if self.layout is None or min(self.map_size) < _MIN_IMAGE_SIZE:
            return False
        patch, link = self.layout.patch, self.layout.link
        assert patch is not None
        assert link is not None
        return len(patch.unique()) == 1 and len(link.unique()) == 1

    @property
    def cnn_widths(self) -> list[int]:
        r"""A stage for each halving of the map down to two or three cells."""
        stages = round(math.log2(min(self.map_size))) - 1
        return [16, 32, *[64] * (stages - 2)] if stages > 2 else [32, 64]

    def shift(self, *, mirrored: bool = False) -> dict[str, Any]:
        r"""Returns shifts of the image by up to a sixteenth of its size, and mirror images of half
        of the samples if wanted, as an augmentation, as plain data.
        """
        rows, columns = (max(1, round(size / 16)) for size in self.map_size)
        steps = [_step("RandomShift", {"rows": rows, "columns": columns})]
        return _composed([*steps, *([_step("RandomMirror")] if mirrored else [])])

    def time_shift(self) -> dict[str, Any]:
        r"""Returns shifts in time by up to a sixteenth of the window, as an augmentation, as plain
        data.
        """
        return _composed(
            [_step("RandomTimeShift", {"steps": max(1, (self.num_frames or 1) // 16)})]
        )

    def choice(
        self,
        settings: Sequence[dict[str, Any]] = ({},),
        *,
        is_estimator: bool = False,
        draft: Mapping[str, Any] | None = None,
    ) -> Choice:
        r"""Returns what is chosen for a model, which is changed by :obj:`draft` until then."""
        members = self.members or (_MEMBERS if self.is_quick else 1)
        has_all_cuts = self.is_few and not self.is_large
        cuts = _VALIDATION_CUTS_OF_FEW if has_all_cuts else _VALIDATION_CUTS
        cuts = cuts if self.has_given_parts else 0
        if is_estimator:
            repeats = _REPEATS if self.is_quick else _REPEATS_OF_MANY
            return Choice(
                *(settings, self.metric, members, repeats, _MOST_TRIED, cuts), draft=draft or {}
            )
        settings = settings[:1] if self.is_slow else settings
        repeats = _REPEATS if self.is_few else 1
        return Choice(settings, self.metric, members, repeats, num_validation_cuts=cuts)

    def transform(
        self,
        *,
        scaled: bool = True,
        posed: bool = False,
        filled: bool = True,
        rooted: bool = False,
        normalized: bool = False,
        centred: bool = True,
    ) -> dict[str, Any]:
        r"""Returns what every batch goes through, as plain data."""
        steps = [] if self.tare is None else [_step("Tare", self.tare)]
        if rooted:
            steps.append(_step("SquareRoot"))
        if normalized:
            steps.append(_step("NormalizeRMS"))
        if scaled:
            given: dict[str, Any] = {} if self.num_frames is None else {"per": "signal"}
            if self.layout is None:
                given["per"] = "channel"
            given |= {"scale_per": "channel"} | ({} if centred else {"with_mean": False})
            steps.append(_step("ZScore", given))
        if filled:
            steps.append(_step("FillMissing"))
        if posed:
            assert self.layout is not None
            steps.append(_step("TaxelPose", {"layout": self.layout.name, "tangent": True}))
        return _composed(steps)


def _can_be_posed(dataset: SampleSet) -> bool:
    if isinstance(dataset, GraphSamples):
        return False
    joint, layout = dataset.column("joint"), dataset.layout
    hand = HandKinematics.allegro()
    try:
        is_stock = stock_layout(layout.name).matches(layout)
    except ValueError:
        return False
    if joint is None or joint.dim() != 2 or joint.shape[1] != hand.num_joints or not is_stock:
        return False
    return len(layout.link_names) > 1 and set(layout.link_names) <= set(hand.link_names)


def _composed(steps: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "class_path": "torch_geometric.transforms.Compose",
        "init_args": {"transforms": steps},
    }


def _step(name: str, arguments: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"class_path": f"{_TRANSFORMS}{name}", "init_args": arguments or {}}


def lacks_frames(task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything."""
    if task.num_frames is not None:
        return ""
    return "the samples are single frames: cut windows ('window') or whole trials ('trials')"


def lacks_many_frames(task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything."""
    if task.num_frames is None or task.num_frames < _ROCKET_FRAMES:
        return lacks_frames(task) or f"the windows have less than {_ROCKET_FRAMES} frames"
    return "" if find_spec("sktime") else "sktime is missing (the extra 'series')"


def lacks_a_frame(task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything."""
    return "" if task.num_frames is None else "it is for single frames, and the samples have more"


def lacks_a_pose(task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything."""
    return lacks_a_frame(task) or (
        "" if task.posed else "the taxels are not placed by joint angles"
    )


def lacks_a_map(task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything."""
    has_map = task.layout is not None and task.layout.image_map is not None
    return "" if has_map else "the layout has no image_map"


def lacks_a_large_map(task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything."""
    image_map = None if task.layout is None else task.layout.image_map
    if image_map is None or int(image_map.amax(dim=0).min()) + 1 >= MIN_MAP_SIZE:
        return lacks_a_map(task)
    return f"the image_map of the layout has fewer than {MIN_MAP_SIZE} x {MIN_MAP_SIZE} cells"
