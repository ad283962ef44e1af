r"""The models of a comparison: their task, what each is and tries, and where it has no place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch.nn import Module

from torch_geometric_tactile._checks import Argument, ArgumentError, need_argument
from torch_geometric_tactile._user_modules import import_user_module
from torch_geometric_tactile.baselines._readings import num_repeats
from torch_geometric_tactile.experiments._building import find_class
from torch_geometric_tactile.experiments._compared_task import (
    MANY_TAXELS,
    ComparedTask,
    lacks_a_frame,
    lacks_a_large_map,
    lacks_a_map,
    lacks_a_pose,
    lacks_frames,
    lacks_many_frames,
)
from torch_geometric_tactile.experiments.tables import Cell
from torch_geometric_tactile.nn.models._calls import takes_batch
from torch_geometric_tactile.transforms import TaxelDescriptors

_MODELS = "torch_geometric_tactile.nn.models."
_BASELINES = "torch_geometric_tactile.baselines."
_MOST_SVM_SAMPLES = 10_000
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
    room: str = ""  # the module of the class; that of the user's own is in its name
    is_graph: bool = False
    lacks: Callable[[ComparedTask], str] = lambda task: ""
    most_taxels: int | None = None  # with more it is compared only if named, for its time

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
    room: str = _MODELS
    lr: float | None = None  # that of the recipe if left out
    is_posed: bool = False

    def _given(self, task: ComparedTask, settings: _Tried, arguments: _Arguments) -> dict[str, Any]:
        recipe = task.recipe
        optimizer = {
            "lr": recipe.lr if self.lr is None else self.lr,
            "weight_decay": recipe.weight_decay,
            "fused": True,
        }
        section: dict[str, Any] = {
            "model": {"class_path": f"{self.room}{self.class_name}", "init_args": arguments},
            "optimizer": {"class_path": "torch.optim.AdamW", "init_args": optimizer},
        }
        if task.numbers:
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
    room: str = _BASELINES
    sums_patches: bool = False  # of readings that are neither scaled nor filled
    centred: bool = True
    draft: _Arguments = field(default_factory=dict)  # while settings are compared

    def _given(self, task: ComparedTask, settings: _Tried, arguments: _Arguments) -> dict[str, Any]:
        scaled = not self.sums_patches
        form = {"scaled": scaled, "filled": scaled, "centred": self.centred}
        form["posed"] = self.sums_patches and task.posed
        path = f"{self.room}{self.class_name}"
        if self.room:
            arguments["task"] = "regression" if task.numbers else "multiclass"
        if self.room and task.metric == "balanced_accuracy" and self.name != FLOOR:
            arguments["class_weight"] = "balanced"
        return {
            "estimator": {"class_path": path, "init_args": arguments},
            "transform": task.transform(**form),
            "choice": task.choice(
                [_of_readings(task, form, setting) for setting in settings],
                is_estimator=True,
                draft={"init_args": self.draft} if self.draft else None,
            ),
        }


def _of_readings(task: ComparedTask, form: dict[str, bool], setting: dict[str, Any]) -> _Arguments:
    # A setting of an estimator, of which some are of the readings.
    of_readings = {*form, "rooted", "normalized"}
    over = {key: value for key, value in setting.items() if key in of_readings}
    arguments = {key: value for key, value in setting.items() if key not in over}
    found: _Arguments = {"init_args": arguments} if arguments or not over else {}
    return found | ({"transform": task.transform(**form | over)} if over else {})


def _decay(weight_decay: float, **arguments: Any) -> dict[str, Any]:
    setting: dict[str, Any] = {"optimizer": {"init_args": {"weight_decay": weight_decay}}}
    return {**setting, "model": {"init_args": arguments}} if arguments else setting


_LEAVES = [{}, {"min_samples_leaf": 4}]
_PLAIN_LEAVES: _Tried = [*_LEAVES, {"normalized": True}]
_LINEAR = [{"C": c} for c in (0.001, 0.01, 0.1, 1.0)] + [{"rooted": True, "C": 0.001}]
_RADIAL = [
    {"C": c, "width": width}
    for c, width in ((1.0, 1.0), (10.0, 1.0), (100.0, 1.0), (10.0, 0.3), (100.0, 0.3), (10.0, 3.0))
] + [{"C": 10.0, "width": 1.0, **over} for over in ({"rooted": True}, {"normalized": True})]
_DESCRIBED: _Tried = [
    {},
    {"C": 1.0},
    {"with_readings": True},
    {"rooted": True},
    {"with_readings": True, "rooted": True},
    {"centred": True},
    {"normalized": True},
]
_DESCRIBED_LEAVES: _Tried = [
    {},
    {"balanced": False},
    {"rooted": True},
    {"centred": True},
    {"normalized": True},
    {"normalized": True, "rooted": True},
    {"normalized": True, "rooted": True, "balanced": False},
]
_FEWER_TREES = {"num_trees": 100}
_TREES_OF_MANY = 150  # of samples or readings that are many
_RIDGE = [{"alpha": alpha} for alpha in (1.0, 0.1, 10.0, 100.0)]
_DROPOUT = [{}, _decay(0.1, dropout=0.5)]
_NO_TAXEL_DROPOUT = {"taxel_dropout": 0.0}  # where each taxel carries what no other does
_OPERATORS: _Tried = [
    {},
    {"model": {"init_args": _NO_TAXEL_DROPOUT}},
    {"model": {"init_args": {**_NO_TAXEL_DROPOUT, "conv": "self"}}},
]
# As a convolutional network: few convolutions, and pooling to a few taxels before the head.
PYRAMID = {
    "depth": 1,
    "max_taxels": 32,
    "head_taxels": 8,
    "direct_channels": 0,
    "dropout": 0.3,
    **_NO_TAXEL_DROPOUT,
}
_DEEP = {"max_taxels": 4, **_NO_TAXEL_DROPOUT}  # convolutions also on the few taxels
_WHOLE_WINDOW = {"pool": "mean", **_NO_TAXEL_DROPOUT}
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
_MORE_DECAY = [{}, _decay(0.5)]
_FINGERS_APART = {"model": {"init_args": {"fusion": "feature"}}}
_SIGNALS = [{"C": c} for c in (1.0, 0.1, 10.0, 100.0)]


def _described(task: ComparedTask) -> _Tried:
    # Descriptors of single frames beside what a network finds itself.
    if task.num_frames is not None:
        return []
    arguments = {"init_args": {"descriptor_channels": 64}}
    return [{"model": arguments, "transform": task.transform(centred=False)}]


def _normalized(task: ComparedTask) -> _Tried:
    # With many samples a network learns what strength means.
    return [{"transform": task.transform(normalized=True)}] if task.is_few else []


def _more_decay(task: ComparedTask) -> _Tried:
    return _MORE_DECAY if task.is_few else [{}]


def _taxel_net(task: ComparedTask) -> _Tried:
    if not task.is_image:
        return [*_OPERATORS, *_normalized(task), *_described(task)]
    pyramid = {"model": {"init_args": {**PYRAMID, "widths": task.cnn_widths}}}
    shifted = {**pyramid, "train_transform": task.shift()}
    if task.is_slow:  # one setting is trained
        return [shifted]
    deep = {"model": {"init_args": _DEEP}, "train_transform": task.shift()}
    if task.is_large:
        return [{}, shifted, deep, *_described(task)]
    unmirrored = [*_OPERATORS[:2], pyramid, shifted, deep]
    return [*unmirrored, *_mirrored(task, pyramid), *_normalized(task), *_described(task)]


def _cnn(task: ComparedTask) -> _Tried:
    if not task.is_image:
        return [*_DROPOUT, *_normalized(task)]
    shifted = {"train_transform": task.shift()}
    if task.is_slow:
        return [shifted]
    if task.is_large:
        return [{}, shifted]
    return [*_DROPOUT, shifted, *_mirrored(task, {}), *_normalized(task)]


def _mirrored(task: ComparedTask, setting: dict[str, Any]) -> _Tried:
    # Of shear, one channel would change its sign: which one is not known.
    if task.num_channels > 1 or not task.is_few:
        return []
    return [{**setting, "train_transform": task.shift(mirrored=True)}]


def _temporal(task: ComparedTask) -> _Tried:
    mixed = {"model": {"init_args": MIXED_TAXELS}}
    shifted = {**mixed, "train_transform": task.time_shift()}
    whole = {"model": {"init_args": _WHOLE_WINDOW}}
    if not task.is_few:
        return [{}, whole, mixed]
    return [*_OPERATORS[:2], whole, mixed, shifted, *_normalized(task)]


def _temporal_cnn(task: ComparedTask) -> _Tried:
    if not task.is_few:
        return [{}]
    return [{}, {"train_transform": task.time_shift()}, *_normalized(task)]


def _num_trees(task: ComparedTask) -> _Arguments:
    return {} if task.is_quick else {"num_trees": _TREES_OF_MANY}


def _described_leaves(task: ComparedTask) -> _Tried:
    # Without repeated descriptors, drawing features by their number is the default.
    assert task.layout is not None
    names = TaxelDescriptors(task.layout).names(of_windows=task.num_frames is not None)
    is_repeated = num_repeats(task.num_taxels * (task.num_frames or 1), len(names)) > 1
    return [s for s in _DESCRIBED_LEAVES if is_repeated or "balanced" not in s]


FLOOR = "constant"
MODELS: tuple[ComparedModel, ...] = (
    _Network(
        "taxel_net",
        "TaxelNet, the default graph model",
        "TaxelNet",
        _taxel_net,
        is_graph=True,
    ),
    _Network(
        "posed_taxel_net",
        "PosedTaxelNet, on taxels placed by the joint angles",
        "PosedTaxelNet",
        _DROPOUT,
        is_graph=True,
        is_posed=True,
        lacks=lacks_a_pose,
    ),
    _Network(
        "temporal",
        "TemporalTaxelNet, the graph model of windows and streams",
        "TemporalTaxelNet",
        _temporal,
        lambda task: {"num_blocks": task.num_blocks},
        is_graph=True,
        lacks=lacks_frames,
    ),
    _Network(
        "gcn",
        "TactileGCN, a plain GCN",
        "TactileGCN",
        _more_decay,
        {"widths": [32, 32], "pools": [1, 1], "head_widths": [128], "head_pools": [1]},
        is_graph=True,
        lr=1e-3,
        most_taxels=MANY_TAXELS,
    ),
    _Network(
        "grasp_gcn",
        "GraspGCN, a graph convolution on all frames of a taxel",
        "GraspGCN",
        lambda task: [*_more_decay(task), *([_FINGERS_APART] if task.num_channels > 1 else [])],
        is_graph=True,
        lr=1e-3,
        lacks=lacks_frames,
    ),
    _Network(
        "fnn",
        "TactileFNN, fully connected",
        "TactileFNN",
        lambda task: [*_more_decay(task), *_normalized(task)],
        {"widths": [256, 64], "pools": [1, 1]},
        lr=1e-3,
    ),
    _Network(
        "cnn",
        "SmallCNN, on the map of the layout",
        "SmallCNN",
        _cnn,
        lambda task: {"widths": task.cnn_widths},
        lacks=lacks_a_map,
    ),
    _Network(
        "bmf_cnn",
        "BMFCNN, bilinear features on the map of the layout",
        "BMFCNN",
        _more_decay,
        lr=1e-3,
        lacks=lacks_a_large_map,
        most_taxels=MANY_TAXELS,
    ),
    _Network(
        "lstm",
        "GraspLSTM, recurrent, on the readings of each frame",
        "GraspLSTM",
        _more_decay,
        lr=1e-3,
        lacks=lacks_frames,
    ),
    _Network(
        "temporal_cnn",
        "TemporalCNN, a residual network over time on the readings of each frame",
        "TemporalCNN",
        _temporal_cnn,
        lacks=lacks_frames,
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
        lacks=lacks_frames,
    ),
    _Estimator(
        "minirocket",
        "ridge on random convolutions of each window",
        "minirocket",
        arguments=lambda task: {"num_channels": task.num_channels},
        lacks=lacks_many_frames,
    ),
    _Estimator(
        "forest",
        "random forest on the readings",
        "flat_forest",
        _PLAIN_LEAVES,
        _num_trees,
        draft=_FEWER_TREES,
    ),
    _Estimator(
        "descriptors_svm",
        "support vector machine on descriptors of the layout",
        "descriptor_svm",
        _DESCRIBED,
        {"most_samples": _MOST_SVM_SAMPLES},
        centred=False,
    ),
    _Estimator(
        "descriptors_forest",
        "extra trees on descriptors of the layout and readings",
        "descriptor_forest",
        _described_leaves,
        _num_trees,
        centred=False,
        draft=_FEWER_TREES,
    ),
    _Estimator(
        "posed_forest",
        "random forest on sums of each patch",
        "posed_forest",
        _LEAVES,
        sums_patches=True,
        lacks=lacks_a_frame,
        draft=_FEWER_TREES,
    ),
    _Estimator(
        "posed_ridge",
        "ridge on sums of each patch",
        "posed_ridge",
        _RIDGE,
        sums_patches=True,
        lacks=lacks_a_frame,
    ),
    _Estimator(FLOOR, "most frequent class, or mean", "constant"),
)
_BY_NAME = {model.name: model for model in MODELS}


def chosen_models(names: Sequence[str] | None, task: ComparedTask) -> tuple[ComparedModel, ...]:
    r"""Returns models by their names, in the order of all, and then the user's own."""
    if names is None:
        size = task.num_taxels
        return tuple(
            model
            for model in MODELS
            if not what_it_lacks(model, task) and size <= (model.most_taxels or size)
        )
    check_model_names(names)
    for name in names:
        reason = what_it_lacks(model_of(name), task)
        if reason:
            raise ArgumentError(
                Argument("models"), f" must fit the data (got '{name}', but {reason})"
            )
    own = [model_of(name) for name in names if name not in _BY_NAME]
    return (*(model for model in MODELS if model.name in names), *own)


