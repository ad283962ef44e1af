r"""The sizes of a model, taken from the data that it is trained on."""

import inspect
import types
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, Union, get_args, get_origin, get_type_hints

from jsonargparse.typing import register_type
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._user_modules import import_user_module
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._checks import check_labels, num_outputs
from torch_geometric_tactile.training._collected_metrics import Task, check_task
from torch_geometric_tactile.training._layout_text import (
    _is_stock,
    layout_from_text,
    layout_to_text,
)
from torch_geometric_tactile.training.data_module import TactileDataModule

_MODELS = "torch_geometric_tactile.nn.models"
# The arguments of a model that follow from the data.
_FILLED = (
    *("layout", "num_nodes", "num_taxels", "in_channels", "channels", "out_channels"),
    *("num_classes", "num_edges", "num_joints", "num_fingers"),
)
# The attribute of a batch behind each input of our models.
_INPUTS = {"tactile": "x", "edge": "edge_attr", "absolute": "absolute", "position": "pos"}


@dataclass(frozen=True)
class DataSizes:
    r"""The numbers of channels, classes, edges, joints and frames of the samples of a data set.

    Args:
        layout (TaxelLayout, optional): The layout of the sensor; :obj:`None` where samples may be
            of several.
        in_channels (int): Features :math:`F` of each taxel in :obj:`x`.
        num_outputs (int): Number of classes, labels or targets; 0 if the data does not say.
        num_edges (int): Number of edges.
        num_joints (int): Number of joint angles; 0 if there are none.
        channels (dict): Features by input: those of :obj:`"tactile"`, :obj:`"edge"`,
            :obj:`"absolute"` and :obj:`"position"` that the samples have.
        all_outputs (bool): Whether :obj:`num_outputs` is certain. Without names of the classes, it
            is a lower bound: there may be classes that no sample has.
        num_frames (int, optional): Number of frames :math:`T` that a sample says it is a window of,
            whose features are those of all frames; :obj:`None` for single frames.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> sizes = DataSizes(
        ...     allegro_uskin(), in_channels=3, num_outputs=6, num_edges=0, num_joints=16,
        ...     channels={"tactile": 3},
        ... )
        >>> sizes.num_outputs
        6
    """

    layout: TaxelLayout | None
    in_channels: int
    num_outputs: int
    num_edges: int
    num_joints: int
    channels: dict[str, int]
    all_outputs: bool = True
    num_frames: int | None = None

    @classmethod
    def of(cls, data: TactileDataModule, task: Task = "multiclass") -> Self:
        r"""Measures one sample of a data module, which need not be set up: scaling, which would
        have to be fitted, changes no size.

        Args:
            data (TactileDataModule): The data.
            task (str): What :obj:`y` means.

        Raises:
            ValueError: If :obj:`y` does not fit :obj:`task`.
        """
        y = data.dataset.column("y")
        if y is not None:
            check_labels(y, task, "dataset")
        sample = data.example()
        found = {name: getattr(sample, key, None) for name, key in _INPUTS.items()}
        joint, edges = getattr(sample, "joint", None), sample.edge_index
        return cls(
            layout=data.layout,
            in_channels=sample.x.size(-1),
            num_outputs=num_outputs(data, task),
            num_edges=0 if edges is None or data.layout is None else edges.size(1),
            num_joints=0 if joint is None else joint.size(-1),
            channels={name: x.size(-1) for name, x in found.items() if isinstance(x, Tensor)},
            all_outputs=task != "multiclass" or bool(data.class_names),
            num_frames=getattr(sample, "num_frames", None),
        )

    @property
    def frame_channels(self) -> int:
        r"""Features of each taxel in one frame, such as its axes or fingers."""
        return self.in_channels // (self.num_frames or 1)


