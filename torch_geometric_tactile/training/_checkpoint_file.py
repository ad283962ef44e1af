r"""Reading the file of a checkpoint."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import lightning as L
import torch

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._allocation_limit import AllocationLimit
from torch_geometric_tactile.data._torch_file import read_torch_file
from torch_geometric_tactile.predictor import build_model
from torch_geometric_tactile.sensors import TaxelLayout

_MODEL = ("model", "num_classes", "task")  # settings that a model is another one by


_logger = logging.getLogger(__name__)


_T = TypeVar("_T", bound=L.LightningModule)


def read_checkpoint(
    path: PathLike, map_location: Any | None = None, needs: Sequence[str] = ("state_dict",)
) -> dict[str, Any]:
    r"""Reads a checkpoint as plain data and tensors, after its checksums were compared."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no checkpoint '{path}'")
    content = read_torch_file(path, map_location)
    for name in needs:
        if not isinstance(content, dict) or not isinstance(content.get(name), Mapping):
            raise ValueError(f"'{path}' is no checkpoint: it must hold '{name}' (got none)")
    checkpoint: dict[str, Any] = content
    return checkpoint


def load_module(
    cls: type[_T],
    path: PathLike,
    map_location: Any,
    strict: bool | None,
    arguments: Mapping[str, Any],
) -> _T:
    r"""Builds a module from the plain description and the weights of a checkpoint. Nothing in it is
    parsed or imported: the model is one of this package by its name, or is given.
    """
    checkpoint = read_checkpoint(path, "cpu" if map_location is None else map_location)
    if not isinstance(checkpoint.get("module"), Mapping):
        raise ValueError(
            f"'{path}' must hold the description of its module (got none: until version 0.2.0 it "
            "was kept as import paths, which are not followed any more): use "
            "Predictor.from_checkpoint(path), or build the module as for its training and use "
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
    except Exception as error:  # whatever other contents lead to
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(f"no {cls.__name__} can be built from '{path}': {reason}") from error
    tensors = (value for value in weights.values() if isinstance(value, torch.Tensor))
    return module.to(next(tensors, torch.empty(0)).device)


def compare_settings(config: Mapping[str, Any], path: PathLike) -> None:
    r"""Compares the :obj:`model` section of a configuration with what a checkpoint was trained by.
    What is of the training only, such as the optimizer, may differ; it is logged.
    """
    stored = read_checkpoint(path, "cpu").get("config")
    if not isinstance(stored, Mapping):
        return
    other = []
    for key in stored.keys() & config.keys():
        found = list(_differences(config[key], stored[key], f"model.{key}"))
        if key in _MODEL:
            other += found
        elif found:
            _logger.warning(
                "taken from the configuration instead of '%s': %s", path, "; ".join(found)
            )
    if other:
        raise ValueError(
            f"checkpoint '{path}' must hold the model of the configuration ({'; '.join(other)}): "
            "give the configuration of its training, such as the config.yaml of its run"
        )


def _differences(config: Any, stored: Any, where: str) -> Iterator[str]:
    if isinstance(config, Mapping) and isinstance(stored, Mapping):
        classes = [str(part.get("class_path", "")).rpartition(".")[2] for part in (config, stored)]
        if classes[0] != classes[1]:
            yield f"'{where}' is {classes[0]}, in the checkpoint {classes[1]}"
            return
        for key in config.keys() & stored.keys() - {"class_path", "layout"}:
            yield from _differences(config[key], stored[key], f"{where}.{key}")
    elif _plain(config) != _plain(stored):
        yield f"'{where}' is {config!r}, in the checkpoint {stored!r}"


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    try:
        return float(value)  # '1e-3' is a text to YAML
    except (TypeError, ValueError):
        return value
