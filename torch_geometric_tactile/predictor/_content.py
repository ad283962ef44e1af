r"""The content of a predictor file, and of a predictor's entry in a checkpoint."""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile import __version__
from torch_geometric_tactile._checks import need
from torch_geometric_tactile._removed import ENCODER_KEY, LAST_READER
from torch_geometric_tactile._typing import PathLike, Transform
from torch_geometric_tactile.data import ContactRule, FrameInfo, StaticData, StaticDataset
from torch_geometric_tactile.data._torch_file import read_torch_file
from torch_geometric_tactile.predictor._file_names import FileNameForm
from torch_geometric_tactile.predictor._network import TASKS, Network
from torch_geometric_tactile.predictor._plain_data import Builder, Describer, load_weights
from torch_geometric_tactile.predictor._preparation import Preparation
from torch_geometric_tactile.predictor._tensor_file import (
    named_file_errors,
    read_tensors,
    write_tensors,
)
from torch_geometric_tactile.predictor._window_cut import WindowCut
from torch_geometric_tactile.predictor.measured_score import MeasuredScore
from torch_geometric_tactile.predictor.stock import predictor_path
from torch_geometric_tactile.sensors import TaxelLayout

# Since format 2, a file has a checksum; since format 3, a threshold and windows of frames.
_FORMAT = 3
_OLD_FORMATS = (1, 2)
_TRANSFORM_KEYS = ("frame_transform", "pre_transform", "transform")
_MAX_COUNT = 10**5  # limit of channels and joints, so that a damaged file cannot fill the memory
_HEADER_KEY = "torch_geometric_tactile.predictor"
_WEIGHT_PREFIX = "model."
_logger = logging.getLogger(__name__)