def fill_sizes(config: Mapping[str, Any], data: TactileDataModule | DataSizes) -> dict[str, Any]:
    r"""Fills in the sizes that the configuration of a model leaves out, and checks the sizes that
    it gives.

    An argument of the model is filled in by its name: :obj:`layout`, :obj:`num_nodes`,
    :obj:`num_taxels`, :obj:`in_channels`, :obj:`channels`, :obj:`out_channels`, :obj:`num_classes`
    and :obj:`num_edges`. :obj:`in_channels` of a model that also has :obj:`num_fingers` is that of
    one finger: with windows of frames, each channel is a finger unless :obj:`num_fingers` says that
    several are, and :obj:`in_channels` are the frames of all its channels. That of a model with a
    true attribute :obj:`splits_frames` is the number of channels of one frame. An argument counts
    as left out if it is not there, or :obj:`None`. Whether a model sees joint angles is a choice
    and not a size: :obj:`num_joints` is filled in only if it is :obj:`None`, or has no default. A
    :obj:`layout` without an annotation is filled in as the
    :class:`~torch_geometric_tactile.sensors.TaxelLayout` itself. A module as an argument, such as
    :obj:`encoder`, may be named by the import path of its class alone. All other values are plain
    data.

    Args:
        config (Mapping): The :obj:`model` section of a configuration: the arguments of
            :class:`~torch_geometric_tactile.training.TactileModule`, classes as
            :obj:`{"class_path", "init_args"}`.
        data (TactileDataModule or DataSizes): The data, or its sizes.

    Returns:
        dict: The section with all sizes.

    Raises:
        ValueError: If a size is given that is not that of the data, or an argument without a
            default is neither given nor filled in.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.transforms import KNNGraph
        >>> data = TactileDataModule(FakeTactileDataset(20, pre_transform=KNNGraph(2)))
        >>> config = {"model": {"class_path": "TactileGCN"}}
        >>> fill_sizes(config, data)["model"]["init_args"]["out_channels"]
        2
    """
    filled = dict(config)
    model = filled.get("model")
    if isinstance(model, str):
        model = {"class_path": model}
    if not isinstance(model, Mapping) or "class_path" not in model:
        return filled
    cls = _find(model["class_path"])
    if cls is None:  # building it explains why there is no such class
        return filled
    task: Task = filled.get("task") or "multiclass"
    check_task(task)
    sizes = data if isinstance(data, DataSizes) else DataSizes.of(data, task)
    outputs = filled.get("num_classes") or sizes.num_outputs
    init_args = dict(model.get("init_args") or {})
    parameters = _parameters(cls)
    for name, parameter in parameters.items():
        value = _size(name, parameter.annotation, sizes, outputs, init_args, cls)
        if value is None:
            continue
        if name == "num_joints" and init_args.get(name) == 0:
            continue
        if init_args.get(name) is not None:
            _check(f"'{name}' of {cls.__name__}", init_args[name], value, sizes)
            if isinstance(value, TaxelLayout):
                init_args[name] = value
        elif name != "num_joints" or name in init_args or parameter.default is parameter.empty:
            init_args[name] = value
    for name, parameter in _parameters(cls).items():
        value = init_args.get(name)
        # Of an argument that takes a text or a module, such as `encoder`, jsonargparse would leave
        # the path of a class as a text.
        if isinstance(value, str) and "." in value and _accepts(parameter.annotation, Module):
            init_args[name] = {"class_path": value}
    _check_complete(cls, parameters, {**(model.get("dict_kwargs") or {}), **init_args}, sizes)
    filled["model"] = {**model, "init_args": init_args}
    if filled.get("num_classes") is None and sizes.num_outputs:
        filled["num_classes"] = sizes.num_outputs
    return filled


def _check_complete(
    cls: Any,
    parameters: Mapping[str, inspect.Parameter],
    arguments: Mapping[str, Any],
    sizes: DataSizes,
) -> None:
    # Of a user's own: a parser would give it None.
    for name, parameter in parameters.items():
        if parameter.default is not parameter.empty or name in arguments:
            continue
        if sizes.layout is None and name in ("layout", "num_nodes", "num_taxels"):
            raise ValueError(
                f"{cls.__name__} must be a model of any sensor, with forward(x, edge_index, batch) "
                f"and without '{name}': the samples have no layout that all share"
            )
        if name in _FILLED:
            raise ValueError(
                f"'{name}' of {cls.__name__} must be given, or have a default: the data does not "
                "tell it"
            )
        raise ValueError(
            f"'{name}' of {cls.__name__} must be given, or have a default: filled in are "
            f"{', '.join(_FILLED[:-1])} and {_FILLED[-1]}, by their names"
        )


# Wherever a class of a configuration asks for a layout, a name or a path may be given.
register_type(TaxelLayout, layout_to_text, layout_from_text)


def _size(
    name: str,
    annotation: Any,
    sizes: DataSizes,
    outputs: int,
    init_args: Mapping[str, Any],
    cls: type,
) -> Any:
    # The value of an argument; None for one that is no size, or that the data does not have.
    if name in ("layout", "num_nodes", "num_taxels"):
        if sizes.layout is None:
            return None
        if name == "layout":
            return _stored_layout(sizes.layout, annotation, cls)
        return sizes.layout.num_taxels
    if name == "channels":
        if get_origin(annotation) is Literal and init_args.get(name) is not None:
            return None  # a choice of the model, which has its own way to as many
        return sizes.channels if _accepts(annotation, dict, Mapping) else sizes.in_channels
    if name == "in_channels":
        if getattr(cls, "splits_frames", False):
            return sizes.frame_channels
        return _of_one_finger(sizes, init_args, cls)
    if name == "num_fingers":
        of_data = None if sizes.num_frames is None else sizes.frame_channels
        fingers = init_args.get("num_fingers")
        several = isinstance(fingers, int) and fingers > 0 and of_data and not of_data % fingers
        return None if several else of_data
    if name == "num_joints" and init_args.get(name, 0) is None and not sizes.num_joints:
        raise ValueError(
            f"'num_joints' of {cls.__name__} must be left out or 0, since the data has no joint "
            "angles (got null)"
        )
    return {
        "out_channels": outputs or None,
        "num_classes": outputs or None,
        "num_edges": sizes.num_edges or None,
        "num_joints": sizes.num_joints or None,
    }.get(name)


