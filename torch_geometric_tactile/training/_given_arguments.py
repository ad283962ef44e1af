r"""Arguments of ``fit``, ``validate`` and ``test`` before parsing, to build the data first."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from torch_geometric_tactile.training._config_files import merged, read_yaml

CONFIG = ("--config", "-c")
_SECTIONS = ("data", "model", "trainer")


@dataclass
class UnparsedArguments:
    r"""Configuration files merged in their order, and the remaining arguments."""

    config: dict[str, Any] = field(default_factory=dict)
    remaining: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, args: Sequence[str]) -> Self:
        r"""Reads the configuration files that arguments name."""
        configs, remaining = extract_options(args, CONFIG.__contains__)
        arguments = cls(remaining=remaining)
        for flag, path in configs:
            if path is None:
                arguments.remaining.append(flag)
            else:
                arguments.config = merged(arguments.config, read_config(Path(path)))
        return arguments

    @property
    def only_prints(self) -> bool:
        r"""If :obj:`True`, help or the configuration is printed and nothing is run."""
        flags = [arg.partition("=")[0] for arg in self.remaining]
        is_help = any(flag in ("-h", "--help") or flag.endswith(".help") for flag in flags)
        return is_help or self.prints_config

    @property
    def prints_config(self) -> bool:
        r"""If :obj:`True`, the configuration is printed."""
        return any(arg.partition("=")[0] == "--print_config" for arg in self.remaining)

    def section_arguments(self, section: str) -> list[str]:
        r"""Returns the arguments that change a section of the configuration."""
        start = f"--{section}"
        options, _ = extract_options(
            self.remaining, lambda flag: f"{flag}.".startswith(f"{start}.")
        )
        return [f"{flag}={value or ''}" for flag, value in options]

    def last_value(self, *names: str) -> str | None:
        r"""Returns the last value of an option; :obj:`None` if the option is absent."""
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
    r"""Reads a configuration file, and the files that its sections refer to."""
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
        raise FileNotFoundError(f"there is no configuration '{path}'")
    content = read_yaml(path)
    if content is None:
        return {}
    if not isinstance(content, Mapping):
        raise ValueError(
            f"configuration '{path}' must be a mapping with the keys {', '.join(_SECTIONS)} (got "
            f"{type(content).__name__})"
        )
    return dict(content)
