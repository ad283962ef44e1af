r"""The task of the models in a comparison: the data and the sizes on which settings depend."""

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
# With more training samples, averaging networks improves little, and one validation part is enough
# to select a network. Estimators still need two, since a part may contain few trials or persons.
_SMALL_TRAINING_SIZE = 1000
_NUM_MEMBERS = 3
_NUM_REPEATS = 3
_NUM_REPEATS_LARGE = 2  # for estimators
# Number of cuts on which models are scored if they share a given test part. Small training parts
# use all five fifths, since each has very few samples, unless a large sensor makes training slow.
_NUM_VALIDATION_CUTS, _NUM_VALIDATION_CUTS_SMALL = 3, 5
_MAX_SELECTION_SAMPLES = 1000  # to fit an estimator on while settings are compared
# Above both limits, only one network is trained, with the first setting.
LARGE_SENSOR_TAXELS = 500
_SLOW_TRAINING_READINGS = 500_000  # taxels times training samples
NO_PREDICTOR = (
    "a predictor needs one layout, and the samples share no layout: train the network with "
    "TactileModule, and keep its checkpoint"
)
_MIN_IMAGE_SIZE = 8  # rows and columns; smaller images are not shifted in training
_MINIROCKET_KERNEL_FRAMES = 9  # the length of its kernels


