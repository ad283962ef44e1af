r"""The commands ``fit``, ``validate`` and ``test``."""

import logging
import os
import sys
import traceback
import warnings
from argparse import ArgumentError
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

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
from torch_geometric_tactile.training._checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training._checkpoint_file import compare_settings
from torch_geometric_tactile.training._config import find_config
from torch_geometric_tactile.training._config_files import merged, read_yaml, scratch_folder
from torch_geometric_tactile.training._layout_text import plain_section
from torch_geometric_tactile.training._sizes import fill_sizes
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileModule

_CONFIG_FLAGS = ("--config", "-c")
_SECTIONS = ("data", "model", "trainer")
_ADVERT_PREFIX = "💡 Tip:"
_ADVERT_LOGGERS = ("lightning.pytorch.utilities.rank_zero", "lightning.fabric.utilities.rank_zero")


@dataclass
class UnparsedArguments:
    r"""The merged configuration files, in order, and the remaining arguments."""

    config: dict[str, Any] = field(default_factory=dict)
    remaining: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, args: Sequence[str]) -> Self:
        r"""Reads the configuration files named in the arguments."""
        configs, remaining = extract_options(args, _CONFIG_FLAGS.__contains__)
        arguments = cls(remaining=remaining)
        for flag, path in configs:
            if path is None:
                arguments.remaining.append(flag)
            else:
                arguments.config = merged(arguments.config, read_config(Path(path)))
        return arguments

    @property
    def only_prints(self) -> bool:
        r"""Whether only the help or the configuration is printed and nothing is run."""
        flags = [arg.partition("=")[0] for arg in self.remaining]
        is_help = any(flag in ("-h", "--help") or flag.endswith(".help") for flag in flags)
        return is_help or self.prints_config

    @property
    def prints_config(self) -> bool:
        r"""Whether the configuration is printed."""
        return any(arg.partition("=")[0] == "--print_config" for arg in self.remaining)

    def section_arguments(self, section: str) -> list[str]:
        r"""Returns the arguments that change a section of the configuration."""
        start = f"--{section}"
        options, _ = extract_options(
            self.remaining, lambda flag: f"{flag}.".startswith(f"{start}.")
        )
        return [f"{flag}={value or ''}" for flag, value in options]

    def last_value(self, *names: str) -> str | None:
        r"""Returns the last value of an option, or :obj:`None` if the option is absent."""
        options, _ = extract_options(self.remaining, {f"--{name}" for name in names}.__contains__)
        return options[-1][1] if options else None


def extract_options(
    args: Sequence[str], is_match: Callable[[str], bool]
) -> tuple[list[tuple[str, str | None]], list[str]]:
    r"""Returns the matching options with their values (:obj:`None` for a missing value), and the
    remaining arguments.
    """
    options, remaining, arguments = [], [], iter(args)
    for arg in arguments:
        flag, equals, value = arg.partition("=")
        if is_match(flag):
            options.append((flag, value if equals else next(arguments, None)))
        else:
            remaining.append(arg)
    return options, remaining


def read_config(path: Path) -> dict[str, Any]:
    r"""Reads a configuration file and the files to which its sections refer."""
    content = _read_mapping(path)
    for section in _SECTIONS:  # a section may be the name of a file in the same folder
        if isinstance(content.get(section), str):
            content[section] = _read_mapping(path.parent / content[section])
        value = content.get(section)
        if value is not None and not isinstance(value, Mapping):
            raise ValueError(
                f"'{section}' of configuration '{path}' must be a mapping (got {value!r})"
            )
    return content


