r"""The models of a comparison: what each is, what is tried, and where it has no place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments.choice import Choice
from torch_geometric_tactile.experiments.tables import Cell
from torch_geometric_tactile.nn.models.training_recipe import TrainingRecipe, training_recipe
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, stock_layout

_MODELS = "torch_geometric_tactile.nn.models."
_BASELINES = "torch_geometric_tactile.baselines."
_TRANSFORMS = "torch_geometric_tactile.transforms."
_MOST_SVM_SAMPLES = 10_000
_MANY_TAXELS = 500  # above which a network is tried with one setting, for time

Settings = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Task:
    r"""What the models of a comparison have to do.

    Args:
        layout (TaxelLayout): The taxels.
        metric (str): What is compared: see :class:`Choice`.
        num_train (int): Number of samples that a model is trained on, about.
        posed (bool): Whether the taxels can be placed by joint angles.
        epochs (int, optional): Epochs of a network; by the number of samples if left out.
        tare (dict, optional): Arguments of :class:`~torch_geometric_tactile.transforms.Tare`, if
            the samples have readings at rest.
        members (int): How many networks are averaged: see :class:`Choice`.
    """

    layout: TaxelLayout
    metric: str
    num_train: int
    posed: bool = False
    epochs: int | None = None
    tare: dict[str, Any] | None = None
    members: int = 1

    @classmethod
    def of(cls, dataset: StaticDataset, metric: str, part: float, **more: Any) -> "Task":
        r"""Returns the task of a data set.

        Args:
            dataset (StaticDataset): The samples.
            metric (str): What is compared.
            part (float): Which part of the samples is trained on.
            **more: Further arguments.
        """
        num_train = max(1, round(part * len(dataset)))
        return cls(dataset.layout, metric, num_train, _can_be_posed(dataset), **more)

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
        r"""Returns what is chosen for a model.

        Args:
            settings (sequence of dict): The settings that are tried.
        """
        return Choice(settings, self.metric, self.members)

    def transform(
        self, *, scaled: bool, posed: bool = False, filled: bool = True
    ) -> dict[str, Any]:
        r"""Returns what every batch goes through, as plain data.

        Args:
            scaled (bool): Whether taxels are centred and channels scaled; what is posed keeps its
                directions.
            posed (bool): Whether taxels are placed by joint angles.
            filled (bool): Whether missing readings become zero.
        """
        steps = [] if self.tare is None else [_step("Tare", self.tare)]
        if scaled:
            steps.append(_step("ZScore", {"scale_per": "channel"}))
        if filled:
            steps.append(_step("FillMissing"))
        if posed:
            steps.append(_step("TaxelPose", {"layout": self.layout.name, "tangent": True}))
        return {
            "class_path": "torch_geometric.transforms.Compose",
            "init_args": {"transforms": steps},
        }


@dataclass(frozen=True)
class ComparedModel:
    r"""A model of a comparison.

    Args:
        name (str): What a user calls it.
        title (str): What it is, in a few words.
        is_graph (bool): Whether it is one of ours, which sees the layout as a graph or as places.
        cell (callable): Its place of a table, by name, title and task.
        lacks (callable): Why it has no place in a task; empty if it has.
    """

    name: str
    title: str
    is_graph: bool
    cell: Callable[[Task], dict[str, Any]]
    lacks: Callable[[Task], str] = lambda task: ""

    def to_cell(self, task: Task) -> Cell:
        r"""Returns its place of a table.

        Args:
            task (Task): What it has to do.
        """
        return Cell(row=self.name, column="", experiment=self.name, **self.cell(task))


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


def _network(
    task: Task,
    name: str,
    settings: Settings,
    *,
    lr: float | None = None,
    scaled: bool = True,
    **arguments: Any,
) -> dict[str, Any]:
    recipe = task.recipe
    section: dict[str, Any] = {
        "model": {"class_path": f"{_MODELS}{name}", "init_args": arguments},
        "optimizer": {
            "class_path": "torch.optim.AdamW",
            "init_args": {
                "lr": recipe.lr if lr is None else lr,
                "weight_decay": recipe.weight_decay,
                "fused": True,
            },
        },
    }
    if task.numbers:
        section |= {"task": "regression", "loss": "huber"}
    else:
        section["label_smoothing"] = recipe.label_smoothing
    if task.metric == "balanced_accuracy":
        section["class_weights"] = "balanced"
    config = {
        "model": section,
        "data": {
            "transform": task.transform(scaled=scaled, posed=not scaled),
            "batch_size": recipe.batch_size,
        },
        "trainer": {"max_epochs": recipe.max_epochs},
    }
    few = settings[:1] if task.layout.num_taxels > _MANY_TAXELS else settings
    return {"config": config, "choice": task.choice(few)}


def _estimator(
    task: Task, name: str, settings: Settings = ({},), *, posed: bool = False, **arguments: Any
) -> dict[str, Any]:
    scaled = name not in ("posed_forest", "posed_ridge")
    arguments["task"] = "regression" if task.numbers else "multiclass"
    if task.metric == "balanced_accuracy" and name != "constant":
        arguments["class_weight"] = "balanced"
    return {
        "estimator": {"class_path": f"{_BASELINES}{name}", "init_args": arguments},
        "transform": task.transform(scaled=scaled, posed=posed, filled=scaled),
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
_RIDGE = [{"alpha": alpha} for alpha in (1.0, 0.1, 10.0, 100.0)]
_DROPOUT = [{}, _decay(0.1, dropout=0.5)]
_LESS_DROPOUT = [{}, {"model": {"init_args": {"dropout": 0.3}}}]

MODELS: tuple[ComparedModel, ...] = (
    ComparedModel(
        "taxel_net",
        "TaxelNet, the default graph model",
        True,
        lambda task: _network(task, "TaxelNet", _LESS_DROPOUT),
    ),
    ComparedModel(
        "posed_taxel_net",
        "PosedTaxelNet, on taxels placed by the joint angles",
        True,
        lambda task: _network(task, "PosedTaxelNet", _DROPOUT, scaled=False),
        lambda task: "" if task.posed else "the taxels are not placed by joint angles",
    ),
    ComparedModel(
        "gcn",
        "TactileGCN, a plain GCN",
        True,
        lambda task: _network(
            task,
            "TactileGCN",
            [{}, _decay(0.5)],
            lr=1e-3,
            widths=[32, 32],
            pools=[1, 1],
            head_widths=[128],
            head_pools=[1],
        ),
    ),
    ComparedModel(
        "fnn",
        "TactileFNN, fully connected",
        False,
        lambda task: _network(
            task, "TactileFNN", [{}, _decay(0.5)], lr=1e-3, widths=[256, 64], pools=[1, 1]
        ),
    ),
    ComparedModel(
        "cnn",
        "SmallCNN, on the map of the layout",
        False,
        lambda task: _network(task, "SmallCNN", _DROPOUT),
        lambda task: "" if task.layout.image_map is not None else "the layout has no image_map",
    ),
    ComparedModel(
        "svm_rbf",
        "support vector machine, radial kernel",
        False,
        lambda task: _estimator(task, "rbf_svm", _RADIAL, most_samples=_MOST_SVM_SAMPLES),
    ),
    ComparedModel(
        "svm_linear",
        "support vector machine, linear",
        False,
        lambda task: _estimator(task, "linear_svm", _LINEAR),
    ),
    ComparedModel(
        "forest",
        "random forest on the readings",
        False,
        lambda task: _estimator(task, "flat_forest", _LEAVES),
    ),
    ComparedModel(
        "posed_forest",
        "random forest on sums of each patch",
        False,
        lambda task: _estimator(task, "posed_forest", _LEAVES, posed=task.posed),
    ),
    ComparedModel(
        "posed_ridge",
        "ridge on sums of each patch",
        False,
        lambda task: _estimator(task, "posed_ridge", _RIDGE, posed=task.posed),
    ),
    ComparedModel(
        "constant",
        "most frequent class, or mean",
        False,
        lambda task: _estimator(task, "constant"),
    ),
)
FLOOR = "constant"
_BY_NAME = {model.name: model for model in MODELS}


def chosen_models(names: Sequence[str] | None, task: Task) -> tuple[ComparedModel, ...]:
    r"""Returns models by their names, in the order of all.

    Args:
        names (sequence of str, optional): The names; all that have a place in the task if left out.
        task (Task): What they have to do.

    Raises:
        ValueError: If there is no such model, or one that is named has no place in the task.
    """
    if names is None:
        return tuple(model for model in MODELS if not model.lacks(task))
    check_names(names)
    for name in names:
        reason = _BY_NAME[name].lacks(task)
        if reason:
            raise ValueError(f"'models' must fit the data (got '{name}', but {reason})")
    return tuple(model for model in MODELS if model.name in names)


def check_names(names: Sequence[str]) -> None:
    r"""Checks that there are models of some names.

    Args:
        names (sequence of str): The names.

    Raises:
        ValueError: If there is no such model; the message lists those there are.
    """
    unknown = [name for name in names if name not in _BY_NAME]
    if unknown or not names:
        got = f"'{unknown[0]}'" if unknown else "none"
        raise ValueError(f"'models' must be some of {', '.join(_BY_NAME)} (got {got})")


def model_of(name: str) -> ComparedModel:
    r"""Returns a model by its name.

    Args:
        name (str): The name.
    """
    return _BY_NAME[name]
