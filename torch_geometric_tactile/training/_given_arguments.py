r"""The arguments of ``fit`` and its like before they are parsed, to build the data first."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from torch_geometric_tactile.training._config_files import merged, read_yaml

CONFIG = ("--config", "-c")
_SECTIONS = ("data", "model", "trainer")


@dataclass
class GivenArguments:
    r"""Configuration files joined in their order, and the other arguments."""

    config: dict[str, Any] = field(default_factory=dict)
    others: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, args: Sequence[str]) -> Self:
        r"""Reads the configuration files that arguments name."""
        found, others = parted(args, CONFIG.__contains__)
        given = cls(others=others)
        for flag, path in found:
            if path is None:
                given.others.append(flag)
            else:
                given.config = merged(given.config, read_config(Path(path)))
        return given

    @property
    def only_informs(self) -> bool:
        r"""Whether nothing is to be run, only help or the configuration to be printed."""
        flags = [arg.partition("=")[0] for arg in self.others]
        is_help = any(flag in ("-h", "--help") or flag.endswith(".help") for flag in flags)
        return is_help or self.prints_config

    @property
    def prints_config(self) -> bool:
        r"""Whether the configuration is to be printed."""
        return any(arg.partition("=")[0] == "--print_config" for arg in self.others)

    def of(self, section: str) -> list[str]:
        r"""Returns the arguments that change a section of the configuration."""
        start = f"--{section}"
        found, _ = parted(self.others, lambda flag: f"{flag}.".startswith(f"{start}."))
        return [f"{flag}={value or ''}" for flag, value in found]

    def last(self, *names: str) -> str | None:
        r"""Returns the last value of an option; :obj:`None` if it is not given."""
        found, _ = parted(self.others, {f"--{name}" for name in names}.__contains__)
        return found[-1][1] if found else None


def parted(
    args: Sequence[str], is_wanted: Callable[[str], bool]
) -> tuple[list[tuple[str, str | None]], list[str]]:
    r"""Returns some options with their values, :obj:`None` where there is none, and what is left of
    the arguments.
    """
    found, others, rest = [], [], iter(args)
    for arg in rest:
        flag, equals, value = arg.partition("=")
        if is_wanted(flag):
            found.append((flag, value if equals else next(rest, None)))
        else:
            others.append(arg)
    return found, others


def read_config(path: Path) -> dict[str, Any]:
    r"""Reads a configuration file, with the sections that are files of their own."""
    content = _mapping(path)
    for section in _SECTIONS:  # a section may be a file of its own, beside this one
        if isinstance(content.get(section), str):
            content[section] = _mapping(path.parent / content[section])
        value = content.get(section)
        if value is not None and not isinstance(value, Mapping):
            raise ValueError(
                f"'{section}' of configuration '{path}' must be a mapping (got {value!r})"
            )
    return content


def _mapping(path: Path) -> dict[str, Any]:
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
