r"""The arguments of ``fit`` and its like before they are parsed, to build the data first."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from torch_geometric_tactile.training._config_files import merged, read_yaml

_SECTIONS = ("data", "model", "trainer")


@dataclass
class GivenArguments:
    r"""Configuration files joined in their order, and the other arguments."""

    config: dict[str, Any] = field(default_factory=dict)
    others: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, args: Sequence[str]) -> Self:
        r"""Reads the configuration files that arguments name."""
        given, rest = cls(), iter(args)
        for arg in rest:
            flag, equals, value = arg.partition("=")
            if flag in ("--config", "-c"):
                path = value if equals else next(rest, None)
                if path is None:
                    given.others.append(arg)
                else:
                    given.config = merged(given.config, read_config(Path(path)))
            else:
                given.others.append(arg)
        return given

    @property
    def only_informs(self) -> bool:
        r"""Whether nothing is to be run, only help or the configuration to be printed."""
        flags = [arg.partition("=")[0] for arg in self.others]
        return any(
            flag in ("-h", "--help", "--print_config") or flag.endswith(".help") for flag in flags
        )

    @property
    def prints_config(self) -> bool:
        r"""Whether the configuration is to be printed."""
        return any(arg.partition("=")[0] == "--print_config" for arg in self.others)

    def of(self, section: str) -> list[str]:
        r"""Returns the arguments that change a section of the configuration."""
        found, rest = [], iter(self.others)
        for arg in rest:
            name, equals, _ = arg.partition("=")
            if name == f"--{section}" or name.startswith(f"--{section}."):
                found += [arg] if equals else [arg, next(rest, "")]
        return found

    def last(self, *names: str) -> str | None:
        r"""Returns the last value of an option; :obj:`None` if it is not given."""
        value = None
        for i, arg in enumerate(self.others):
            flag, equals, text = arg.partition("=")
            if flag.removeprefix("--") in names and flag.startswith("--"):
                value = text if equals else next(iter(self.others[i + 1 :]), None)
        return value


def own_modules() -> None:
    r"""Makes the modules of the working directory importable, as :obj:`python -m` does, for
    classes of one's own in a configuration.
    """
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)


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
