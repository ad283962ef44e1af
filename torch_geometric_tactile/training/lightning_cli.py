r"""The command line's ``fit``, ``validate``, ``test`` and ``predict``."""

import warnings
from collections.abc import Sequence
from typing import Any

from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.cli import ArgsType, LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from torch_geometric_tactile.training.checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training.config import find_config
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileClassifier, keep_config
from torch_geometric_tactile.training.prediction_writer import PredictionWriter


class TactileCLI(LightningCLI):
    r"""Lightning's command line for :class:`TactileClassifier` and :class:`TactileDataModule`.

    Checkpoints are plain data (read with :obj:`weights_only=True`) and written whole or not at
    all; every run logs to CSV and TensorBoard and keeps the checkpoint of its last epoch.

    Args:
        args (optional): The arguments; those of the process if left out.
        name (str): Folder of the run below :obj:`runs`.
        run (bool): Whether to run a subcommand.
    """

    def __init__(self, args: ArgsType = None, name: str = "tactile", run: bool = True) -> None:
        super().__init__(
            TactileClassifier,
            TactileDataModule,
            args=args,
            run=run,
            seed_everything_default=0,
            auto_configure_optimizers=False,
            parser_kwargs={"prog": "tactile"},
            trainer_defaults={
                "log_every_n_steps": 10,
                "plugins": [AtomicCheckpointIO()],
                "callbacks": [ModelCheckpoint(save_last=True), PredictionWriter()],
                "logger": [
                    {
                        "class_path": f"{CSVLogger.__module__}.CSVLogger",
                        "init_args": {"save_dir": "runs", "name": name},
                    },
                    {
                        "class_path": f"{TensorBoardLogger.__module__}.TensorBoardLogger",
                        "init_args": {"save_dir": "runs", "name": f"{name}/tensorboard"},
                    },
                ],
            },
        )

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        r"""Reads checkpoints as plain data unless told otherwise."""
        if any(action.dest == "weights_only" for action in parser._actions):
            parser.set_defaults({"weights_only": True})

    def after_instantiate_classes(self) -> None:
        r"""Keeps the model's configuration in its checkpoints."""
        config: dict[str, Any] = self.config_dump["model"]
        keep_config(self.model, config)


def main(args: Sequence[str]) -> None:
    r"""Runs a subcommand.

    Args:
        args (list of str): Name of the subcommand and its arguments; :obj:`--config` may name a
            shipped configuration.
    """
    args, name = resolve_config_names(args)
    with warnings.catch_warnings():
        # The arguments are those of the process, but for names of configurations made paths.
        warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")  # Lightning under torch 2.13
        TactileCLI(args, name=name or "tactile")


def resolve_config_names(args: Sequence[str]) -> tuple[list[str], str | None]:
    r"""Puts paths where :obj:`--config` names a shipped configuration.

    Args:
        args (list of str): Arguments of the command line.

    Returns:
        tuple: The arguments, and the stem of the last configuration's name.
    """
    out, name = list(args), None
    for i, arg in enumerate(out):
        flag, equals, value = arg.partition("=")
        if flag not in ("--config", "-c"):
            continue
        if equals:
            path = find_config(value)
            out[i] = f"{flag}={path}"
        elif i + 1 < len(out):
            path = find_config(out[i + 1])
            out[i + 1] = str(path)
        else:
            continue
        name = path.stem
    return out, name
