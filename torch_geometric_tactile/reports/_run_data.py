r"""Loads the predictor of a run and the test part of its data."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch_geometric_tactile import datasets
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile._user_modules import add_working_directory
from torch_geometric_tactile.data import Protocol, Split, StaticDataset, Trials, Windows
from torch_geometric_tactile.predictor import MissingOwnError, Predictor, predictor_path
from torch_geometric_tactile.predictor._classes import transform_classes
from torch_geometric_tactile.predictor._content import is_checkpoint
from torch_geometric_tactile.transforms import fit_parts

# A configuration can run code by naming classes, so only a file passed by the user may name them.
_CONFIG_OPTION = "'--config FILE', which may name any class"


def open_predictor(path: PathLike, config: str | None = None) -> Predictor:
    r"""Reads a predictor from its file, from a checkpoint of ``tactile fit``, or by the name of a
    predictor of the package.

    The user's own models and transforms are built only from the configuration :obj:`config`. They
    are never built from the configuration in the folder of the checkpoint, which may come from
    somebody else.
    """
    path = predictor_path(path)
    read = Predictor.from_checkpoint if is_checkpoint(path) else Predictor.load
    own_parts: dict[str, Any] = {}
    # Each attempt names at most one missing part: the model or the transforms.
    while True:
        try:
            return read(path, **own_parts)
        except MissingOwnError as error:
            if config is None:
                raise ValueError(
                    f"{error}; pass its configuration with {_CONFIG_OPTION}"
                ) from error
            if error.argument in own_parts:
                raise
            own_parts[error.argument] = _parts_from_config(config, error.argument)


def load_data(path: PathLike, config: str | None = None, root: PathLike | None = None) -> Any:
    r"""Returns the data of a run as a :class:`~torch_geometric_tactile.training.TactileDataModule`.
    The data module is set up, and has only the transforms of its data sets.

    The configuration :obj:`config` may name any class. The configuration in the folder of a
    checkpoint may come from somebody else. It may therefore only describe data sets, transforms
    and splits of this package, with folders in the working directory.
    """
    run_config = Path(path).absolute().parent.parent / "config.yaml"
    if config is None and not run_config.is_file():
        raise FileNotFoundError(
            f"there is no '{run_config}', the configuration of the run: pass it with '--config'"
        )
    settings = _data_section(config or str(run_config))
    if root is not None:
        for key in ("dataset", "val_dataset", "test_dataset"):
            if settings.get(key):
                settings[key].setdefault("init_args", {})["root"] = str(root)
    data = (
        _data_from_config(settings)
        if config is not None
        else _data_from_description(settings, run_config, root)
    )
    data.transform = None  # the predictor has the fitted transform
    data.setup()
    return data


def test_part(data: Any, predictor: Predictor) -> StaticDataset:
    r"""Returns the samples of the test part without transforms. Fits the transforms of the
    predictor on recording sessions that are missing from the training part.
    """
    if not predictor.layout.matches(data.layout):
        raise ValueError(
            f"the predictor must have layout '{data.layout.name}', like the data "
            f"(got '{predictor.layout.name}')"
        )
    part = copy.copy(data.test_dataloader().dataset)
    part.transform = None
    fit_parts(predictor.transform, part, adapt=True)
    return part


def _data_section(config: str) -> dict[str, Any]:
    from torch_geometric_tactile.training._config import load_config

    settings = load_config(config).get("data")
    if not isinstance(settings, Mapping):
        raise ValueError(f"configuration '{config}' must hold 'data' (got none)")
    return dict(settings)


def _parts_from_config(config: str, argument: str) -> Any:
    from torch_geometric_tactile.training import classifier_from_config
    from torch_geometric_tactile.training._config import load_config

    if argument != "model":
        data = _data_from_config(_data_section(config))
        return [data.dataset.pre_transform, data.dataset.transform, data.transform]
    settings = load_config(config)
    if not isinstance(settings.get("model"), Mapping):
        raise ValueError(f"configuration '{config}' must hold 'model' (got none)")
    add_working_directory()
    # Sizes that are missing from the configuration follow from its data.
    has_data = isinstance(settings.get("data"), Mapping)
    data = _data_from_config(settings["data"]) if has_data else None
    return classifier_from_config(settings["model"], data).model


def _data_from_config(settings: dict[str, Any]) -> Any:
    from lightning.pytorch.cli import instantiate_module

    from torch_geometric_tactile.training import TactileDataModule

    add_working_directory()
    return instantiate_module(TactileDataModule, settings)


def _data_from_description(settings: Mapping[str, Any], source: Path, root: PathLike | None) -> Any:
    # Security: builds known classes by name from plain values. No import path is followed.
    from torch_geometric_tactile.training import TactileDataModule
    from torch_geometric_tactile.training._layout_text import layout_from_text

    candidates = [
        Protocol,
        Split,
        Trials,
        Windows,
        *(getattr(datasets, n) for n in datasets.__all__),
    ]
    classes = {
        cls.__name__: cls for cls in candidates if isinstance(cls, type)
    } | transform_classes()

    def build(value: Any) -> Any:
        if isinstance(value, list):
            return [build(item) for item in value]
        if not isinstance(value, Mapping):
            return value
        if "class_path" not in value:
            return {key: build(item) for key, item in value.items()}
        path, arguments = str(value["class_path"]), value.get("init_args") or {}
        cls = classes.get(path.rpartition(".")[2])
        if cls is None or not f"{cls.__module__}.".startswith(f"{path.partition('.')[0]}."):
            raise ValueError(f"'{path}' is not a class of this package")
        folder = arguments.get("root")
        if folder is not None and str(folder) != str(root) and not _is_inside(folder):
            raise ValueError(
                f"'root' must lie in the working directory (got '{folder}'), since processed files "
                "are written there: pass '--root'"
            )
        parts = {key: build(item) for key, item in arguments.items()}
        if isinstance(parts.get("layout"), str):
            parts["layout"] = layout_from_text(parts["layout"])
        return cls(**parts)

    unused = ("transform", "train_transform")  # the predictor has the fitted transform
    try:
        parts = {key: build(item) for key, item in settings.items() if key not in unused}
        data = TactileDataModule(**parts)
        data.setup()
        return data
    except OSError:
        raise
    except Exception as error:  # constructors raise errors of any type for invalid arguments
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise ValueError(
            f"'{source}' cannot be used: {reason}; if you trust this file, pass it with "
            f"{_CONFIG_OPTION}"
        ) from error


def _is_inside(folder: Any) -> bool:
    # PyG also expands '~' in a root.
    return Path(str(folder)).expanduser().resolve().is_relative_to(Path.cwd().resolve())
