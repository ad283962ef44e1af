r"""Derives the sizes of a model, such as its input channels, from the data."""

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
# The arguments of a model that are filled in from the data.
_FILLED_ARGUMENTS = (
    *("layout", "num_nodes", "num_taxels", "in_channels", "channels", "out_channels"),
    *("num_classes", "num_edges", "num_joints", "num_fingers"),
)
# The attribute of a batch for each input of the package's models.
_INPUT_ATTRIBUTES = {"tactile": "x", "edge": "edge_attr", "absolute": "absolute", "position": "pos"}


@dataclass(frozen=True)
class DataSizes:
    r"""The numbers of channels, classes, edges, joints and frames of the samples of a data set.

    Args:
        layout (TaxelLayout, optional): The layout of the sensor; :obj:`None` if samples may have
            different layouts.
        in_channels (int): Number of features :math:`F` of each taxel in :obj:`x`.
        num_outputs (int): Number of classes, labels or targets; 0 if unknown.
        num_edges (int): Number of edges.
        num_joints (int): Number of joint angles; 0 if there are none.
        channels (dict): Number of features of each input that the samples have: :obj:`"tactile"`,
            :obj:`"edge"`, :obj:`"absolute"` or :obj:`"position"`.
        all_outputs (bool): If :obj:`False`, :obj:`num_outputs` is a lower bound: without class
            names, there may be classes that have no samples.
        num_frames (int, optional): Number of frames :math:`T` per window; the features of a window
            are the features of all its frames. :obj:`None` for single frames.

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
    def from_data(cls, data: TactileDataModule, task: Task = "multiclass") -> Self:
        r"""Returns the sizes of one sample of a data module. The data module need not be set up:
        fitted transforms are not applied, because they change no size.

        Args:
            data (TactileDataModule): The data.
            task (str): The task, which defines the meaning of :obj:`y`.

        Raises:
            ValueError: If :obj:`y` does not fit :obj:`task`.
        """
        y = data.dataset.column("y")
        if y is not None:
            check_labels(y, task, "dataset")
        sample = data.example()
        inputs = {name: getattr(sample, key, None) for name, key in _INPUT_ATTRIBUTES.items()}
        joints, edges = getattr(sample, "joint", None), sample.edge_index
        return cls(
            layout=data.layout,
            in_channels=sample.x.size(-1),
            num_outputs=num_outputs(data, task),
            num_edges=0 if edges is None or data.layout is None else edges.size(1),
            num_joints=0 if joints is None else joints.size(-1),
            channels={
                name: features.size(-1)
                for name, features in inputs.items()
                if isinstance(features, Tensor)
            },
            all_outputs=task != "multiclass" or bool(data.class_names),
            num_frames=getattr(sample, "num_frames", None),
        )

    @property
    def frame_channels(self) -> int:
        r"""The number of features of each taxel in one frame, such as the number of its axes or
        fingers.
        """
        return self.in_channels // (self.num_frames or 1)


def fill_sizes(config: Mapping[str, Any], data: TactileDataModule | DataSizes) -> dict[str, Any]:
    r"""Returns the configuration of a model with missing sizes filled in from the data. Sizes in
    the configuration are checked against the data.

    Arguments of the model are filled in by their names: :obj:`layout`, :obj:`num_nodes`,
    :obj:`num_taxels`, :obj:`in_channels`, :obj:`channels`, :obj:`out_channels`,
    :obj:`num_classes`, :obj:`num_edges`, :obj:`num_joints` and :obj:`num_fingers`. An argument is
    filled in if it is missing or :obj:`None`.

    * For a model with :obj:`num_fingers`, :obj:`in_channels` is the number of channels of one
      finger. For windows of frames, each channel of a frame is one finger unless
      :obj:`num_fingers` is given, and the frames count as channels of their finger.
    * For a model with :obj:`splits_frames = True`, :obj:`in_channels` is the number of channels of
      one frame.
    * Using joint angles is a choice of the model, so :obj:`num_joints` is filled in only if it is
      :obj:`None` or has no default.
    * A :obj:`layout` without an annotation is filled in as a
      :class:`~torch_geometric_tactile.sensors.TaxelLayout`; all other values are plain data.

    An argument that is a module, such as :obj:`encoder`, may be given as the import path of its
    class.

    Args:
        config (Mapping): The :obj:`model` section of a configuration: the arguments of
            :class:`~torch_geometric_tactile.training.TactileModule`, classes as
            :obj:`{"class_path", "init_args"}`.
        data (TactileDataModule or DataSizes): The data, or its sizes.

    Returns:
        dict: The section with all sizes.

    Raises:
        ValueError: If a size in the configuration differs from the data, or if an argument without
            a default is neither given nor filled in.

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
    cls = _find_class(model["class_path"])
    if cls is None:  # building the model raises the detailed error
        return filled
    task: Task = filled.get("task") or "multiclass"
    check_task(task)
    sizes = data if isinstance(data, DataSizes) else DataSizes.from_data(data, task)
    num_outputs = filled.get("num_classes") or sizes.num_outputs
    init_args = dict(model.get("init_args") or {})
    parameters = _parameters(cls)
    for name, parameter in parameters.items():
        value = _argument_size(name, parameter.annotation, sizes, num_outputs, init_args, cls)
        if value is None:
            continue
        if name == "num_joints" and init_args.get(name) == 0:
            continue
        if init_args.get(name) is not None:
            _check_size(f"'{name}' of {cls.__name__}", init_args[name], value, sizes)
            if isinstance(value, TaxelLayout):
                init_args[name] = value
        elif name != "num_joints" or name in init_args or parameter.default is parameter.empty:
            init_args[name] = value
    for name, parameter in _parameters(cls).items():
        value = init_args.get(name)
        # If an argument accepts a string or a module, such as `encoder`, jsonargparse would leave
        # the import path of a class as a string.
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
    # The parser would pass None for missing arguments of a user's class.
    for name, parameter in parameters.items():
        if parameter.default is not parameter.empty or name in arguments:
            continue
        if sizes.layout is None and name in ("layout", "num_nodes", "num_taxels"):
            raise ValueError(
                f"{cls.__name__} must be a model for any sensor, with forward(x, edge_index, "
                f"batch) and without '{name}', because the samples share no layout"
            )
        if name in _FILLED_ARGUMENTS:
            raise ValueError(
                f"'{name}' of {cls.__name__} must be given or have a default, because it cannot be "
                "derived from the data"
            )
        raise ValueError(
            f"'{name}' of {cls.__name__} must be given or have a default; only "
            f"{', '.join(_FILLED_ARGUMENTS[:-1])} and {_FILLED_ARGUMENTS[-1]} are filled in"
        )


