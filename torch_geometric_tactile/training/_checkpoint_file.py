r"""Reads checkpoint files."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import lightning as L
import torch

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._allocation_limit import AllocationLimit
from torch_geometric_tactile.data._torch_file import read_torch_file
from torch_geometric_tactile.predictor._content import build_model
from torch_geometric_tactile.sensors import TaxelLayout

# Settings that define the model. All other settings only affect the training and may differ.
_MODEL_SETTINGS = ("model", "num_classes", "task")

_logger = logging.getLogger(__name__)

_T = TypeVar("_T", bound=L.LightningModule)


def read_checkpoint(
    path: PathLike, map_location: Any | None = None, required_keys: Sequence[str] = ("state_dict",)
) -> dict[str, Any]:
    r"""Reads a checkpoint as plain data and tensors, and verifies its checksums."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no checkpoint '{path}'")
    content = read_torch_file(path, map_location)
    for key in required_keys:
        if not isinstance(content, dict) or not isinstance(content.get(key), Mapping):
            raise ValueError(f"'{path}' is not a checkpoint: it must hold '{key}' (got none)")
    checkpoint: dict[str, Any] = content
    return checkpoint


def load_module(
    cls: type[_T],
    path: PathLike,
    map_location: Any,
    strict: bool | None,
    arguments: Mapping[str, Any],
) -> _T:
    r"""Returns a module built from the plain description and the weights in a checkpoint.

    No code or import path in the file is executed: the model is a class of this package, which is
    looked up by its name, or the argument :obj:`model`.
    """
    checkpoint = read_checkpoint(path, "cpu" if map_location is None else map_location)
    if not isinstance(checkpoint.get("module"), Mapping):
        raise ValueError(
            f"'{path}' must hold the description of its module (got none: until version 0.2.0 it "
            "was stored as import paths, which are no longer followed): use "
            "Predictor.from_checkpoint(path), or build the module as for training and use "
            "trainer.test(module, datamodule=data, ckpt_path=path), or train again"
        )
    weights = checkpoint["state_dict"]
    arguments = dict(arguments)
    try:
        with AllocationLimit(weights.values()):
            entry, layout = checkpoint["module"], checkpoint.get("layout")
            layout = None if layout is None else TaxelLayout.from_dict(layout)
            model = build_model(entry, weights, layout, arguments.pop("model", None))
            module = cls(model, **{**entry["arguments"], **arguments})
        module.on_load_checkpoint(checkpoint)
        module.load_state_dict(weights, strict=strict is not False)
    except Exception as error:  # a damaged file may cause any error in a constructor
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(f"a {cls.__name__} cannot be built from '{path}': {reason}") from error
    tensors = (weight for weight in weights.values() if isinstance(weight, torch.Tensor))
    return module.to(next(tensors, torch.empty(0)).device)


def compare_settings(config: Mapping[str, Any], path: PathLike) -> None:
    r"""Compares the :obj:`model` section of a configuration with the section stored in a
    checkpoint. Differences in training settings, such as the optimizer, are only logged.

    Raises:
        ValueError: If the settings of the model differ.
    """
    stored = read_checkpoint(path, "cpu").get("config")
    if not isinstance(stored, Mapping):
        return
    model_differences = []
    for key in stored.keys() & config.keys():
        differences = list(_differences(config[key], stored[key], f"model.{key}"))
        if key in _MODEL_SETTINGS:
            model_differences += differences
        elif differences:
            _logger.warning(
                "using settings from the configuration instead of '%s': %s",
                path,
                "; ".join(differences),
            )
    if model_differences:
        raise ValueError(
            f"checkpoint '{path}' must match the model in the configuration "
            f"({'; '.join(model_differences)}); pass the configuration of its training, such as "
            "the config.yaml of its run"
        )


def _differences(config: Any, stored: Any, path: str) -> Iterator[str]:
    if isinstance(config, Mapping) and isinstance(stored, Mapping):
        classes = [str(part.get("class_path", "")).rpartition(".")[2] for part in (config, stored)]
        if classes[0] != classes[1]:
            yield f"'{path}' is {classes[0]} here and {classes[1]} in the checkpoint"
            return
        for key in config.keys() & stored.keys() - {"class_path", "layout"}:
            yield from _differences(config[key], stored[key], f"{path}.{key}")
    elif _to_comparable(config) != _to_comparable(stored):
        yield f"'{path}' is {config!r} here and {stored!r} in the checkpoint"


def _to_comparable(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_to_comparable(item) for item in value]
    try:
        return float(value)  # YAML reads '1e-3' as a string
    except (TypeError, ValueError):
        return value