def describe_predictor(
    preparation: Preparation, network: Network
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    r"""Returns the header of a predictor as JSON values, and its tensors except the weights."""
    describer = Describer(preparation.layout)
    shared = preparation.shared
    attributes = {key: shared[key] for key in shared.to_dict() if key != "x"}
    header = {
        "format": _FORMAT,
        "package": __version__,
        "task": network.task,
        "class_names": list(network.class_names),
        "threshold": network.threshold,
        "score": None if network.score is None else network.score.to_dict(),
        "layout": preparation.layout.to_dict(),
        "num_channels": preparation.num_channels,
        "num_joints": preparation.num_joints,
        "session": preparation.session.number,
        "shared": describer.value(attributes),
        "schema": shared.schema,
        "model": describer.model(network.model),
    }
    header["read_options"] = preparation.read_options
    file_names = preparation.file_names
    header["file_names"] = None if file_names is None else file_names.to_dict()
    header["frames"] = preparation.info.to_dict()
    header["contact"] = None if preparation.contact is None else preparation.contact.to_dict()
    header["window"] = None if preparation.window is None else preparation.window.to_dict()
    for key in _TRANSFORM_KEYS:
        transform = getattr(preparation, key)
        header[key] = None if transform is None else describer.transform(transform)
    return header, describer.tensors


def checkpoint_entry(
    model: Module,
    dataset: StaticDataset,
    transform: Transform | None,
    task: str,
    threshold: float | None = None,
) -> dict[str, Any]:
    r"""Returns an entry for a checkpoint, as plain data and tensors. A predictor can be loaded from
    this entry and the weights.

    Args:
        model (torch.nn.Module): The model.
        dataset (StaticDataset): The training data.
        transform (callable, optional): Fitted transform that is applied after the transform of the
            data set.
        task (str): As in :class:`Predictor`.
        threshold (float, optional): As in :class:`Predictor`.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.nn.models import TaxelNet
        >>> model = TaxelNet("biotac_sp", in_channels=3, out_channels=2)
        >>> entry = checkpoint_entry(model, FakeTactileDataset(20), None, "multiclass")
        >>> sorted(entry)
        ['header', 'tensors']
    """
    preparation = Preparation.from_dataset(dataset, transform)
    network = Network(model, dataset.class_names, task, threshold)
    header, tensors = describe_predictor(preparation, network)
    # Copies are stored: a view would add its entire storage to the checkpoint.
    return {"header": header, "tensors": {name: t.clone() for name, t in tensors.items()}}


def model_entry(model: Module, layout: TaxelLayout | None) -> dict[str, Any]:
    r"""Returns the description from which :func:`build_model` builds a model, as plain data and
    tensors. It contains the class name and the arguments, or only the name and :obj:`repr` if the
    model cannot be built from plain values.

    Args:
        model (torch.nn.Module): The model.
        layout (TaxelLayout, optional): The layout of the sensor. The description does not contain
            the layout, even if it is an argument of the model.

    Examples:
        >>> from torch_geometric_tactile.nn.models import GraspGCN
        >>> model_entry(GraspGCN(), None)["description"]["class"]
        'GraspGCN'
    """
    describer = Describer(layout)
    description = describer.model(model)
    return {
        "description": description,
        "tensors": {name: tensor.clone() for name, tensor in describer.tensors.items()},
    }


def build_model(
    entry: Mapping[str, Any],
    weights: Mapping[str, Tensor],
    layout: TaxelLayout | None,
    model: Module | None = None,
) -> Module:
    r"""Returns a model built from its description, without loaded weights. Only models of this
    package are built by their names.

    Args:
        entry (Mapping): The description from :func:`model_entry`.
        weights (Mapping of str to torch.Tensor): The weights. A description of a larger model is
            rejected.
        layout (TaxelLayout, optional): The layout of the sensor.
        model (torch.nn.Module, optional): The model, if it cannot be built from its description,
            such as your own model. The model is copied.

    Raises:
        ValueError: If the class is unknown, or :obj:`model` is missing or has another class.

    Examples:
        >>> from torch_geometric_tactile.nn.models import GraspGCN
        >>> model = GraspGCN()
        >>> type(build_model(model_entry(model, None), model.state_dict(), None)).__name__
        'GraspGCN'
    """
    return Builder(layout, {**entry["tensors"], **weights}).model(entry["description"], model)


def build_predictor(
    header: Mapping[str, Any],
    tensors: Mapping[str, Tensor],
    weights: Mapping[str, Tensor],
    model: Module | None = None,
    transforms: Sequence[Transform] | None = None,
) -> tuple[Preparation, Network]:
    r"""Builds the preparation and the network of a predictor.

    Args:
        header (Mapping): The header from :func:`describe_predictor`.
        tensors (Mapping of str to torch.Tensor): The tensors from :func:`describe_predictor`.
        weights (Mapping of str to torch.Tensor): The weights of the model.
        model (torch.nn.Module, optional): As in :meth:`Predictor.load`.
        transforms (sequence of callable, optional): As in :meth:`Predictor.load`.

    Raises:
        ValueError: If a part is damaged, unknown, missing or from another version.
    """
    if header.get("format") not in (_FORMAT, *_OLD_FORMATS):
        raise ValueError(
            f"its format must be {_FORMAT} (got {header.get('format')}, written by version "
            f"{header.get('package')} of this package)"
        )
    if header.get("task") not in TASKS:
        raise ValueError(f"its task must be one of {list(TASKS)} (got {header.get('task')!r})")
    threshold = header.get("threshold")
    if threshold is not None and not (
        isinstance(threshold, float) and 0 <= threshold <= 1 and header["task"] == "multiclass"
    ):
        raise ValueError(
            f"its threshold must be a probability of two classes (got {str(threshold)[:80]})"
        )
    layout = TaxelLayout.from_dict(header["layout"])
    builder = Builder(layout, {**tensors, **weights}, transforms)
    shared = StaticData(x=torch.zeros(1, layout.num_taxels, 0), **header["schema"])
    for key, value in builder.value(header["shared"]).items():
        shared[key] = value
    transform_values = [
        None if header.get(key) is None else builder.transform(header[key])
        for key in _TRANSFORM_KEYS
    ]
    num_channels, num_joints = header["num_channels"], header["num_joints"]
    for key, minimum in (("num_channels", 1), ("num_joints", 0)):
        number = header[key]
        if number is not None and (type(number) is not int or not minimum <= number <= _MAX_COUNT):
            raise ValueError(
                f"its '{key}' must be a number from {minimum} to {_MAX_COUNT} or null (got "
                f"{str(number)[:80]})"
            )
    preparation = Preparation(
        layout,
        shared,
        transform_values[1],
        transform_values[2],
        num_channels,
        num_joints,
        window=_built(WindowCut, header.get("window")),  # missing in older formats
        frame_transform=transform_values[0],
        read_options=header.get("read_options"),  # missing in older formats
        info=_frame_info(header),
        contact=_built(ContactRule, header.get("contact")),  # missing in older formats
        file_names=_built(FileNameForm, header.get("file_names")),  # missing in older files
    )
    for part in preparation.fitted:
        center = part.center if part.attr == "joint" and num_joints else None
        if center is not None and center.size(-1) != num_joints:
            raise ValueError(
                f"{part!r} must be fitted on {num_joints} joints, as 'num_joints' says (got "
                f"{center.size(-1)})"
            )
    preparation.session.number = header["session"]
    built = builder.model(header["model"], model)
    load_weights(built, weights)
    names = tuple(map(str, header["class_names"]))
    score = _built(MeasuredScore, header.get("score"))  # missing in older formats
    return preparation, Network(built, names, header["task"], threshold, score)


def _built(cls: Any, content: Any) -> Any:
    return None if content is None else cls.from_dict(content)


def _frame_info(header: Mapping[str, Any]) -> FrameInfo | None:
    if "frames" in header:
        return FrameInfo.from_dict(header["frames"])
    _logger.warning(
        "a predictor of version %s does not store the unit, rate and thinning of its training "
        "frames: the unit, rate and thinning of recordings are not checked",
        header.get("package"),
    )
    return None


def save(preparation: Preparation, network: Network, path: PathLike) -> None:
    r"""Writes a predictor to a file. If writing fails, no partial file is left."""
    header, tensors = describe_predictor(preparation, network)
    for name, value in network.model.state_dict().items():
        if not isinstance(value, Tensor):
            raise ValueError(
                f"'model' must have tensors only in its state (got {type(value).__name__} in "
                f"'{name}')"
            )
        tensors[_WEIGHT_PREFIX + name] = value
    write_tensors(tensors, {_HEADER_KEY: json.dumps(header)}, path)


def load(
    path: PathLike, model: Module | None = None, transforms: Sequence[Transform] | None = None
) -> tuple[Preparation, Network]:
    r"""Reads a predictor from a file, or a predictor of the package by its name."""
    path = predictor_path(path)
    if is_checkpoint(path):
        raise ValueError(f"'{path}' is a checkpoint: read it with Predictor.from_checkpoint")
    with named_file_errors(f"'{path}' cannot be read as a predictor"):
        tensors, texts, has_checksum = read_tensors(path)
        need(ENCODER_KEY not in texts, f"it is a pretrained encoder: {LAST_READER}")
        need(_HEADER_KEY in texts, "it was not written by Predictor.save")
        header = json.loads(texts[_HEADER_KEY])
        if not has_checksum and header.get("format") != _OLD_FORMATS[0]:
            raise ValueError("it must have a checksum (got none): it is damaged")
        if not has_checksum:
            _logger.warning("'%s' has no checksum: save it again with this version", path)
        plain_tensors = {
            name: t for name, t in tensors.items() if not name.startswith(_WEIGHT_PREFIX)
        }
        return build_predictor(header, plain_tensors, _select_weights(tensors), model, transforms)


def load_checkpoint(
    path: PathLike, model: Module | None = None, transforms: Sequence[Transform] | None = None
) -> tuple[Preparation, Network]:
    r"""Reads a predictor from a checkpoint of ``tactile fit``."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"the checkpoint '{path}' does not exist")
    with named_file_errors(f"'{path}' cannot be read as a checkpoint"):
        content = read_torch_file(path)
        entry = content.get("predictor") if isinstance(content, dict) else None
        if entry is None:
            raise ValueError(
                "it contains no predictor: it was written by an older version, its samples share "
                "no layout, or it was trained without TactileDataModule; train again, or build a "
                "predictor with "
                "Predictor.from_dataset"
            )
        weights = _select_weights(content["state_dict"])
        return build_predictor(entry["header"], entry["tensors"], weights, model, transforms)


def _select_weights(tensors: Mapping[str, Any]) -> dict[str, Any]:
    names = [name for name in tensors if name.startswith(_WEIGHT_PREFIX)]
    return {name.removeprefix(_WEIGHT_PREFIX): tensors[name] for name in names}


def is_checkpoint(path: PathLike) -> bool:
    r"""Returns whether a file was written by :func:`torch.save`, such as a checkpoint.

    Args:
        path (str or PathLike): The file.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     torch.save({"weights": torch.ones(2)}, f"{folder}/model.pth")
        ...     is_checkpoint(f"{folder}/model.pth")
        True
    """
    with Path(path).open("rb") as file:
        return file.read(4) == b"PK\x03\x04"