# A configuration may give the name or the path of a layout for every argument of this type.
register_type(TaxelLayout, layout_to_text, layout_from_text)


def _argument_size(
    name: str,
    annotation: Any,
    sizes: DataSizes,
    num_outputs: int,
    init_args: Mapping[str, Any],
    cls: type,
) -> Any:
    # Returns None if the argument is not a size, or the data does not have this size.
    if name in ("layout", "num_nodes", "num_taxels"):
        if sizes.layout is None:
            return None
        if name == "layout":
            return _layout_argument(sizes.layout, annotation, cls)
        return sizes.layout.num_taxels
    if name == "channels":
        if get_origin(annotation) is Literal and init_args.get(name) is not None:
            return None  # an option of the model, not a number
        return sizes.channels if _accepts(annotation, dict, Mapping) else sizes.in_channels
    if name == "in_channels":
        if getattr(cls, "splits_frames", False):
            return sizes.frame_channels
        return _finger_channels(sizes, init_args, cls)
    if name == "num_fingers":
        num_channels = None if sizes.num_frames is None else sizes.frame_channels
        num_fingers = init_args.get("num_fingers")
        is_divisor = (
            isinstance(num_fingers, int)
            and num_fingers > 0
            and num_channels
            and not num_channels % num_fingers
        )
        return None if is_divisor else num_channels
    if name == "num_joints" and init_args.get(name, 0) is None and not sizes.num_joints:
        raise ValueError(
            f"'num_joints' of {cls.__name__} must be left out or 0, because the data has no joint "
            "angles (got null)"
        )
    return {
        "out_channels": num_outputs or None,
        "num_classes": num_outputs or None,
        "num_edges": sizes.num_edges or None,
        "num_joints": sizes.num_joints or None,
    }.get(name)


