r"""Configuration files, and templates that expand to several configurations."""

import atexit
import copy
import json
import shutil
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import new_scratch_folder
from torch_geometric_tactile._limits import CONFIG_BYTES

# Limits for files from unknown sources, far above the needs of any useful configuration.
_MAX_VALUES = 100_000
_MAX_DEPTH = 50

# Each of these files contains many experiments: `base`, and the changes for each experiment.
TEMPLATES = (
    "p1_table2",
    "p1_table3",
    "p2_table2",
    "p2_pads",
    "p3_table2",
    "p3_k",
    "p3_picks",
    "p4_tables",
    "p5_tables",
)


def read_yaml(path: Path) -> Any:
    r"""Reads a YAML file with plain values. The file may come from an unknown source."""
    with path.open("rb") as file:
        text = file.read(CONFIG_BYTES + 1)
    problem = f"more than {CONFIG_BYTES} bytes" if len(text) > CONFIG_BYTES else ""
    content = None
    if not problem:
        try:
            content = yaml.load(text.decode(), Loader=_BoundedLoader)
        except Exception as error:  # YAML errors, and errors for invalid numbers and dates
            problem = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    if problem or not _is_within_limits(content):
        problem = problem or f"more than {_MAX_VALUES} values, or more than {_MAX_DEPTH} levels"
        raise ValueError(f"'{path}' cannot be read as YAML ({problem})")
    return content


class _BoundedLoader(yaml.SafeLoader):
    # The time of the parser grows with the square of the number of open brackets.
    def fetch_flow_collection_start(self, TokenClass: Any) -> None:  # noqa: N803
        need(self.flow_level <= _MAX_DEPTH, f"it has more than {_MAX_DEPTH} levels")
        super().fetch_flow_collection_start(TokenClass)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        # PyYAML silently uses the last value of a duplicate key.
        keys = [key.value for key, _ in getattr(node, "value", ()) if isinstance(key.value, str)]
        duplicates = [key for i, key in enumerate(keys) if key in keys[:i]]
        if duplicates:
            line = node.start_mark.line + 1
            raise ValueError(
                f"the key {duplicates[0]!r} occurs twice in the mapping that begins at line {line}"
            )
        content: dict[Any, Any] = super().construct_mapping(node, deep)
        return content


def _is_within_limits(content: Any) -> bool:
    # Counts a value shared by YAML aliases once per alias, because copying and writing expand it.
    pending, num_values = [(content, 0)], 0
    while pending:
        value, depth = pending.pop()
        num_values += 1
        if depth > _MAX_DEPTH or num_values > _MAX_VALUES:
            return False
        if isinstance(value, dict):
            pending.extend((item, depth + 1) for item in value.values())
        elif isinstance(value, list | tuple | set):
            pending.extend((item, depth + 1) for item in value)
    return True


@cache
def _expand(template: str) -> dict[str, dict[str, Any]]:
    content = yaml.safe_load((_config_folder() / f"{template}.yaml").read_text(encoding="utf-8"))
    base = content["base"]
    if isinstance(base, str):
        base_template, _, experiment = base.partition("/")
        base = _expand(base_template)[experiment]
    configs = {name: merged(base, changes) for name, changes in content["experiments"].items()}
    # Copying through JSON ensures that YAML aliases share no objects.
    expanded: dict[str, dict[str, Any]] = json.loads(json.dumps(configs))
    return expanded


def expand_template(template: str) -> dict[str, dict[str, Any]]:
    r"""Returns the full configuration of each experiment of a shipped template, in its order.

    A template contains :obj:`base` and :obj:`experiments`. The base is a configuration, or the name
    of an experiment in another template. The experiments are changes to the base, by name.
    """
    need(template in TEMPLATES, f"'template' must be one of {list(TEMPLATES)} (got '{template}')")
    return copy.deepcopy(_expand(template))


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns a configuration with some settings replaced. Mappings are merged key by key. Lists
    and all other values are replaced. If a class is replaced, its arguments are replaced as well.

    Examples:
        >>> merged({"a": {"b": 1, "c": [1, 2]}}, {"a": {"c": [3]}})
        {'a': {'b': 1, 'c': [3]}}
    """
    config = dict(base)
    for key, value in over.items():
        base_value = config.get(key)
        if isinstance(value, Mapping) and isinstance(base_value, Mapping):
            class_path = value.get("class_path", base_value.get("class_path"))
            if class_path == base_value.get("class_path"):
                value = merged(base_value, value)
        config[key] = value
    return config


def _config_folder() -> Path:
    return Path(str(files("torch_geometric_tactile.configs")))


@cache
def scratch_folder() -> Path:
    r"""Returns a temporary folder that is deleted when this process ends. If the process is killed,
    the next process that calls this function deletes the folder.
    """
    folder = new_scratch_folder()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