@dataclass(frozen=True)
class ComparedTask:
    r"""The task of the models in a comparison.

    Args:
        layout (TaxelLayout, optional): The taxels; :obj:`None` if samples may have different
            sensors.
        metric (str): The score that is compared.
        num_train (int): Number of training samples.
        has_pose (bool): Whether the joint angles of the samples place the taxels.
        epochs (int, optional): Epochs of networks. Defaults to a number that depends on the number
            of samples.
        tare (dict, optional): Arguments of :class:`~torch_geometric_tactile.transforms.Tare`.
        members (int, optional): Number of averaged networks. Defaults to a number that depends on
            the number of samples.
        num_frames (int, optional): Number of frames per sample; :obj:`None` for single frames.
        num_channels (int): Number of channels per taxel and frame.
        taxel_counts (str): Without a layout, the numbers of taxels in words.
        max_taxels (int): Without a layout, the number of taxels of the largest sample.
        has_given_parts (bool): Whether the training and test parts are given by the data set.
    """

    layout: TaxelLayout | None
    metric: str
    num_train: int
    has_pose: bool = False
    epochs: int | None = None
    tare: dict[str, Any] | None = None
    members: int | None = 1
    num_frames: int | None = None
    num_channels: int = 1
    taxel_counts: str = ""
    max_taxels: int = 1
    has_given_parts: bool = False

    @classmethod
    def from_dataset(
        cls,
        dataset: SampleSet,
        metric: str,
        num_train: int,
        num_frames: int | None = None,
        **options: Any,
    ) -> "ComparedTask":
        r"""Returns the task of a data set.

        Args:
            dataset (StaticDataset): The samples.
            metric (str): The score that is compared.
            num_train (int): Number of training samples.
            num_frames (int, optional): Number of frames per sample; :obj:`None` for single frames.
            **options (Any): Further arguments of the task.
        """
        width = dataset.batch(torch.tensor([0])).x.shape[-1]
        if isinstance(dataset, GraphSamples):
            options["taxel_counts"] = dataset.describe_taxels()
            options["max_taxels"] = dataset.num_taxels[1]
        return cls(
            dataset.layout,
            metric,
            num_train,
            has_pose=num_frames is None and _has_pose(dataset),
            num_frames=num_frames,
            num_channels=width // (num_frames or 1),
            **options,
        )

    @property
    def num_taxels(self) -> int:
        r"""The number of taxels; without a layout, the number in the largest sample."""
        return self.max_taxels if self.layout is None else self.layout.num_taxels

    @property
    def is_regression(self) -> bool:
        r"""Whether the targets are numbers, not classes."""
        return self.metric == "mae"

    @property
    def recipe(self) -> TrainingRecipe:
        r"""The training recipe of networks."""
        recipe = training_recipe(self.num_train)
        return recipe if self.epochs is None else recipe._replace(max_epochs=self.epochs)

    @property
    def has_few_samples(self) -> bool:
        r"""Whether there are at most 1,000 training samples."""
        return self.num_train <= _SMALL_TRAINING_SIZE

    @property
    def has_many_taxels(self) -> bool:
        r"""Whether a sample has more than 500 taxels."""
        return self.num_taxels > LARGE_SENSOR_TAXELS

    @property
    def is_slow(self) -> bool:
        r"""Whether training a network is slow: with many taxels and more than 500,000 readings."""
        return self.has_many_taxels and self.num_taxels * self.num_train > _SLOW_TRAINING_READINGS

    @property
    def is_quick(self) -> bool:
        r"""Whether there are few training samples, and training is not slow."""
        return self.has_few_samples and not self.is_slow

    @property
    def num_blocks(self) -> int:
        r"""The number of blocks of a TemporalTaxelNet whose receptive field covers all frames."""
        return max(2, math.ceil(math.log2((self.num_frames or 1) / 16)))

    @property
    def map_size(self) -> tuple[int, int]:
        r"""Rows and columns of the layout's image map; zeros without a map."""
        if self.layout is None or self.layout.image_map is None:
            return 0, 0
        rows, columns = (self.layout.image_map.amax(dim=0) + 1).tolist()
        return rows, columns

    @property
    def is_image(self) -> bool:
        r"""Whether the taxels are an image of at least 8 x 8 cells, on a single patch."""
        if self.layout is None or min(self.map_size) < _MIN_IMAGE_SIZE:
            return False
        patch, link = self.layout.patch, self.layout.link
        assert patch is not None
        assert link is not None
        return len(patch.unique()) == 1 and len(link.unique()) == 1

    @property
    def cnn_widths(self) -> list[int]:
        r"""Channels of each stage of a CNN. Each stage halves the map, down to two or three
        cells.
        """
        stages = round(math.log2(min(self.map_size))) - 1
        return [16, 32, *[64] * (stages - 2)] if stages > 2 else [32, 64]

    def shift(self, *, mirrored: bool = False) -> dict[str, Any]:
        r"""Returns an augmentation as plain data: random shifts of the image by up to a sixteenth
        of its size.

        Args:
            mirrored (bool): If :obj:`True`, also mirrors half of the samples.
        """
        rows, columns = (max(1, round(size / 16)) for size in self.map_size)
        steps = [_step("RandomShift", {"rows": rows, "columns": columns})]
        return _compose([*steps, *([_step("RandomMirror")] if mirrored else [])])

    def time_shift(self) -> dict[str, Any]:
        r"""Returns an augmentation as plain data: random shifts in time by up to a sixteenth of the
        window.
        """
        return _compose([_step("RandomTimeShift", {"steps": max(1, (self.num_frames or 1) // 16)})])

    def choice(
        self,
        settings: Sequence[dict[str, Any]] = ({},),
        *,
        is_estimator: bool = False,
        draft: Mapping[str, Any] | None = None,
    ) -> Choice:
        r"""Returns the selection of settings of a model. The numbers of cuts, samples and networks
        depend on the size of the task.

        Args:
            settings (sequence of dict): The settings, the default first.
            is_estimator (bool): Whether the model is a scikit-learn estimator.
            draft (Mapping, optional): As in :class:`Choice`.
        """
        members = self.members or (_NUM_MEMBERS if self.is_quick else 1)
        has_all_cuts = self.has_few_samples and not self.has_many_taxels
        cuts = _NUM_VALIDATION_CUTS_SMALL if has_all_cuts else _NUM_VALIDATION_CUTS
        cuts = cuts if self.has_given_parts else 0
        if is_estimator:
            repeats = _NUM_REPEATS if self.is_quick else _NUM_REPEATS_LARGE
            return Choice(
                *(settings, self.metric, members, repeats, _MAX_SELECTION_SAMPLES, cuts),
                draft=draft or {},
            )
        settings = settings[:1] if self.is_slow else settings
        repeats = _NUM_REPEATS if self.has_few_samples else 1
        return Choice(settings, self.metric, members, repeats, num_validation_cuts=cuts)

    def transform(
        self,
        *,
        scaled: bool = True,
        posed: bool = False,
        filled: bool = True,
        square_root: bool = False,
        normalized: bool = False,
        centred: bool = True,
    ) -> dict[str, Any]:
        r"""Returns the transform of all batches as plain data.

        Args:
            scaled (bool): Whether to scale readings by :class:`ZScore`.
            posed (bool): Whether to place the taxels by the joint angles.
            filled (bool): Whether to fill missing readings.
            square_root (bool): Whether to take square roots of the readings.
            normalized (bool): Whether to divide each sample by its root mean square.
            centred (bool): Whether scaling subtracts the mean.
        """
        steps = [] if self.tare is None else [_step("Tare", self.tare)]
        if square_root:
            steps.append(_step("SquareRoot"))
        if normalized:
            steps.append(_step("NormalizeRMS"))
        if scaled:
            scaling: dict[str, Any] = {} if self.num_frames is None else {"per": "signal"}
            if self.layout is None:
                scaling["per"] = "channel"
            scaling |= {"scale_per": "channel"} | ({} if centred else {"with_mean": False})
            steps.append(_step("ZScore", scaling))
        if filled:
            steps.append(_step("FillMissing"))
        if posed:
            assert self.layout is not None
            steps.append(_step("TaxelPose", {"layout": self.layout.name, "tangent": True}))
        return _compose(steps)


def _has_pose(dataset: SampleSet) -> bool:
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


def _compose(steps: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "class_path": "torch_geometric.transforms.Compose",
        "init_args": {"transforms": steps},
    }


def _step(name: str, arguments: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"class_path": f"{_TRANSFORMS}{name}", "init_args": arguments or {}}


def describe_missing_windows(task: ComparedTask) -> str:
    r"""Returns why a model for several frames cannot be compared, or an empty text if it can."""
    if task.num_frames is not None:
        return ""
    return "the samples are single frames: cut windows ('window') or whole trials ('trials')"


def describe_minirocket_obstacle(task: ComparedTask) -> str:
    r"""Returns why MiniRocket cannot be compared, or an empty text if it can."""
    if task.num_frames is None or task.num_frames < _MINIROCKET_KERNEL_FRAMES:
        return (
            describe_missing_windows(task)
            or f"the windows have fewer than {_MINIROCKET_KERNEL_FRAMES} frames"
        )
    return "" if find_spec("sktime") else "sktime is missing (the extra 'series')"


def describe_frame_obstacle(task: ComparedTask) -> str:
    r"""Returns why a model for single frames cannot be compared, or an empty text if it can."""
    has_single_frames = task.num_frames is None
    return "" if has_single_frames else "it is for single frames, and a sample has several"


def describe_missing_pose(task: ComparedTask) -> str:
    r"""Returns why a model that uses taxel poses cannot be compared, or an empty text if it can."""
    return describe_frame_obstacle(task) or (
        "" if task.has_pose else "the taxels are not placed by joint angles"
    )


def describe_missing_map(task: ComparedTask) -> str:
    r"""Returns why a model for images cannot be compared, or an empty text if it can."""
    has_map = task.layout is not None and task.layout.image_map is not None
    return "" if has_map else "the layout has no image_map"


def describe_small_map(task: ComparedTask) -> str:
    r"""Returns why a model for larger images cannot be compared, or an empty text if it can."""
    image_map = None if task.layout is None else task.layout.image_map
    if image_map is None or int(image_map.amax(dim=0).min()) + 1 >= MIN_MAP_SIZE:
        return describe_missing_map(task)
    return f"the image_map of the layout has fewer than {MIN_MAP_SIZE} x {MIN_MAP_SIZE} cells"
