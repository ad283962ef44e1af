r"""The content of the file of a predictor, and of its entry in a checkpoint."""

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
from torch_geometric_tactile.predictor._network import TASKS, Network
from torch_geometric_tactile.predictor._plain_data import Builder, Describer, load_weights
from torch_geometric_tactile.predictor._preparation import Preparation
from torch_geometric_tactile.predictor._tensor_file import explained, read_tensors, write_tensors
from torch_geometric_tactile.predictor._window_cut import WindowCut
from torch_geometric_tactile.predictor.measured_score import MeasuredScore
from torch_geometric_tactile.sensors import TaxelLayout

# Since 2, a file has a checksum; since 3, a threshold and windows of frames.
_FORMAT = 3
_OLD_FORMATS = (1, 2)
_TRANSFORMS = ("frame_transform", "pre_transform", "transform")
_MOST = 10**5  # channels of a taxel, joints of a hand
_KEY = "torch_geometric_tactile.predictor"
_WEIGHT = "model."
_logger = logging.getLogger(__name__)


def describe_predictor(
    preparation: Preparation, network: Network
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    r"""Returns the header of a predictor, JSON values, and its tensors without the weights."""
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
    header["frames"] = preparation.info.to_dict()
    header["contact"] = None if preparation.contact is None else preparation.contact.to_dict()
    header["window"] = None if preparation.window is None else preparation.window.to_dict()
    for key in _TRANSFORMS:
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
    r"""Returns the data beside the weights that a checkpoint needs to be loaded as a predictor, as
    plain data and tensors.

    Args:
        model (torch.nn.Module): The model.
        dataset (StaticDataset): The data set that it is trained on.
        transform (callable, optional): What comes after the data set's own transform, fitted.
        task (str): What the model does.
        threshold (float, optional): As of :class:`Predictor`.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> from torch_geometric_tactile.nn.models import TaxelNet
        >>> model = TaxelNet("biotac_sp", in_channels=3, out_channels=2)
        >>> entry = checkpoint_entry(model, FakeTactileDataset(20), None, "multiclass")
        >>> sorted(entry)
        ['header', 'tensors']
    """
    preparation = Preparation.of_dataset(dataset, transform)
    network = Network(model, dataset.class_names, task, threshold)
    header, tensors = describe_predictor(preparation, network)
    # Copies: a view would drag its whole storage into the checkpoint.
    return {"header": header, "tensors": {name: t.clone() for name, t in tensors.items()}}


def model_entry(model: Module, layout: TaxelLayout | None) -> dict[str, Any]:
    r"""Returns what :func:`build_model` builds a model of, as plain data and tensors: its name and
    arguments, or of a user's own its name and text.

    Args:
        model (torch.nn.Module): The model.
        layout (TaxelLayout, optional): The layout of the sensor, which is not repeated.

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
    r"""Builds a model of what :func:`model_entry` returned, with weights that are still to be
    loaded. Only models of this package are built by their names.

    Args:
        entry (Mapping): What :func:`model_entry` returned.
        weights (Mapping of str to torch.Tensor): The weights, which limit its size.
        layout (TaxelLayout, optional): The layout of the sensor.
        model (torch.nn.Module, optional): The model, if it is the user's own; it is copied.

    Raises:
        ValueError: If it is unknown, or the user's own is missing or another one.

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
    r"""Builds the parts of a predictor."""
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
    parts = [
        None if header.get(key) is None else builder.transform(header[key]) for key in _TRANSFORMS
    ]
    window = header.get("window")  # older formats have none
    contact = header.get("contact")  # files before this rule have none
    num_channels, num_joints = header["num_channels"], header["num_joints"]
    for key, least in (("num_channels", 1), ("num_joints", 0)):
        number = header[key]
        if number is not None and (type(number) is not int or not least <= number <= _MOST):
            raise ValueError(
                f"its '{key}' must be a number from {least} to {_MOST} or null (got "
                f"{str(number)[:80]})"
            )
    preparation = Preparation(
        layout,
        shared,
        parts[1],
        parts[2],
        num_channels,
        num_joints,
        window=None if window is None else WindowCut.from_dict(window),
        frame_transform=parts[0],
        read_options=header.get("read_options"),  # older files have none
        info=_frame_info(header),
        contact=None if contact is None else ContactRule.from_dict(contact),
    )
    for part in preparation.fitted:
        fitted = part.center if part.attr == "joint" and num_joints else None
        if fitted is not None and fitted.size(-1) != num_joints:
            raise ValueError(
                f"{part!r} must be fitted on {num_joints} joints, as 'num_joints' says (got "
                f"{fitted.size(-1)})"
            )
    preparation.session.number = header["session"]
    built = builder.model(header["model"], model)
    load_weights(built, weights)
    names = tuple(map(str, header["class_names"]))
    score = header.get("score")  # most have none
    score = None if score is None else MeasuredScore.from_dict(score)
    return preparation, Network(built, names, header["task"], threshold, score)


def _frame_info(header: Mapping[str, Any]) -> FrameInfo | None:
    if "frames" in header:
        return FrameInfo.from_dict(header["frames"])
    _logger.warning(
        "a predictor of version %s does not say how its frames were made: the unit, rate and "
        "thinning of recordings are not compared with those of its training",
        header.get("package"),
    )
    return None


def save(preparation: Preparation, network: Network, path: PathLike) -> None:
    r"""Writes a predictor to a file, whole or not at all."""
    header, tensors = describe_predictor(preparation, network)
    for name, value in network.model.state_dict().items():
        if not isinstance(value, Tensor):
            raise ValueError(
                f"'model' must have tensors only in its state (got {type(value).__name__} in "
                f"'{name}')"
            )
        tensors[_WEIGHT + name] = value
    write_tensors(tensors, {_KEY: json.dumps(header)}, path)


def load(
    path: PathLike, model: Module | None = None, transforms: Sequence[Transform] | None = None
) -> tuple[Preparation, Network]:
    r"""Reads a predictor from a file."""
    if not Path(path).is_file():
        raise FileNotFoundError(
            f"there is no predictor '{path}'; write one with Predictor.save, or from a checkpoint "
            "with: tactile predict CHECKPOINT --save FILE"
        )
    if is_checkpoint(path):
        raise ValueError(f"'{path}' is a checkpoint: read it with Predictor.from_checkpoint")
    with explained(f"'{path}' is no predictor that can be read here"):
        tensors, texts, has_checksum = read_tensors(path)
        need(ENCODER_KEY not in texts, f"it is a pretrained encoder: {LAST_READER}")
        need(_KEY in texts, "it is not a file of Predictor.save")
        header = json.loads(texts[_KEY])
        if not has_checksum and header.get("format") != _OLD_FORMATS[0]:
            raise ValueError("it must have a checksum (got none): it is damaged")
        if not has_checksum:
            _logger.warning("'%s' has no checksum: save it again with this version", path)
        own = {name: t for name, t in tensors.items() if not name.startswith(_WEIGHT)}
        return build_predictor(header, own, _weights(tensors), model, transforms)


def load_checkpoint(
    path: PathLike, model: Module | None = None, transforms: Sequence[Transform] | None = None
) -> tuple[Preparation, Network]:
    r"""Reads a predictor from a checkpoint of ``tactile fit``."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no checkpoint '{path}'")
    with explained(f"'{path}' is no checkpoint that can be read here"):
        content = read_torch_file(path)
        entry = content.get("predictor") if isinstance(content, dict) else None
        if entry is None:
            raise ValueError(
                "it has no predictor: it was written by an older version, or trained on samples "
                "that share no layout, or without "
                "TactileDataModule; train again, or build one with Predictor.from_dataset"
            )
        weights = _weights(content["state_dict"])
        return build_predictor(entry["header"], entry["tensors"], weights, model, transforms)


def _weights(tensors: Mapping[str, Any]) -> dict[str, Any]:
    found = [name for name in tensors if name.startswith(_WEIGHT)]
    return {name.removeprefix(_WEIGHT): tensors[name] for name in found}


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