def _finger_channels(sizes: DataSizes, init_args: Mapping[str, Any], cls: type) -> int:
    parameters = _parameters(cls)
    if "num_fingers" not in parameters:
        return sizes.in_channels
    num_fingers = init_args.get("num_fingers")
    if sizes.num_frames is not None:  # 60 features may be 3 fingers x 20 frames, or 1 x 60
        return sizes.num_frames * (sizes.frame_channels // (num_fingers or sizes.frame_channels))
    num_fingers = num_fingers or parameters["num_fingers"].default
    if not isinstance(num_fingers, int) or sizes.in_channels % num_fingers:
        raise ValueError(
            f"'num_fingers' of {cls.__name__} must divide the {sizes.in_channels} channels of 'x' "
            f"(got {num_fingers})"
        )
    return sizes.in_channels // num_fingers


def _check_size(argument: str, value: Any, expected: Any, sizes: DataSizes) -> None:
    if argument.startswith("'layout'"):
        assert sizes.layout is not None
        _check_layout(argument, value, sizes.layout)
        return
    if isinstance(expected, dict):  # each input separately, since unused inputs may be missing
        if isinstance(value, Mapping):
            for name in value.keys() & expected.keys():
                _check_size(f"{argument} for '{name}'", value[name], expected[name], sizes)
        return
    is_lower_bound = (
        argument.startswith(("'out_channels'", "'num_classes'")) and not sizes.all_outputs
    )
    if value == expected or (is_lower_bound and value > expected):
        return
    qualifier = "at least " if is_lower_bound else ""
    raise ValueError(
        f"{argument} must be {qualifier}{expected}, as in the data (got {value}); leave it out to "
        "derive it from the data"
    )


def _check_layout(argument: str, value: Any, layout: TaxelLayout) -> None:
    if isinstance(value, int):
        matches = value == layout.num_taxels
    else:
        if isinstance(value, str):
            value = layout_from_text(value)
        matches = not isinstance(value, TaxelLayout) or value.matches(layout)
    if not matches:
        raise ValueError(
            f"{argument} must be '{layout.name}' with {layout.num_taxels} taxels, as in the data "
            f"(got {value!r}); leave it out to derive it from the data"
        )


def _layout_argument(
    layout: TaxelLayout, annotation: Any, cls: type
) -> TaxelLayout | str | int | None:
    if annotation is inspect.Parameter.empty:  # the parser passes the object unchanged
        return layout
    if annotation is TaxelLayout:  # a dataclass, which jsonargparse reads field by field
        raise ValueError(
            f"'layout' of {cls.__name__} must accept text to be stored in a configuration (got "
            "only TaxelLayout): annotate it TaxelLayout | str, and call as_layout on it"
        )
    if _accepts(annotation, TaxelLayout) or (_accepts(annotation, str) and _is_stock(layout)):
        return layout_to_text(layout)
    return layout.num_taxels if _accepts(annotation, int) else None


def _accepts(annotation: Any, *kinds: type) -> bool:
    if get_origin(annotation) in (Union, types.UnionType):
        return any(_accepts(part, *kinds) for part in get_args(annotation))
    kind = get_origin(annotation) or annotation
    return any(kind is accepted or kind == accepted for accepted in kinds)


def _find_class(class_path: str) -> Any:
    module, _, name = class_path.rpartition(".")
    try:
        return getattr(import_user_module(module or _MODELS), name)
    except (ImportError, AttributeError):
        return None


def _parameters(cls: Any) -> dict[str, inspect.Parameter]:
    # Includes the parameters of parent classes that `**kwargs` passes on.
    parameters: dict[str, inspect.Parameter] = {}
    parents = cls.__mro__ if isinstance(cls, type) else ()
    inits = [base.__dict__["__init__"] for base in parents if "__init__" in base.__dict__] or [cls]
    for init in inits:
        try:
            signature = list(inspect.signature(init).parameters.values())
            hints = get_type_hints(init)
        except (NameError, TypeError, ValueError):  # an annotation that cannot be resolved
            break
        for parameter in signature[init is not cls :]:  # without self
            if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
                annotation = hints.get(parameter.name, inspect.Parameter.empty)
                parameters.setdefault(parameter.name, parameter.replace(annotation=annotation))
        if all(parameter.kind is not parameter.VAR_KEYWORD for parameter in signature):
            break
    return parameters
