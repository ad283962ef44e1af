r"""The predictor of a run and the test part of its data."""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.predictor import MissingOwnError, Predictor, is_checkpoint
from torch_geometric_tactile.transforms import fit_parts
from torch_geometric_tactile.typing import PathLike


def open_predictor(
    path: PathLike, config: str | None = None, allow: Sequence[str] = ()
) -> Predictor:
    r"""Reads a predictor from its file, or from a checkpoint of ``tactile fit``.

    A model or transforms of the user's own are built from the configuration.

    Args:
        path (str or PathLike): The file or checkpoint.
        config (str, optional): The configuration, a file or a shipped one; that of the run if left
            out.
        allow (sequence of str): As of :func:`run_config`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file cannot be read.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no predictor or checkpoint '{path}'")
    read = Predictor.from_checkpoint if is_checkpoint(path) else Predictor.load
    own: dict[str, Any] = {}
    while True:
        try:
            return read(path, **own)
        except MissingOwnError as error:
            settings = run_config(path, config, allow)
            if settings is None or error.argument in own:
                raise
            own[error.argument] = _own_parts(settings, error.argument)


def run_config(
    path: PathLike, config: str | None = None, allow: Sequence[str] = ()
) -> dict[str, Any] | None:
    r"""Reads the sections :obj:`data` and :obj:`model` of the configuration of a run, or returns
    :obj:`None` if there is none.

    A configuration that is given may name any class. One that is found beside a checkpoint may be
    anyone's: only classes that
    :func:`~torch_geometric_tactile.training.safe_classes.safe_section` lets through are built.

    Args:
        path (str or PathLike): A checkpoint of the run.
        config (str, optional): The configuration; the :obj:`config.yaml` that the run has beside
            its checkpoints if left out.
        allow (sequence of str): Packages, modules or classes of your own that the latter may name.

    Raises:
        ValueError: If it cannot be read, or names a class that it must not.
    """
    beside = Path(path).absolute().parent.parent / "config.yaml"
    if config is None and not beside.is_file():
        return None
    from torch_geometric_tactile.training.config import load_config
    from torch_geometric_tactile.training.given_arguments import own_modules
    from torch_geometric_tactile.training.safe_classes import safe_section

    settings = load_config(config or str(beside))
    if not isinstance(settings.get("data"), Mapping):
        raise ValueError(f"configuration '{config or beside}' must hold 'data' (got none)")
    if config is not None:
        return settings
    if allow:
        own_modules()
    return {
        key: safe_section(key, settings[key], beside, allow)
        for key in ("data", "model")
        if key in settings
    }


def load_data(
    path: PathLike,
    config: str | None = None,
    root: PathLike | None = None,
    allow: Sequence[str] = (),
) -> Any:
    r"""Returns the data of a run as :class:`~torch_geometric_tactile.training.TactileDataModule`,
    without a transform after those of its data sets, set up.

    Args:
        path (str or PathLike): A checkpoint of the run.
        config (str, optional): As of :func:`run_config`.
        root (str or PathLike, optional): Folder of the data, instead of the configuration's.
        allow (sequence of str): As of :func:`run_config`.

    Raises:
        FileNotFoundError: If there is no configuration.
        ValueError: As of :func:`run_config`.
    """
    settings = run_config(path, config, allow)
    if settings is None:
        raise FileNotFoundError(
            f"there is no '{Path(path).absolute().parent.parent / 'config.yaml'}', the "
            "configuration of the run: give it with '--config'"
        )
    settings = settings["data"]
    if root is not None:
        for key in ("dataset", "val_dataset", "test_dataset"):
            if settings.get(key):
                settings[key].setdefault("init_args", {})["root"] = str(root)
    data = _data_module(settings)
    data.transform = None  # the predictor has the fitted one
    data.setup()
    return data


def test_part(data: Any, predictor: Predictor) -> StaticDataset:
    r"""Returns the samples of the test part before the transform of their data set, and adapts the
    predictor to recording sessions that it has not seen.

    Args:
        data (TactileDataModule): The data, set up.
        predictor (Predictor): The predictor.

    Raises:
        ValueError: If there is no test part, or the layouts differ.
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


def _own_parts(settings: dict[str, Any], argument: str) -> Any:
    from torch_geometric_tactile.training import classifier_from_config

    data = _data_module(settings["data"])
    if argument == "model":
        if not isinstance(settings.get("model"), Mapping):
            raise ValueError("the configuration must hold 'model' (got none)")
        return classifier_from_config(settings["model"], data).model
    return [data.dataset.pre_transform, data.dataset.transform, data.transform]


def _data_module(settings: dict[str, Any]) -> Any:
    from lightning.pytorch.cli import instantiate_module

    from torch_geometric_tactile.training import TactileDataModule
    from torch_geometric_tactile.training.given_arguments import own_modules

    own_modules()
    return instantiate_module(TactileDataModule, settings)
