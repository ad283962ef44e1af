r"""The models of a comparison, with their candidate settings and requirements on the data."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch.nn import Module

from torch_geometric_tactile._checks import Argument, ArgumentError, need_argument
from torch_geometric_tactile._user_modules import import_user_module
from torch_geometric_tactile.baselines._readings import num_repeats
from torch_geometric_tactile.experiments._building import find_class
from torch_geometric_tactile.experiments._compared_task import (
    LARGE_SENSOR_TAXELS,
    ComparedTask,
    describe_frame_obstacle,
    describe_minirocket_obstacle,
    describe_missing_map,
    describe_missing_pose,
    describe_missing_windows,
    describe_small_map,
)
from torch_geometric_tactile.experiments.tables import Cell
from torch_geometric_tactile.nn.models._calls import takes_batch
from torch_geometric_tactile.transforms import TaxelDescriptors

_MODELS = "torch_geometric_tactile.nn.models."
_BASELINES = "torch_geometric_tactile.baselines."
_MAX_SVM_SAMPLES = 10_000  # the training time of a kernel grows with the square of this number
_Candidates = Sequence[dict[str, Any]]
_Arguments = dict[str, Any]


@dataclass(frozen=True)
class ComparedModel:
    r"""A model of a comparison.

    Args:
        name (str): Name of the model in commands and results.
        title (str): Description for reports.
        class_name (str): Name of the class, or import path of a user's model.
        settings (sequence of dict or callable): The candidate settings, the default first, or a
            function that returns them for a task.
        arguments (dict or callable): Arguments of the class, or a function that returns them for a
            task.
        module_prefix (str): The module of the class with a final dot; empty for an import path.
        is_graph (bool): Whether the model reads edges.
        obstacle (callable): Returns why the model cannot be compared on a task, or an empty text if
            it can.
        max_taxels (int, optional): With more taxels, the model is compared only if it is named,
            because its training takes long.
    """

    name: str
    title: str
    class_name: str
    settings: _Candidates | Callable[[ComparedTask], _Candidates] = ({},)
    arguments: _Arguments | Callable[[ComparedTask], _Arguments] = field(default_factory=dict)
    module_prefix: str = ""
    is_graph: bool = False
    obstacle: Callable[[ComparedTask], str] = lambda task: ""
    max_taxels: int | None = None

    def to_cell(self, task: ComparedTask) -> Cell:
        r"""Returns the cell of the model in the table of a comparison."""
        settings = self.settings(task) if callable(self.settings) else self.settings
        arguments = self.arguments(task) if callable(self.arguments) else self.arguments
        cell_arguments = self._cell_arguments(task, settings, dict(arguments))
        return Cell(row=self.name, column="", experiment=self.name, **cell_arguments)

    def _cell_arguments(
        self, task: ComparedTask, settings: _Candidates, arguments: _Arguments
    ) -> dict[str, Any]:
        raise NotImplementedError


@dataclass(frozen=True)
class _Network(ComparedModel):
    module_prefix: str = _MODELS
    lr: float | None = None  # of the training recipe if None
    is_posed: bool = False

    def _cell_arguments(
        self, task: ComparedTask, settings: _Candidates, arguments: _Arguments
    ) -> dict[str, Any]:
        recipe = task.recipe
        optimizer = {
            "lr": recipe.lr if self.lr is None else self.lr,
            "weight_decay": recipe.weight_decay,
            "fused": True,
        }
        section: dict[str, Any] = {
            "model": {
                "class_path": f"{self.module_prefix}{self.class_name}",
                "init_args": arguments,
            },
            "optimizer": {"class_path": "torch.optim.AdamW", "init_args": optimizer},
        }
        if task.is_regression:
            section |= {"task": "regression", "loss": "huber"}
        else:
            section["label_smoothing"] = recipe.label_smoothing
        if task.metric == "balanced_accuracy":
            section["class_weights"] = "balanced"
        transform = task.transform(scaled=not self.is_posed, posed=self.is_posed)
        config = {
            "model": section,
            "data": {"transform": transform, "batch_size": recipe.batch_size},
            "trainer": {"max_epochs": recipe.max_epochs},
        }
        return {"config": config, "choice": task.choice(settings)}


@dataclass(frozen=True)
class _Estimator(ComparedModel):
    module_prefix: str = _BASELINES
    sums_patches: bool = False  # reads sums of patches, which need unscaled readings
    centred: bool = True
    draft: _Arguments = field(default_factory=dict)  # arguments while settings are compared

    def _cell_arguments(
        self, task: ComparedTask, settings: _Candidates, arguments: _Arguments
    ) -> dict[str, Any]:
        scaled = not self.sums_patches
        options = {"scaled": scaled, "filled": scaled, "centred": self.centred}
        options["posed"] = self.sums_patches and task.has_pose
        path = f"{self.module_prefix}{self.class_name}"
        if self.module_prefix:  # the user's models need not have these arguments
            arguments["task"] = "regression" if task.is_regression else "multiclass"
        if self.module_prefix and task.metric == "balanced_accuracy" and self.name != FLOOR:
            arguments["class_weight"] = "balanced"
        return {
            "estimator": {"class_path": path, "init_args": arguments},
            "transform": task.transform(**options),
            "choice": task.choice(
                [_estimator_setting(task, options, setting) for setting in settings],
                is_estimator=True,
                draft={"init_args": self.draft} if self.draft else None,
            ),
        }


def _estimator_setting(
    task: ComparedTask, options: dict[str, bool], setting: dict[str, Any]
) -> _Arguments:
    # Returns a setting as plain data. Options of the transform replace the entire transform.
    option_names = {*options, "square_root", "normalized"}
    overrides = {key: value for key, value in setting.items() if key in option_names}
    arguments = {key: value for key, value in setting.items() if key not in overrides}
    content: _Arguments = {"init_args": arguments} if arguments or not overrides else {}
    return content | ({"transform": task.transform(**options | overrides)} if overrides else {})


def _weight_decay_setting(weight_decay: float, **arguments: Any) -> dict[str, Any]:
    setting: dict[str, Any] = {"optimizer": {"init_args": {"weight_decay": weight_decay}}}
    return {**setting, "model": {"init_args": arguments}} if arguments else setting


_LEAF_CANDIDATES = [{}, {"min_samples_leaf": 4}]
_FOREST_CANDIDATES: _Candidates = [*_LEAF_CANDIDATES, {"normalized": True}]
_LINEAR_SVM_CANDIDATES = [{"C": c} for c in (0.001, 0.01, 0.1, 1.0)] + [
    {"square_root": True, "C": 0.001}
]
_RBF_SVM_CANDIDATES = [
    {"C": c, "width": width}
    for c, width in ((1.0, 1.0), (10.0, 1.0), (100.0, 1.0), (10.0, 0.3), (100.0, 0.3), (10.0, 3.0))
] + [
    {"C": 10.0, "width": 1.0, **option} for option in ({"square_root": True}, {"normalized": True})
]
_DESCRIPTOR_SVM_CANDIDATES: _Candidates = [
    {},
    {"C": 1.0},
    {"with_readings": True},
    {"square_root": True},
    {"with_readings": True, "square_root": True},
    {"centred": True},
    {"normalized": True},
]
_DESCRIPTOR_FOREST_CANDIDATES: _Candidates = [
    {},
    {"balanced": False},
    {"square_root": True},
    {"centred": True},
    {"normalized": True},
    {"normalized": True, "square_root": True},
    {"normalized": True, "square_root": True, "balanced": False},
]
_DRAFT_TREES = {"num_trees": 100}
_NUM_TREES_LARGE = 150  # for many samples or readings, when each tree takes long
_RIDGE_CANDIDATES = [{"alpha": alpha} for alpha in (1.0, 0.1, 10.0, 100.0)]
_DROPOUT_CANDIDATES = [{}, _weight_decay_setting(0.1, dropout=0.5)]
_NO_TAXEL_DROPOUT = {"taxel_dropout": 0.0}  # if each taxel has unique information
_OPERATOR_CANDIDATES: _Candidates = [
    {},
    {"model": {"init_args": _NO_TAXEL_DROPOUT}},
    {"model": {"init_args": {**_NO_TAXEL_DROPOUT, "conv": "self"}}},
]
# TaxelNet like a CNN for images: convolutions, then pooling to eight taxels before the head.
PYRAMID = {
    "depth": 1,
    "max_taxels": 32,
    "head_taxels": 8,
    "direct_channels": 0,
    "dropout": 0.3,
    **_NO_TAXEL_DROPOUT,
}
_DEEP_PYRAMID = {"max_taxels": 4, **_NO_TAXEL_DROPOUT}  # convolutions down to four taxels
_MEAN_OVER_FRAMES = {"pool": "mean", **_NO_TAXEL_DROPOUT}
MIXED_TAXELS = {
    "pool": "mean_max",
    "mixed_channels": 128,
    "num_filters": None,
    "widths": [16],
    "kernel_size": 5,
    "dilation": 1,
    "num_blocks": 3,
    "hidden_channels": None,
    "dropout": 0.0,
    **_NO_TAXEL_DROPOUT,
}
_WEIGHT_DECAY_CANDIDATES = [{}, _weight_decay_setting(0.5)]
_FEATURE_FUSION = {"model": {"init_args": {"fusion": "feature"}}}
_SIGNAL_SVM_CANDIDATES = [{"C": c} for c in (1.0, 0.1, 10.0, 100.0)]


def _descriptor_candidates(task: ComparedTask) -> _Candidates:
    # Descriptors of single frames, in addition to the features that the network learns.
    if task.num_frames is not None:
        return []
    arguments = {"init_args": {"descriptor_channels": 64}}
    return [{"model": arguments, "transform": task.transform(centred=False)}]


def _normalized_candidates(task: ComparedTask) -> _Candidates:
    # Only for small training parts: with many samples, a network learns the role of strength.
    return [{"transform": task.transform(normalized=True)}] if task.has_few_samples else []


def _weight_decay_candidates(task: ComparedTask) -> _Candidates:
    return _WEIGHT_DECAY_CANDIDATES if task.has_few_samples else [{}]


def _taxel_net_candidates(task: ComparedTask) -> _Candidates:
    if not task.is_image:
        return [*_OPERATOR_CANDIDATES, *_normalized_candidates(task), *_descriptor_candidates(task)]
    pyramid = {"model": {"init_args": {**PYRAMID, "widths": task.cnn_widths}}}
    shifted = {**pyramid, "train_transform": task.shift()}
    if task.is_slow:  # only the first setting is trained
        return [shifted]
    deep = {"model": {"init_args": _DEEP_PYRAMID}, "train_transform": task.shift()}
    if task.has_many_taxels:
        return [{}, shifted, deep, *_descriptor_candidates(task)]
    unmirrored = [*_OPERATOR_CANDIDATES[:2], pyramid, shifted, deep]
    return [
        *unmirrored,
        *_mirrored_candidates(task, pyramid),
        *_normalized_candidates(task),
        *_descriptor_candidates(task),
    ]


def _cnn_candidates(task: ComparedTask) -> _Candidates:
    if not task.is_image:
        return [*_DROPOUT_CANDIDATES, *_normalized_candidates(task)]
    shifted = {"train_transform": task.shift()}
    if task.is_slow:
        return [shifted]
    if task.has_many_taxels:
        return [{}, shifted]
    return [
        *_DROPOUT_CANDIDATES,
        shifted,
        *_mirrored_candidates(task, {}),
        *_normalized_candidates(task),
    ]


def _mirrored_candidates(task: ComparedTask, setting: dict[str, Any]) -> _Candidates:
    # Only for one channel: mirroring would change the sign of one shear channel, and it is not
    # known which one.
    if task.num_channels > 1 or not task.has_few_samples:
        return []
    return [{**setting, "train_transform": task.shift(mirrored=True)}]


def _temporal_candidates(task: ComparedTask) -> _Candidates:
    mixed = {"model": {"init_args": MIXED_TAXELS}}
    shifted = {**mixed, "train_transform": task.time_shift()}
    averaged = {"model": {"init_args": _MEAN_OVER_FRAMES}}
    if not task.has_few_samples:
        return [{}, averaged, mixed]
    return [*_OPERATOR_CANDIDATES[:2], averaged, mixed, shifted, *_normalized_candidates(task)]


def _temporal_cnn_candidates(task: ComparedTask) -> _Candidates:
    if not task.has_few_samples:
        return [{}]
    return [{}, {"train_transform": task.time_shift()}, *_normalized_candidates(task)]


def _tree_arguments(task: ComparedTask) -> _Arguments:
    return {} if task.is_quick else {"num_trees": _NUM_TREES_LARGE}


def _descriptor_forest_candidates(task: ComparedTask) -> _Candidates:
    # Forests repeat descriptors if there are more readings than descriptors, so that trees draw
    # both equally often. Without repetition, the setting that turns it off equals the default.
    assert task.layout is not None
    names = TaxelDescriptors(task.layout).names(of_windows=task.num_frames is not None)
    is_repeated = num_repeats(task.num_taxels * (task.num_frames or 1), len(names)) > 1
    return [s for s in _DESCRIPTOR_FOREST_CANDIDATES if is_repeated or "balanced" not in s]


FLOOR = "constant"
MODELS: tuple[ComparedModel, ...] = (
    _Network(
        "taxel_net",
        "TaxelNet, the default graph model",
        "TaxelNet",
        _taxel_net_candidates,
        is_graph=True,
    ),
    _Network(
        "posed_taxel_net",
        "PosedTaxelNet, on taxels placed by the joint angles",
        "PosedTaxelNet",
        _DROPOUT_CANDIDATES,
        is_graph=True,
        is_posed=True,
        obstacle=describe_missing_pose,
    ),
    _Network(
        "temporal",
        "TemporalTaxelNet, the graph model of windows and streams",
        "TemporalTaxelNet",
        _temporal_candidates,
        lambda task: {"num_blocks": task.num_blocks},
        is_graph=True,
        obstacle=describe_missing_windows,
    ),
    _Network(
        "gcn",
        "TactileGCN, a plain GCN",
        "TactileGCN",
        _weight_decay_candidates,
        {"widths": [32, 32], "pools": [1, 1], "head_widths": [128], "head_pools": [1]},
        is_graph=True,
        lr=1e-3,
        max_taxels=LARGE_SENSOR_TAXELS,
    ),
    _Network(
        "grasp_gcn",
        "GraspGCN, a graph convolution on all frames of a taxel",
        "GraspGCN",
        lambda task: [
            *_weight_decay_candidates(task),
            *([_FEATURE_FUSION] if task.num_channels > 1 else []),
        ],
        is_graph=True,
        lr=1e-3,
        obstacle=describe_missing_windows,
    ),
    _Network(
        "fnn",
        "TactileFNN, fully connected",
        "TactileFNN",
        lambda task: [*_weight_decay_candidates(task), *_normalized_candidates(task)],
        {"widths": [256, 64], "pools": [1, 1]},
        lr=1e-3,
    ),
    _Network(
        "cnn",
        "SmallCNN, on the map of the layout",
        "SmallCNN",
        _cnn_candidates,
        lambda task: {"widths": task.cnn_widths},
        obstacle=describe_missing_map,
    ),
    _Network(
        "bmf_cnn",
        "BMFCNN, bilinear features on the map of the layout",
        "BMFCNN",
        _weight_decay_candidates,
        lr=1e-3,
        obstacle=describe_small_map,
        max_taxels=LARGE_SENSOR_TAXELS,
    ),
    _Network(
        "lstm",
        "GraspLSTM, recurrent, on the readings of each frame",
        "GraspLSTM",
        _weight_decay_candidates,
        lr=1e-3,
        obstacle=describe_missing_windows,
    ),
    _Network(
        "temporal_cnn",
        "TemporalCNN, a residual network over time on the readings of each frame",
        "TemporalCNN",
        _temporal_cnn_candidates,
        obstacle=describe_missing_windows,
    ),
    _Estimator(
        "svm_rbf",
        "support vector machine, radial kernel",
        "rbf_svm",
        _RBF_SVM_CANDIDATES,
        {"most_samples": _MAX_SVM_SAMPLES},
    ),
    _Estimator(
        "svm_linear", "support vector machine, linear", "linear_svm", _LINEAR_SVM_CANDIDATES
    ),
    _Estimator(
        "svm_signal",
        "support vector machine on 12 statistical features of each signal",
        "signal_svm",
        _SIGNAL_SVM_CANDIDATES,
        lambda task: {"num_channels": task.num_channels, "most_samples": _MAX_SVM_SAMPLES},
        obstacle=describe_missing_windows,
    ),
    _Estimator(
        "minirocket",
        "ridge on random convolutions of each window",
        "minirocket",
        arguments=lambda task: {"num_channels": task.num_channels},
        obstacle=describe_minirocket_obstacle,
    ),
    _Estimator(
        "forest",
        "random forest on the readings",
        "flat_forest",
        _FOREST_CANDIDATES,
        _tree_arguments,
        draft=_DRAFT_TREES,
    ),
    _Estimator(
        "descriptors_svm",
        "support vector machine on descriptors of the layout",
        "descriptor_svm",
        _DESCRIPTOR_SVM_CANDIDATES,
        {"most_samples": _MAX_SVM_SAMPLES},
        centred=False,
    ),
    _Estimator(
        "descriptors_forest",
        "extra trees on descriptors of the layout and readings",
        "descriptor_forest",
        _descriptor_forest_candidates,
        _tree_arguments,
        centred=False,
        draft=_DRAFT_TREES,
    ),
    _Estimator(
        "posed_forest",
        "random forest on sums of each patch",
        "posed_forest",
        _LEAF_CANDIDATES,
        sums_patches=True,
        obstacle=describe_frame_obstacle,
        draft=_DRAFT_TREES,
    ),
    _Estimator(
        "posed_ridge",
        "ridge on sums of each patch",
        "posed_ridge",
        _RIDGE_CANDIDATES,
        sums_patches=True,
        obstacle=describe_frame_obstacle,
    ),
    _Estimator(FLOOR, "most frequent class, or mean", "constant"),
)
_BY_NAME = {model.name: model for model in MODELS}


def select_models(names: Sequence[str] | None, task: ComparedTask) -> tuple[ComparedModel, ...]:
    r"""Returns models by their names, with the stock models first in a fixed order.

    Args:
        names (sequence of str, optional): Names, or import paths of the user's models. Defaults to
            all stock models that fit the task and are not too slow for its number of taxels.
        task (ComparedTask): The task.

    Raises:
        ValueError: If a name is unknown, or a named model does not fit the data.
    """
    if names is None:
        size = task.num_taxels
        return tuple(
            model
            for model in MODELS
            if not describe_obstacle(model, task) and size <= (model.max_taxels or size)
        )
    check_model_names(names)
    for name in names:
        reason = describe_obstacle(find_model(name), task)
        if reason:
            raise ArgumentError(
                Argument("models"), f" must fit the data (got '{name}', but {reason})"
            )
    user_models = [find_model(name) for name in names if name not in _BY_NAME]
    return (*(model for model in MODELS if model.name in names), *user_models)


def describe_obstacle(model: ComparedModel, task: ComparedTask) -> str:
    r"""Returns why a model cannot be compared on a task, or an empty text if it can. Without a
    common layout, only the constant answer and a user's networks for PyG batches can be compared.
    """
    if task.layout is not None:
        return model.obstacle(task)
    if model.name == FLOOR:
        return ""
    layouts = f"the samples, which have {task.taxel_counts}, share no layout"
    if model.name in _BY_NAME:
        return f"it needs one layout, and {layouts}"
    if isinstance(model, _Estimator):
        return f"it reads rows of readings from one sensor, and {layouts}"
    if not takes_batch(find_class(model.class_name)):
        return f"it is not called as forward(x, edge_index, batch), and {layouts}"
    return ""


def check_model_names(names: Sequence[str]) -> None:
    r"""Checks that each name is the name of a stock model or an import path.

    Raises:
        ValueError: If a name is neither, or there are no names.
    """
    requirement = f"must be some of {', '.join(_BY_NAME)}, or import paths of your own models"
    unknown = [f"'{name}'" for name in names if name not in _BY_NAME and "." not in name]
    need_argument(names and not unknown, "models", requirement, unknown[0] if unknown else "none")


def find_model(name: str) -> ComparedModel:
    r"""Returns a stock model by its name, or a user's model by its import path. A user's model is a
    network class, or a class or function that returns a scikit-learn estimator.

    Raises:
        ValueError: If it cannot be imported, or is not callable.
    """
    if name in _BY_NAME:
        return _BY_NAME[name]
    module, _, attribute = name.rpartition(".")
    try:
        constructor = getattr(import_user_module(module), attribute)
    except Exception as error:  # importing runs the user's code, which may raise anything
        text = str(error) if isinstance(error, AttributeError | ImportError) else repr(error)
        raise ArgumentError(
            Argument("models"),
            f" must be names of stock models or import paths of your own models (got '{name}': "
            f"{text})",
        ) from error
    need_argument(
        callable(constructor),
        "models",
        f"must be names of stock models, or import paths of your own classes or functions (got "
        f"'{name}', which is of type {type(constructor).__name__})",
    )
    title = f"{name}, your own model"
    if not (isinstance(constructor, type) and issubclass(constructor, Module)):
        return _Estimator(name, title, name, module_prefix="")
    is_graph = getattr(constructor, "needs_edges", False)
    return _Network(name, title, name, is_graph=is_graph, module_prefix="")