def what_it_lacks(model: ComparedModel, task: ComparedTask) -> str:
    r"""Tells what a model lacks in the data, if anything: of ours, all but the constant answer are
    for one layout, and so are rows of readings.
    """
    if task.layout is not None:
        return model.lacks(task)
    if model.name == FLOOR:
        return ""
    several = f"the samples, which have {task.several}, have no layout that all share"
    if model.name in _BY_NAME:
        return f"it is a model of one layout, and {several}"
    if isinstance(model, _Estimator):
        return f"it takes rows of readings of one sensor, and {several}"
    if not takes_batch(find_class(model.class_name)):
        return f"it is not called as forward(x, edge_index, batch), and {several}"
    return ""


def check_model_names(names: Sequence[str]) -> None:
    r"""Checks that names are those of models, or import paths."""
    known = f"must be some of {', '.join(_BY_NAME)}, or import paths of your own"
    unknown = [f"'{name}'" for name in names if name not in _BY_NAME and "." not in name]
    need_argument(names and not unknown, "models", known, unknown[0] if unknown else "none")


def model_of(name: str) -> ComparedModel:
    r"""Returns a model by its name, or by the import path of the user's own: a class of a network,
    or what returns an estimator of scikit-learn.
    """
    if name in _BY_NAME:
        return _BY_NAME[name]
    module, _, attribute = name.rpartition(".")
    try:
        found = getattr(import_user_module(module), attribute)
    except Exception as error:  # whatever a module raises that is imported
        text = str(error) if isinstance(error, AttributeError | ImportError) else repr(error)
        raise ArgumentError(
            Argument("models"),
            f" must be names of ours or import paths of your own (got '{name}': {text})",
        ) from error
    need_argument(
        callable(found),
        "models",
        f"must be names of ours, or import paths of a class or function of your own (got "
        f"'{name}', which is of type {type(found).__name__})",
    )
    title = f"{name}, a model of your own"
    if not (isinstance(found, type) and issubclass(found, Module)):
        return _Estimator(name, title, name, room="")
    return _Network(name, title, name, is_graph=getattr(found, "needs_edges", False), room="")