def _read_mapping(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FileNotFoundError(f"the configuration '{path}' does not exist")
    content = read_yaml(path)
    if content is None:
        return {}
    if not isinstance(content, Mapping):
        raise ValueError(
            f"configuration '{path}' must be a mapping with the keys {', '.join(_SECTIONS)} (got "
            f"{type(content).__name__})"
        )
    return dict(content)


class TactileCLI(LightningCLI):
    r"""Lightning's command line for :class:`TactileModule` and :class:`TactileDataModule`.

    The data is built before all other arguments are parsed, because the sizes of the model follow
    from the data (see :func:`~torch_geometric_tactile.training._sizes.fill_sizes`). Checkpoints are
    plain data (read with :obj:`weights_only=True`) and are written atomically. Every run logs to
    CSV and TensorBoard and saves the checkpoint of its last epoch.
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
                "exit_on_error": False,  # a one-line error instead of 70 lines of usage
                **{name: {"exit_on_error": False} for name in self.subcommands()},
            },
            trainer_defaults={
                "log_every_n_steps": 10,
                # Passed by name, so that the saved configuration of a run can be read again.
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
        r"""Adds the arguments of the trainer, the model and the data. The data is built before."""
        parser.add_lightning_class_args(self.trainer_class, "trainer")
        defaults = {f"trainer.{k}": v for k, v in self.trainer_defaults.items() if k != "callbacks"}
        parser.set_defaults(defaults)
        parser.add_lightning_class_args(TactileModule, "model")
        _add_data_arguments(parser, instantiate=False)

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        r"""Makes :obj:`weights_only=True` the default, so that checkpoints run no code."""
        if any(action.dest == "weights_only" for action in parser._actions):
            parser.set_defaults({"weights_only": True})

    def parse_arguments(self, parser: LightningArgumentParser, args: ArgsType) -> None:
        r"""Builds the data, fills in the sizes of the model, and parses the arguments."""
        add_working_directory()
        args = sys.argv[1:] if args is None else args
        with _as_value_error("the configuration cannot be used"):
            if isinstance(args, list):
                args = self._with_sizes(args)
            super().parse_arguments(parser, args)
            if self._data is not None:  # fill in again, to check sizes from the command line
                self._use_layout(fill_sizes(self._section()["model"].as_dict(), self._data))
            if self._folder is not None:
                self._use_folder(self._folder)

    def _section(self) -> Any:
        return self.config.get(str(self.config.get("subcommand")), self.config)

    def _use_layout(self, section: dict[str, Any]) -> None:
        # Needed for an argument without an annotation: the parser would pass the text.
        model = section.get("model")
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
        arguments = UnparsedArguments.read(args)
        has_data = bool(arguments.config.get("data")) or bool(arguments.section_arguments("data"))
        if not has_data or (arguments.only_prints and not arguments.prints_config):
            return args
        try:
            self._data = _build_data(arguments)
        except (OSError, ValueError) as error:
            if not arguments.prints_config:
                raise
            # Users print the configuration to see its settings before they have data.
            sys.stderr.write(f"tactile: the sizes of the model are not filled in: {error}\n")
            return args
        model = dict(arguments.config.get("model") or {})
        if section := arguments.last_value("model"):  # the name of a file with this section
            model = merged(model, read_config(Path(section)))
        class_path = arguments.last_value("model.model", "model.model.class_path")
        if class_path is not None:
            config_model = model.get("model")
            is_same_class = (
                isinstance(config_model, dict) and config_model.get("class_path") == class_path
            )
            model["model"] = config_model if is_same_class else {"class_path": class_path}
        task = arguments.last_value("model.task")
        model = fill_sizes({**model, "task": task} if task else model, self._data)
        model = plain_section(model)
        config = {**arguments.config, "model": model}
        path = scratch_folder() / "filled_sizes.yaml"
        path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
        subcommand = [arg for arg in arguments.remaining[:1] if not arg.startswith("-")]
        remaining = arguments.remaining[len(subcommand) :]
        return [*subcommand, "--config", str(path), *remaining]

    def instantiate_classes(self) -> None:
        r"""Builds the model and the trainer. The data is already built."""
        with _as_value_error("the configuration cannot be used"):
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
        # Since version 2.6, Lightning would replace the configuration by the stored configuration.
        pass

    def after_instantiate_classes(self) -> None:
        r"""Stores the model's configuration for checkpoints, and compares it with the configuration
        in a loaded checkpoint. Nothing is built from the checkpoint's configuration.
        """
        config: dict[str, Any] = self.config_dump["model"]
        self.model.config = config
        section = self.config.get(str(self.subcommand), self.config)
        path = section.get("ckpt_path")
        if path and Path(path).is_file() and section.get("weights_only") is not False:
            compare_settings(config, path)

    def _run_subcommand(self, subcommand: str) -> None:
        # Lightning raises errors of any type for invalid parts of a checkpoint.
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
            raise ValueError(
                f"checkpoint '{path}' cannot be used here: {_error_text(error)}"
            ) from error

    def after_fit(self) -> None:
        r"""Prints the metrics and the checkpoints of the training."""
        folder = self.trainer.log_dir  # Lightning broadcasts it, so all processes must access it
        if self.trainer.is_global_zero:
            sys.stdout.write(fit_summary(self.trainer, folder) + "\n")
            sys.stdout.flush()


@contextmanager
def _as_value_error(summary: str) -> Iterator[None]:
    # Constructors raise errors of any type for invalid arguments.
    try:
        yield
    except (ImportError, OSError, ValueError):
        raise
    except Exception as error:
        raise ValueError(f"{summary}: {_error_text(error)}") from error


def _error_text(error: Exception) -> str:
    is_plain = isinstance(error, ArgumentError | ValueError)
    return str(error) if is_plain else f"{type(error).__name__}: {error}"


def _add_data_arguments(parser: ArgumentParser, instantiate: bool) -> None:
    parser.add_class_arguments(
        TactileDataModule, "data", fail_untyped=False, instantiate=instantiate, sub_configs=True
    )


def _build_data(arguments: UnparsedArguments) -> TactileDataModule:
    seed = arguments.last_value("seed_everything") or arguments.config.get("seed_everything", 0)
    if not isinstance(seed, str | int):
        raise ValueError(f"'seed_everything' must be a number (got {seed!r})")
    if str(seed).lower() not in ("true", "false"):
        L.seed_everything(int(seed), verbose=False)  # data may be generated at random
    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--config", action=ActionConfigFile)
    _add_data_arguments(parser, instantiate=True)
    path = scratch_folder() / "data.yaml"
    content = {"data": arguments.config.get("data") or {}}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    try:
        parsed = parser.parse_args(["--config", str(path), *arguments.section_arguments("data")])
    except ArgumentError as error:
        raise ValueError(f"the section 'data' cannot be read: {error}") from error
    return parser.instantiate_classes(parsed).data


def run_lightning(args: Sequence[str]) -> None:
    r"""Runs a subcommand of Lightning's command line."""
    add_working_directory()
    args, folder = _output_folder(args)
    args, name = resolve_config_names(args)
    with warnings.catch_warnings(), _without_adverts():
        # The warning is wrong: these are the arguments of the process, with paths in place of names
        # of configurations.
        warnings.filterwarnings("ignore", message="LightningCLI's args parameter")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")  # Lightning under torch 2.13
        # Every run has its own folder, even when it resumes another run.
        warnings.filterwarnings("ignore", message="The dirpath has changed")
        TactileCLI(args, name=name or "tactile", folder=folder)


def _output_folder(args: Sequence[str]) -> tuple[list[str], str | None]:
    folders, remaining = extract_options(args, "--out".__eq__)
    for _, folder in folders:
        if not folder or folder.startswith("--"):
            raise ValueError(f"'--out' must be a folder (got {folder or ''!r})")
    return remaining, folders[-1][1] if folders else None


def resolve_config_names(args: Sequence[str]) -> tuple[list[str], str | None]:
    r"""Replaces names of shipped configurations after :obj:`--config` by paths. Returns the
    arguments and the name of the last configuration, or :obj:`None` if there is none.
    """
    resolved, name = list(args), None
    for i, arg in enumerate(resolved):
        flag, equals, value = arg.partition("=")
        if flag not in _CONFIG_FLAGS:
            continue
        if equals:
            path = find_config(value)
            resolved[i] = f"{flag}={path}"
        elif i + 1 < len(resolved):
            path = find_config(resolved[i + 1])
            resolved[i + 1] = str(path)
        else:
            continue
        name = path.stem
    return resolved, name


def fit_summary(trainer: L.Trainer, folder: str | None = None) -> str:
    r"""Returns a table with the last metrics on the validation part, the paths of the checkpoints,
    and the command that tests the last checkpoint. The test part is not used.
    """
    metrics = {key: float(value) for key, value in trainer.callback_metrics.items()}
    rows = [(key, metrics[key]) for key in sorted(metrics) if key.startswith("val/")]
    lines = ["", f"After {trainer.current_epoch} epochs:", ""]
    if not rows:
        lines[1] += " (there is no validation part)"
    if "train/loss" in metrics:
        rows.insert(0, ("train/loss", metrics["train/loss"]))
    lines += [tabulate(rows, headers=("metric", "value"), floatfmt=".4f"), ""]
    checkpoint = None
    for callback in trainer.checkpoint_callbacks:
        if isinstance(callback, ModelCheckpoint):
            last, best = callback.last_model_path, callback.best_model_path
            checkpoint = checkpoint or last or best
            if callback.monitor and best:
                lines.append(f"Best checkpoint by {callback.monitor}: {_relative_path(best)}")
            if last:
                lines.append(f"Last checkpoint: {_relative_path(last)}")
    if checkpoint:
        lines.append(_next_commands(trainer, checkpoint, folder))
    return "\n".join(lines)


def _next_commands(trainer: L.Trainer, checkpoint: str, folder: str | None) -> str:
    data = getattr(trainer, "datamodule", None)
    if isinstance(data, TactileDataModule) and not len(data.part("test")):
        return "There is no test part: set 'data.test_dataset', or 'data.test' above 0."
    config = None if folder is None else Path(folder) / "config.yaml"
    config_path = _relative_path(config) if config is not None and config.is_file() else "CONFIG"
    checkpoint_path = _relative_path(checkpoint)
    test = f"To test it:\n  tactile test --config {config_path} --ckpt_path {checkpoint_path}"
    if isinstance(data, TactileDataModule) and data.layout is None:
        return test  # a predictor needs a layout
    return (
        f"{test}\n"
        "To use it on raw readings (with scaling), or on a robot without PyTorch:\n"
        f"  tactile predict {checkpoint_path} RECORDING\n"
        f"  tactile export {checkpoint_path} model.onnx"
    )


def _relative_path(path: str | Path) -> str:
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative


@contextmanager
def _without_adverts() -> Iterator[None]:
    r"""Hides the log messages in which Lightning advertises other products within a :obj:`with`
    block. All other messages and warnings are shown.
    """
    loggers = [logging.getLogger(name) for name in _ADVERT_LOGGERS]
    for logger in loggers:
        logger.addFilter(_is_not_advert)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(_is_not_advert)


def _is_not_advert(record: logging.LogRecord) -> bool:
    return not str(record.msg).startswith(_ADVERT_PREFIX)
