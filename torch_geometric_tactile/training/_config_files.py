r"""Configurations in files, and templates of several."""

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

_MAX_VALUES = 100_000


_MAX_DEPTH = 50


# These files hold many experiments: `base`, and what each lays over it.
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
    r"""Reads a YAML file of plain values, whoever wrote it."""
    with path.open("rb") as file:
        text = file.read(CONFIG_BYTES + 1)
    problem = f"more than {CONFIG_BYTES} bytes" if len(text) > CONFIG_BYTES else ""
    content = None
    if not problem:
        try:
            content = yaml.load(text.decode(), Loader=_Loader)
        except Exception as error:  # of YAML, or of a number or date in it that cannot be
            problem = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    if problem or not _is_small(content):
        problem = problem or f"more than {_MAX_VALUES} values, or nested {_MAX_DEPTH} deep"
        raise ValueError(f"'{path}' cannot be read as YAML ({problem})")
    return content


class _Loader(yaml.SafeLoader):
    # Its time grows with the square of the brackets that are open.
    def fetch_flow_collection_start(self, TokenClass: Any) -> None:  # noqa: N803
        need(self.flow_level <= _MAX_DEPTH, f"nested more than {_MAX_DEPTH} deep")
        super().fetch_flow_collection_start(TokenClass)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        # Of a key that is there twice, YAML's library takes the last without a word.
        keys = [key.value for key, _ in getattr(node, "value", ()) if isinstance(key.value, str)]
        twice = [key for i, key in enumerate(keys) if key in keys[:i]]
        if twice:
            line = node.start_mark.line + 1
            raise ValueError(
                f"the key {twice[0]!r} is given twice in the mapping that begins at line {line}"
            )
        content: dict[Any, Any] = super().construct_mapping(node, deep)
        return content


def _is_small(content: Any) -> bool:
    # Counts what aliases share once for each, as all that copies or writes it does.
    waiting, num_values = [(content, 0)], 0
    while waiting:
        value, depth = waiting.pop()
        num_values += 1
        if depth > _MAX_DEPTH or num_values > _MAX_VALUES:
            return False
        if isinstance(value, dict):
            waiting.extend((item, depth + 1) for item in value.values())
        elif isinstance(value, list | tuple | set):
            waiting.extend((item, depth + 1) for item in value)
    return True


@cache
def _expanded(template: str) -> dict[str, dict[str, Any]]:
    content = yaml.safe_load((_folder() / f"{template}.yaml").read_text(encoding="utf-8"))
    base = content["base"]
    if isinstance(base, str):
        other, _, experiment = base.partition("/")
        base = _expanded(other)[experiment]
    configs = {name: merged(base, over) for name, over in content["experiments"].items()}
    # Through JSON, so that what YAML's aliases share is shared no more.
    expanded: dict[str, dict[str, Any]] = json.loads(json.dumps(configs))
    return expanded


def expand_template(template: str) -> dict[str, dict[str, Any]]:
    r"""Returns the full configuration of each experiment of a shipped template, in its order.

    A template holds :obj:`base`, a configuration or the name of one in another template, and
    :obj:`experiments`: names, and what each lays over the base.
    """
    need(template in TEMPLATES, f"'template' must be one of {list(TEMPLATES)} (got '{template}')")
    return copy.deepcopy(_expanded(template))


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    r"""Lays one configuration over another: mappings are joined key by key, everything else, also
    a list, is replaced. So are the arguments of a class by those of another class.

    Examples:
        >>> merged({"a": {"b": 1, "c": [1, 2]}}, {"a": {"c": [3]}})
        {'a': {'b': 1, 'c': [3]}}
    """
    out = dict(base)
    for key, value in over.items():
        below = out.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            other_class = value.get("class_path", below.get("class_path"))
            if other_class == below.get("class_path"):
                value = merged(below, value)
        out[key] = value
    return out


def _folder() -> Path:
    return Path(str(files("torch_geometric_tactile.configs")))


@cache
def scratch_folder() -> Path:
    r"""Returns a temporary folder that lives as long as this process, or, if it is killed, until
    the next one asks for its own.
    """
    folder = new_scratch_folder()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
