r"""The models of a comparison: their task, what each is and tries, and where it has no place."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._encoder_models import encoder_arguments
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.experiments.tables import Cell
from torch_geometric_tactile.nn.models.bmf_cnn import LEAST_SIZE
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout
from torch_geometric_tactile.training.training_recipe import TrainingRecipe, training_recipe

_MODELS = "torch_geometric_tactile.nn.models."
_BASELINES = "torch_geometric_tactile.baselines."
_TRANSFORMS = "torch_geometric_tactile.transforms."
_ENCODERS = "torch_geometric_tactile.experiments._encoder_models."
_MOST_SVM_SAMPLES = 10_000
_MANY_TAXELS = 500  # above which a network is tried with one setting, for time
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
    encoder: dict[str, str] | None = None

    @classmethod
    def of(
        cls,
        dataset: StaticDataset,
        metric: str,
        part: float,
        num_frames: int | None = None,
        encoder: str | None = None,
        rest: Mapping[str, Any] | None = None,
        **more: Any,
    ) -> "ComparedTask":
        r"""Returns the task of a data set, of whose frames a rest may have been subtracted."""
        num_train = max(1, round(part * len(dataset)))
        width = dataset.batch(torch.tensor([0])).x.shape[-1]
        if encoder is not None:
            num_channels = width // (num_frames or 1)
            more["encoder"] = encoder_arguments(encoder, dataset.layout, num_channels, rest)
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
        self, *, scaled: bool, posed: bool = False, filled: bool = True, encoded: bool = False
    ) -> dict[str, Any]:
        r"""Returns what every batch goes through, as plain data."""
        steps = [] if self.tare is None else [_step("Tare", self.tare)]
        if encoded:
            steps.append({"class_path": f"{_ENCODERS}EncoderScale", "init_args": self.encoder})
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
    if joint is None or joint.dim() != 2 or joint.shape[1] != hand.num_joints or not is_stock:
        return False
    return len(layout.link_names) > 1 and set(layout.link_names) <= set(hand.link_names)


def _step(name: str, arguments: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"class_path": f"{_TRANSFORMS}{name}", "init_args": arguments or {}}


_Tried = Sequence[dict[str, Any]]
_Arguments = dict[str, Any]


@dataclass(frozen=True)
class ComparedModel:
    r"""A model of a comparison: its class, the settings that are tried, and its arguments. Both may
    follow from the task.
    """

    name: str
    title: str
    class_name: str
    settings: _Tried | Callable[[ComparedTask], _Tried] = ({},)
    arguments: _Arguments | Callable[[ComparedTask], _Arguments] = field(default_factory=dict)
    is_graph: bool = False
    lacks: Callable[[ComparedTask], str] = lambda task: ""

    def to_cell(self, task: ComparedTask) -> Cell:
        r"""Returns its place of a table."""
        settings = self.settings(task) if callable(self.settings) else self.settings
        arguments = self.arguments(task) if callable(self.arguments) else self.arguments
        given = self._given(task, settings, dict(arguments))
        return Cell(row=self.name, column="", experiment=self.name, **given)

    def _given(self, task: ComparedTask, settings: _Tried, arguments: _Arguments) -> dict[str, Any]:
        raise NotImplementedError


@dataclass(frozen=True)
class _Network(ComparedModel):
    lr: float | None = None  # that of the recipe if left out
    is_posed: bool = False
    is_encoder: bool = False

    def _given(self, task: ComparedTask, settings: _Tried, arguments: _Arguments) -> dict[str, Any]:
        recipe = task.recipe
        optimizer = {
            "lr": recipe.lr if self.lr is None else self.lr,
            "weight_decay": recipe.weight_decay,
            "fused": True,
        }
        section: dict[str, Any] = {
            "model": {"class_path": f"{self._room}{self.class_name}", "init_args": arguments},
            "optimizer": {"class_path": "torch.optim.AdamW", "init_args": optimizer},
        }
        if task.numbers:
            section |= {"task": "regression", "loss": "huber"}
        else:
            section["label_smoothing"] = recipe.label_smoothing
        if task.metric == "balanced_accuracy":
            section["class_weights"] = "balanced"
        transform = task.transform(
            scaled=not (self.is_posed or self.is_encoder),
            posed=self.is_posed,
            encoded=self.is_encoder,
        )
        config = {
            "model": section,
            "data": {"transform": transform, "batch_size": recipe.batch_size},
            "trainer": {"max_epochs": recipe.max_epochs},
        }
        few = settings[:1] if task.layout.num_taxels > _MANY_TAXELS else settings
        return {"config": config, "choice": task.choice(few)}

    @property
    def _room(self) -> str:
        return _ENCODERS if self.is_encoder else _MODELS


@dataclass(frozen=True)
class _Estimator(ComparedModel):
    sums_patches: bool = False  # of readings that are neither scaled nor filled
    is_encoder: bool = False  # which scales itself

    def _given(self, task: ComparedTask, settings: _Tried, arguments: _Arguments) -> dict[str, Any]:
        scaled = not (self.sums_patches or self.is_encoder)
        room = _ENCODERS if self.is_encoder else _BASELINES
        arguments["task"] = "regression" if task.numbers else "multiclass"
        if task.metric == "balanced_accuracy" and self.name != FLOOR:
            arguments["class_weight"] = "balanced"
        return {
            "estimator": {"class_path": f"{room}{self.class_name}", "init_args": arguments},
            "transform": task.transform(
                scaled=scaled,
                posed=self.sums_patches and task.posed,
                filled=scaled,
            ),
            "choice": task.choice([{"init_args": setting} for setting in settings]),
        }


def _decay(weight_decay: float, **arguments: Any) -> dict[str, Any]:
    setting: dict[str, Any] = {"optimizer": {"init_args": {"weight_decay": weight_decay}}}
    return {**setting, "model": {"init_args": arguments}} if arguments else setting


_LEAVES = [{}, {"min_samples_leaf": 4}]
_LINEAR = [{"C": c} for c in (0.001, 0.01, 0.1, 1.0)]
_RADIAL = [
    {"C": c, "width": width}
    for c, width in ((1.0, 1.0), (10.0, 1.0), (100.0, 1.0), (10.0, 0.3), (100.0, 0.3), (10.0, 3.0))
]
_DESCRIBED = [
    {"C": c, "with_readings": readings} for readings in (False, True) for c in (10.0, 1.0, 100.0)
]
_RIDGE = [{"alpha": alpha} for alpha in (1.0, 0.1, 10.0, 100.0)]
_DROPOUT = [{}, _decay(0.1, dropout=0.5)]
_NO_TAXEL_DROPOUT = {"taxel_dropout": 0.0}  # where each taxel carries what no other does
_OPERATORS: _Tried = [
    {},
    {"model": {"init_args": _NO_TAXEL_DROPOUT}},
    {"model": {"init_args": {**_NO_TAXEL_DROPOUT, "conv": "self"}}},
]
_DESCRIBED_TOO: _Tried = [*_OPERATORS, {"model": {"init_args": {"descriptor_channels": 64}}}]
_MORE_DECAY = [{}, _decay(0.5)]
_FINGERS_APART = {"model": {"init_args": {"fusion": "feature"}}}
_SIGNALS = [{"C": c} for c in (1.0, 0.1, 10.0, 100.0)]


def _num_blocks(num_frames: int) -> int:
    # Of TemporalTaxelNet, so that its answer rests on all frames, which may be more than 64.
    return max(2, math.ceil(math.log2(num_frames / 16)))


def _lacks_frames(task: ComparedTask) -> str:
    if task.num_frames is not None:
        return ""
    return "the samples are single frames: cut windows ('window') or whole trials ('trials')"


def _lacks_a_frame(task: ComparedTask) -> str:
    return "" if task.num_frames is None else "it is for single frames, and the samples have more"


def _lacks_a_pose(task: ComparedTask) -> str:
    return _lacks_a_frame(task) or (
        "" if task.posed else "the taxels are not placed by joint angles"
    )


def _lacks_an_encoder(task: ComparedTask) -> str:
    return "" if task.encoder is not None else "no encoder is given ('encoder')"


def _lacks_an_encoder_of_frames(task: ComparedTask) -> str:
    return _lacks_an_encoder(task) or _lacks_a_frame(task)


def _lacks_a_map(task: ComparedTask) -> str:
    return "" if task.layout.image_map is not None else "the layout has no image_map"


def _lacks_a_large_map(task: ComparedTask) -> str:
    image_map = task.layout.image_map
    if image_map is None or int(image_map.amax(dim=0).min()) + 1 >= LEAST_SIZE:
        return _lacks_a_map(task)
    return f"the image_map of the layout has fewer than {LEAST_SIZE} x {LEAST_SIZE} cells"


FLOOR = "constant"
MODELS: tuple[ComparedModel, ...] = (
    _Network(
        "taxel_net",
        "TaxelNet, the default graph model",
        "TaxelNet",
        lambda task: _DESCRIBED_TOO if task.num_frames is None else _OPERATORS,
        is_graph=True,
    ),
    _Network(
        "posed_taxel_net",
        "PosedTaxelNet, on taxels placed by the joint angles",
        "PosedTaxelNet",
        _DROPOUT,
        is_graph=True,
        is_posed=True,
        lacks=_lacks_a_pose,
    ),
    _Network(
        "temporal",
        "TemporalTaxelNet, the default for windows of frames",
        "TemporalTaxelNet",
        _OPERATORS,
        lambda task: {"num_blocks": _num_blocks(task.num_frames or 1)},
        is_graph=True,
        lacks=_lacks_frames,
    ),
    _Network(
        "gcn",
        "TactileGCN, a plain GCN",
        "TactileGCN",
        _MORE_DECAY,
        {"widths": [32, 32], "pools": [1, 1], "head_widths": [128], "head_pools": [1]},
        is_graph=True,
        lr=1e-3,
    ),
    _Network(
        "grasp_gcn",
        "GraspGCN, a graph convolution on all frames of a taxel",
        "GraspGCN",
        lambda task: [*_MORE_DECAY, _FINGERS_APART] if task.num_channels > 1 else _MORE_DECAY,
        is_graph=True,
        lr=1e-3,
        lacks=_lacks_frames,
    ),
    _Network(
        "fnn",
        "TactileFNN, fully connected",
        "TactileFNN",
        _MORE_DECAY,
        {"widths": [256, 64], "pools": [1, 1]},
        lr=1e-3,
    ),
    _Network("cnn", "SmallCNN, on the map of the layout", "SmallCNN", _DROPOUT, lacks=_lacks_a_map),
    _Network(
        "bmf_cnn",
        "BMFCNN, bilinear features on the map of the layout",
        "BMFCNN",
        _MORE_DECAY,
        lr=1e-3,
        lacks=_lacks_a_large_map,
    ),
    _Network(
        "lstm",
        "GraspLSTM, recurrent, on the readings of each frame",
        "GraspLSTM",
        _MORE_DECAY,
        lr=1e-3,
        lacks=_lacks_frames,
    ),
    _Estimator(
        "svm_rbf",
        "support vector machine, radial kernel",
        "rbf_svm",
        _RADIAL,
        {"most_samples": _MOST_SVM_SAMPLES},
    ),
    _Estimator("svm_linear", "support vector machine, linear", "linear_svm", _LINEAR),
    _Estimator(
        "svm_signal",
        "support vector machine on 12 statistical features of each signal",
        "signal_svm",
        _SIGNALS,
        lambda task: {"num_channels": task.num_channels, "most_samples": _MOST_SVM_SAMPLES},
        lacks=_lacks_frames,
    ),
    _Estimator("forest", "random forest on the readings", "flat_forest", _LEAVES),
    _Estimator(
        "descriptors_svm",
        "support vector machine on descriptors of the layout",
        "descriptor_svm",
        _DESCRIBED,
        {"most_samples": _MOST_SVM_SAMPLES},
    ),
    _Estimator(
        "descriptors_forest",
        "random forest on descriptors of the layout and readings",
        "descriptor_forest",
        _LEAVES,
    ),
    _Estimator(
        "encoder_forest",
        "random forest on a pretrained encoder, descriptors and readings",
        "encoder_forest",
        _LEAVES,
        lambda task: {**(task.encoder or {})},
        is_encoder=True,
        lacks=_lacks_an_encoder,
    ),
    _Estimator(
        "encoder_svm",
        "support vector machine on a pretrained encoder and descriptors",
        "encoder_svm",
        _DESCRIBED,
        lambda task: {**(task.encoder or {}), "most_samples": _MOST_SVM_SAMPLES},
        is_encoder=True,
        lacks=_lacks_an_encoder,
    ),
    _Network(
        "encoder_tuned",
        "a pretrained encoder, trained further with the labels",
        "TunedEncoder",
        arguments=lambda task: {**(task.encoder or {})},
        is_graph=True,
        lr=1e-3,
        is_encoder=True,
        lacks=_lacks_an_encoder_of_frames,
    ),
    _Estimator(
        "posed_forest",
        "random forest on sums of each patch",
        "posed_forest",
        _LEAVES,
        sums_patches=True,
        lacks=_lacks_a_frame,
    ),
    _Estimator(
        "posed_ridge",
        "ridge on sums of each patch",
        "posed_ridge",
        _RIDGE,
        sums_patches=True,
        lacks=_lacks_a_frame,
    ),
    _Estimator(FLOOR, "most frequent class, or mean", "constant"),
)
_BY_NAME = {model.name: model for model in MODELS}


def chosen_models(names: Sequence[str] | None, task: ComparedTask) -> tuple[ComparedModel, ...]:
    r"""Returns models by their names, in the order of all."""
    if names is None:
        return tuple(model for model in MODELS if not model.lacks(task))
    check_model_names(names)
    for name in names:
        reason = _BY_NAME[name].lacks(task)
        if reason:
            raise ValueError(f"'models' must fit the data (got '{name}', but {reason})")
    return tuple(model for model in MODELS if model.name in names)


def check_model_names(names: Sequence[str]) -> None:
    r"""Checks that there are models of some names."""
    unknown = [name for name in names if name not in _BY_NAME]
    if unknown or not names:
        got = f"'{unknown[0]}'" if unknown else "none"
        raise ValueError(f"'models' must be some of {', '.join(_BY_NAME)} (got {got})")


def model_of(name: str) -> ComparedModel:
    r"""Returns a model by its name."""
    return _BY_NAME[name]
