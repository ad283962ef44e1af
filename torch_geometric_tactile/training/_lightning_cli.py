r"""The command line's ``fit``, ``validate`` and ``test``."""

import logging
import os
import sys
import traceback
import warnings
from argparse import ArgumentError
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning as L
import yaml
from jsonargparse import ActionConfigFile, ArgumentParser
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.cli import (
    ArgsType,
    LightningArgumentParser,
    LightningCLI,
    instantiate_module,
)
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from tabulate import tabulate

from torch_geometric_tactile._user_modules import add_working_directory
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._checkpoint_file import compare_settings
from torch_geometric_tactile.training._config_files import merged, scratch_folder
from torch_geometric_tactile.training._given_arguments import (
    CONFIG,
    GivenArguments,
    parted,
    read_config,
)
from torch_geometric_tactile.training._layout_text import plain_section
from torch_geometric_tactile.training.checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training.config import find_config
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileModule
from torch_geometric_tactile.training.sizes import fill_sizes

_ADVERT = "💡 Tip:"
_LOGGERS = ("lightning.pytorch.utilities.rank_zero", "lightning.fabric.utilities.rank_zero")


class TactileCLI(LightningCLI):
    r"""Lightning's command line for :class:`TactileModule` and :class:`TactileDataModule`.

    The data is built before the rest is parsed, since the model's sizes follow from it (see
    :func:`~torch_geometric_tactile.training.sizes.fill_sizes`). Checkpoints are plain data (read
    with :obj:`weights_only=True`) and written whole or not at all; every run logs to CSV and
    TensorBoard and keeps the checkpoint of its last epoch.
    """

    def __init__(
        self,
        args: ArgsType = None,
        name: str = "tactile",
        run: bool = True,
        folder: str | None = None,
    ) -> None:
        self._data: TactileDataModule | None = None
        self._folder = folder
        super().__init__(
            TactileModule,
            TactileDataModule,
            args=args,
            run=run,
            seed_everything_default=0,
            auto_configure_optimizers=False,
            parser_kwargs={
                "prog": "tactile",
                "exit_on_error": False,  # one line, not a usage of seventy
                **{name: {"exit_on_error": False} for name in self.subcommands()},
            },
            trainer_defaults={
                "log_every_n_steps": 10,
                # By name, such that the configuration that a run keeps can be read again.
                "plugins": [{"class_path": f"{AtomicCheckpointIO.__module__}.AtomicCheckpointIO"}],
                "callbacks": [ModelCheckpoint(save_last=True)],
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

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        r"""Adds the arguments of trainer, model and data, which is built beforehand."""
        parser.add_lightning_class_args(self.trainer_class, "trainer")
        defaults = {f"trainer.{k}": v for k, v in self.trainer_defaults.items() if k != "callbacks"}
        parser.set_defaults(defaults)
        parser.add_lightning_class_args(TactileModule, "model")
        _add_data(parser, instantiate=False)

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        r"""Reads checkpoints as plain data unless told otherwise."""
        if any(action.dest == "weights_only" for action in parser._actions):
            parser.set_defaults({"weights_only": True})

    def parse_arguments(self, parser: LightningArgumentParser, args: ArgsType) -> None:
        r"""Builds the data, fills in the sizes of the model, and parses the arguments."""
        add_working_directory()
        args = sys.argv[1:] if args is None else args
        with _explained("the configuration cannot be used"):
            if isinstance(args, list):
                args = self._with_sizes(args)
            super().parse_arguments(parser, args)
            if self._data is not None:  # once more, for sizes given on the command line
                self._use_layout(fill_sizes(self._section()["model"].as_dict(), self._data))
            if self._folder is not None:
                self._use_folder(self._folder)

    def _section(self) -> Any:
        return self.config.get(str(self.config.get("subcommand")), self.config)

    def _use_layout(self, filled: dict[str, Any]) -> None:
        # For an argument without an annotation, whose text the parser would pass on.
        model = filled.get("model")
        layout = (model.get("init_args") or {}).get("layout") if isinstance(model, dict) else None
        if isinstance(layout, TaxelLayout):
            self._section()["model"]["model"]["init_args"]["layout"] = layout

    def _use_folder(self, folder: str) -> None:
        trainer = self._section()["trainer"]
        trainer["default_root_dir"] = folder
        loggers = trainer["logger"]
        for logger in loggers if isinstance(loggers, list) else [loggers]:
            if "save_dir" in (getattr(logger, "init_args", None) or {}):
                logger["init_args"]["save_dir"] = folder

    def _with_sizes(self, args: list[str]) -> list[str]:
        given = GivenArguments.read(args)
        has_data = bool(given.config.get("data")) or bool(given.of("data"))
        if not has_data or (given.only_informs and not given.prints_config):
            return args
        try:
            self._data = _build_data(given)
        except (OSError, ValueError) as error:
            if not given.prints_config:
                raise
            # What can be set must be printable before there is any data.
            sys.stderr.write(f"tactile: the sizes of the model are not filled in: {error}\n")
            return args
        model = dict(given.config.get("model") or {})
        if section := given.last("model"):  # a file of its own
            model = merged(model, read_config(Path(section)))
        chosen = given.last("model.model", "model.model.class_path")
        if chosen is not None:
            known = model.get("model")
            same = isinstance(known, dict) and known.get("class_path") == chosen
            model["model"] = known if same else {"class_path": chosen}
        task = given.last("model.task")
        model = fill_sizes({**model, "task": task} if task else model, self._data)
        model = plain_section(model)
        config = {**given.config, "model": model}
        path = scratch_folder() / "filled_sizes.yaml"
        path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
        subcommand = [arg for arg in given.others[:1] if not arg.startswith("-")]
        others = given.others[len(subcommand) :]
        return [*subcommand, "--config", str(path), *others]

    def instantiate_classes(self) -> None:
        r"""Builds the model and the trainer; the data is built already."""
        with _explained("the configuration cannot be used"):
            config = self.config.clone()
            section = config.get(str(self.subcommand), config)
            if self._data is None:
                self._data = instantiate_module(TactileDataModule, section["data"].as_dict())
            del section["data"]
            self.config_init = self.parser.instantiate_classes(config)
            self.config_init.get(str(self.subcommand), self.config_init)["data"] = self._data
            self.datamodule = self._data
            self.model = self._get(self.config_init, "model")
            self.trainer = self.instantiate_trainer()

    def _parse_ckpt_path(self) -> None:
        # Lightning (since 2.6) would build what the checkpoint says in place of the configuration.
        pass

    def after_instantiate_classes(self) -> None:
        r"""Keeps the model's configuration in its checkpoints, and compares it with that in the
        checkpoint that is loaded, from which nothing is built.
        """
        config: dict[str, Any] = self.config_dump["model"]
        self.model.config = config
        section = self.config.get(str(self.subcommand), self.config)
        path = section.get("ckpt_path")
        if path and Path(path).is_file() and section.get("weights_only") is not False:
            compare_settings(config, path)

    def _run_subcommand(self, subcommand: str) -> None:
        # What is left to Lightning to find in a checkpoint ends in errors of all kinds.
        try:
            super()._run_subcommand(subcommand)
        except Exception as error:
            path = self._get(self.config, "ckpt_path")
            frames = (
                frame.f_code.co_filename for frame, _ in traceback.walk_tb(error.__traceback__)
            )
            in_checkpoint = any(Path(name).name == "checkpoint_connector.py" for name in frames)
            if not path or not in_checkpoint or isinstance(error, OSError):
                raise
            raise ValueError(f"checkpoint '{path}' cannot be used here: {_told(error)}") from error

    def after_fit(self) -> None:
        r"""Prints what the training has come to."""
        folder = self.trainer.log_dir  # all processes ask, since they agree on it together
        if self.trainer.is_global_zero:
            sys.stdout.write(fit_summary(self.trainer, folder) + "\n")
            sys.stdout.flush()


@contextmanager
def _explained(what: str) -> Iterator[None]:
    # Constructors raise all kinds of errors for arguments that they cannot take.
    try:
        yield
    except (ImportError, OSError, ValueError):
        raise
    except Exception as error:
        raise ValueError(f"{what}: {_told(error)}") from error


def _told(error: Exception) -> str:
    is_plain = isinstance(error, ArgumentError | ValueError)
    return str(error) if is_plain else f"{type(error).__name__}: {error}"


def _add_data(parser: ArgumentParser, instantiate: bool) -> None:
    parser.add_class_arguments(
        TactileDataModule, "data", fail_untyped=False, instantiate=instantiate, sub_configs=True
    )


def _build_data(given: GivenArguments) -> TactileDataModule:
    seed = given.last("seed_everything") or given.config.get("seed_everything", 0)
    if not isinstance(seed, str | int):
        raise ValueError(f"'seed_everything' must be a number (got {seed!r})")
    if str(seed).lower() not in ("true", "false"):
        L.seed_everything(int(seed), verbose=False)  # for data that is drawn
    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--config", action=ActionConfigFile)
    _add_data(parser, instantiate=True)
    path = scratch_folder() / "data.yaml"
    content = {"data": given.config.get("data") or {}}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    try:
        parsed = parser.parse_args(["--config", str(path), *given.of("data")])
    except ArgumentError as error:
        raise ValueError(f"the section 'data' cannot be read: {error}") from error
    return parser.instantiate_classes(parsed).data


def run_lightning(args: Sequence[str]) -> None:
    r"""Runs a subcommand."""
    add_working_directory()
    args, folder = _output_folder(args)
    args, name = resolve_config_names(args)
    with warnings.catch_warnings(), _no_adverts():
        # The arguments are those of the process, but for names of configurations made paths.
        warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")  # Lightning under torch 2.13
        # Each run has a folder of its own, also one that resumes.
        warnings.filterwarnings("ignore", message="The dirpath has changed")
        TactileCLI(args, name=name or "tactile", folder=folder)


def _output_folder(args: Sequence[str]) -> tuple[list[str], str | None]:
    found, others = parted(args, "--out".__eq__)
    for _, folder in found:
        if not folder or folder.startswith("--"):
            raise ValueError(f"'--out' must be a folder (got {folder or ''!r})")
    return others, found[-1][1] if found else None


def resolve_config_names(args: Sequence[str]) -> tuple[list[str], str | None]:
    r"""Puts paths where :obj:`--config` names a shipped configuration."""
    out, name = list(args), None
    for i, arg in enumerate(out):
        flag, equals, value = arg.partition("=")
        if flag not in CONFIG:
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


def fit_summary(trainer: L.Trainer, folder: str | None = None) -> str:
    r"""Returns the last metrics of the validation part as a small table, the paths of the
    checkpoints, and the command that tests the last one. The test part is not looked at.
    """
    values = {key: float(value) for key, value in trainer.callback_metrics.items()}
    rows = [(key, values[key]) for key in sorted(values) if key.startswith("val/")]
    text = ["", f"After {trainer.current_epoch} epochs:", ""]
    if not rows:
        text[1] += " (there is no validation part)"
    if "train/loss" in values:
        rows.insert(0, ("train/loss", values["train/loss"]))
    text += [tabulate(rows, headers=("metric", "value"), floatfmt=".4f"), ""]
    checkpoint = None
    for callback in trainer.checkpoint_callbacks:
        if isinstance(callback, ModelCheckpoint):
            last, best = callback.last_model_path, callback.best_model_path
            checkpoint = checkpoint or last or best
            if callback.monitor and best:
                text.append(f"Best checkpoint by {callback.monitor}: {_short(best)}")
            if last:
                text.append(f"Last checkpoint: {_short(last)}")
    if checkpoint:
        text.append(_next_step(trainer, checkpoint, folder))
    return "\n".join(text)


def _next_step(trainer: L.Trainer, checkpoint: str, folder: str | None) -> str:
    data = getattr(trainer, "datamodule", None)
    if isinstance(data, TactileDataModule) and not len(data.part("test")):
        return "There is no test part: give 'data.test_dataset', or a 'data.test' above 0."
    config = None if folder is None else Path(folder) / "config.yaml"
    named = _short(config) if config is not None and config.is_file() else "CONFIG"
    short = _short(checkpoint)
    test = f"Test it:\n  tactile test --config {named} --ckpt_path {short}"
    if isinstance(data, TactileDataModule) and data.layout is None:
        return test  # a predictor is of one layout
    return (
        f"{test}\n"
        "Use it on raw readings (scaling included), or on a robot without PyTorch:\n"
        f"  tactile predict {short} RECORDING\n  tactile export {short} model.onnx"
    )


def _short(path: str | Path) -> str:
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative


@contextmanager
def _no_adverts() -> Iterator[None]:
    r"""Drops the messages in which Lightning recommends other products of its maker; all other
    messages and warnings are shown.
    """
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    for logger in loggers:
        logger.addFilter(_is_no_advert)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(_is_no_advert)


def _is_no_advert(record: logging.LogRecord) -> bool:
    return not str(record.msg).startswith(_ADVERT)