def _of_one_finger(sizes: DataSizes, init_args: Mapping[str, Any], cls: type) -> int:
    parameters = _parameters(cls)
    if "num_fingers" not in parameters:
        return sizes.in_channels
    fingers = init_args.get("num_fingers")
    if sizes.num_frames is not None:  # 3 x 20 and 1 x 60 are other meanings of 60 features
        return sizes.num_frames * (sizes.frame_channels // (fingers or sizes.frame_channels))
    fingers = fingers or parameters["num_fingers"].default
    if not isinstance(fingers, int) or sizes.in_channels % fingers:
        raise ValueError(
            f"'num_fingers' of {cls.__name__} must divide the {sizes.in_channels} channels of 'x' "
            f"(got {fingers})"
        )
    return sizes.in_channels // fingers


def _check(what: str, given: Any, expected: Any, sizes: DataSizes) -> None:
    if what.startswith("'layout'"):
        assert sizes.layout is not None
        _check_layout(what, given, sizes.layout)
        return
    if isinstance(expected, dict):  # each input for itself: unused ones need not be given
        if isinstance(given, Mapping):
            for name in given.keys() & expected.keys():
                _check(f"{what} for '{name}'", given[name], expected[name], sizes)
        return
    lower_bound = what.startswith(("'out_channels'", "'num_classes'")) and not sizes.all_outputs
    if given == expected or (lower_bound and given > expected):
        return
    least = "at least " if lower_bound else ""
    raise ValueError(
        f"{what} must be {least}{expected}, as in the data (got {given}); leave it out to take it "
        "from there"
    )


def _check_layout(what: str, given: Any, layout: TaxelLayout) -> None:
    if isinstance(given, int):
        same = given == layout.num_taxels
    else:
        if isinstance(given, str):
            given = layout_from_text(given)
        same = not isinstance(given, TaxelLayout) or given.matches(layout)
    if not same:
        raise ValueError(
            f"{what} must be '{layout.name}' with {layout.num_taxels} taxels, as in the data (got "
            f"{given!r}); leave it out to take it from there"
        )


def _stored_layout(
    layout: TaxelLayout, annotation: Any, cls: type
) -> TaxelLayout | str | int | None:
    if annotation is inspect.Parameter.empty:  # the parser passes it on as it is
        return layout
    if annotation is TaxelLayout:  # a dataclass, which jsonargparse reads field by field
        raise ValueError(
            f"'layout' of {cls.__name__} must accept text, to be stored in a configuration (got "
            "only TaxelLayout): annotate it TaxelLayout | str, and call as_layout on it"
        )
    if _accepts(annotation, TaxelLayout) or (_accepts(annotation, str) and _is_stock(layout)):
        return layout_to_text(layout)
    return layout.num_taxels if _accepts(annotation, int) else None


def _accepts(annotation: Any, *kinds: type) -> bool:
    if get_origin(annotation) in (Union, types.UnionType):
        return any(_accepts(part, *kinds) for part in get_args(annotation))
    kind = get_origin(annotation) or annotation
    return any(kind is other or kind == other for other in kinds)


def _find(class_path: str) -> Any:
    module, _, name = class_path.rpartition(".")
    try:
        return getattr(import_user_module(module or _MODELS), name)
    except (ImportError, AttributeError):
        return None


def _parameters(cls: Any) -> dict[str, inspect.Parameter]:
    # Those of the parents as well, as far as `**kwargs` hands them on.
    found: dict[str, inspect.Parameter] = {}
    parents = cls.__mro__ if isinstance(cls, type) else ()
    calls = [base.__dict__["__init__"] for base in parents if "__init__" in base.__dict__] or [cls]
    for call in calls:
        try:
            parameters = list(inspect.signature(call).parameters.values())
            hints = get_type_hints(call)
        except (NameError, TypeError, ValueError):  # an annotation that cannot be resolved
            break
        for parameter in parameters[call is not cls :]:  # without the object itself
            if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
                annotation = hints.get(parameter.name, inspect.Parameter.empty)
                found.setdefault(parameter.name, parameter.replace(annotation=annotation))
        if all(parameter.kind is not parameter.VAR_KEYWORD for parameter in parameters):
            break
    return found
