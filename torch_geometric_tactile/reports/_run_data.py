r"""The predictor of a run and the test part of its data."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch_geometric_tactile import datasets
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile._user_modules import add_working_directory
from torch_geometric_tactile.data import Protocol, Split, StaticDataset, Trials, Windows
from torch_geometric_tactile.predictor import (
    MissingOwnError,
    Predictor,
    is_checkpoint,
    transform_classes,
)
from torch_geometric_tactile.transforms import fit_parts

_CONFIG_OPTION = "'--config FILE', which may name any class"


def open_predictor(path: PathLike, config: str | None = None) -> Predictor:
    r"""Reads a predictor from its file, or from a checkpoint of ``tactile fit``.

    A model or transforms of the user's own are built from a configuration that is given, never from
    one that lies beside the checkpoint.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no predictor or checkpoint '{path}'")
    read = Predictor.from_checkpoint if is_checkpoint(path) else Predictor.load
    own: dict[str, Any] = {}
    while True:
        try:
            return read(path, **own)
        except MissingOwnError as error:
            if config is None:
                raise ValueError(f"{error}: give the configuration of {_CONFIG_OPTION}") from error
            if error.argument in own:
                raise
            own[error.argument] = _own_parts(config, error.argument)


def load_data(path: PathLike, config: str | None = None, root: PathLike | None = None) -> Any:
    r"""Returns the data of a run as :class:`~torch_geometric_tactile.training.TactileDataModule`,
    without a transform after those of its data sets, set up.

    A configuration that is given may name any class. The one beside a checkpoint may be anyone's:
    it is a plain description of data sets, transforms and splits of this package, and its folders
    lie in the working directory.
    """
    beside = Path(path).absolute().parent.parent / "config.yaml"
    if config is None and not beside.is_file():
        raise FileNotFoundError(
            f"there is no '{beside}', the configuration of the run: give it with '--config'"
        )
    settings = _data_section(config or str(beside))
    if root is not None:
        for key in ("dataset", "val_dataset", "test_dataset"):
            if settings.get(key):
                settings[key].setdefault("init_args", {})["root"] = str(root)
    data = _own_data(settings) if config is not None else _described_data(settings, beside, root)
    data.transform = None  # the predictor has the fitted one
    data.setup()
    return data


def test_part(data: Any, predictor: Predictor) -> StaticDataset:
    r"""Returns the samples of the test part before the transform of their data set, and adapts the
    predictor to recording sessions that it has not seen.
    """
    if not predictor.layout.matches(data.layout):
        raise ValueError(
            f"the predictor must have layout '{data.layout.name}', as the data "
            f"(got '{predictor.layout.name}')"
        )
    part = copy.copy(data.test_dataloader().dataset)
    part.transform = None
    fit_parts(predictor.transform, part, adapt=True)
    return part


def _data_section(config: str) -> dict[str, Any]:
    from torch_geometric_tactile.training.config import load_config

    settings = load_config(config).get("data")
    if not isinstance(settings, Mapping):
        raise ValueError(f"configuration '{config}' must hold 'data' (got none)")
    return dict(settings)


def _own_parts(config: str, argument: str) -> Any:
    from torch_geometric_tactile.training import classifier_from_config
    from torch_geometric_tactile.training.config import load_config

    if argument != "model":
        data = _own_data(_data_section(config))
        return [data.dataset.pre_transform, data.dataset.transform, data.transform]
    settings = load_config(config)
    if not isinstance(settings.get("model"), Mapping):
        raise ValueError(f"configuration '{config}' must hold 'model' (got none)")
    add_working_directory()
    # Sizes that the configuration leaves out are those of its data.
    has_data = isinstance(settings.get("data"), Mapping)
    data = _own_data(settings["data"]) if has_data else None
    return classifier_from_config(settings["model"], data).model


def _own_data(settings: dict[str, Any]) -> Any:
    from lightning.pytorch.cli import instantiate_module

    from torch_geometric_tactile.training import TactileDataModule

    add_working_directory()
    return instantiate_module(TactileDataModule, settings)


def _described_data(settings: Mapping[str, Any], source: Path, root: PathLike | None) -> Any:
    # Of plain values and names; no name is imported, and no text is parsed.
    from torch_geometric_tactile.training import TactileDataModule
    from torch_geometric_tactile.training._layout_text import layout_from_text

    found = [Protocol, Split, Trials, Windows, *(getattr(datasets, n) for n in datasets.__all__)]
    classes = {cls.__name__: cls for cls in found if isinstance(cls, type)} | transform_classes()

    def built(value: Any) -> Any:
        if isinstance(value, list):
            return [built(item) for item in value]
        if not isinstance(value, Mapping):
            return value
        if "class_path" not in value:
            return {key: built(item) for key, item in value.items()}
        path, arguments = str(value["class_path"]), value.get("init_args") or {}
        cls = classes.get(path.rpartition(".")[2])
        if cls is None or not f"{cls.__module__}.".startswith(f"{path.partition('.')[0]}."):
            raise ValueError(f"it names '{path}', which is not built by name")
        folder = arguments.get("root")
        if folder is not None and str(folder) != str(root) and not _is_inside(folder):
            raise ValueError(
                f"'root' must lie in the working directory (got '{folder}'), since processed files "
                "are written there: give '--root'"
            )
        parts = {key: built(item) for key, item in arguments.items()}
        if isinstance(parts.get("layout"), str):
            parts["layout"] = layout_from_text(parts["layout"])
        return cls(**parts)

    unused = ("transform", "train_transform")  # the predictor has the fitted one
    try:
        parts = {key: built(item) for key, item in settings.items() if key not in unused}
        data = TactileDataModule(**parts)
        data.setup()
        return data
    except OSError:
        raise
    except Exception as error:  # whatever a constructor makes of arguments that it cannot take
        told = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(
            f"'{source}' cannot be used: {told}; if it is your own, give it by {_CONFIG_OPTION}"
        ) from error


def _is_inside(folder: Any) -> bool:
    # PyG expands the home folder as well.
    return Path(str(folder)).expanduser().resolve().is_relative_to(Path.cwd().resolve())
