r"""The configurations shipped with the package: single files, and experiments from templates."""

from pathlib import Path
from typing import Any

import yaml

from torch_geometric_tactile.training._config_files import (
    TEMPLATES,
    _config_folder,
    expand_template,
    read_yaml,
    scratch_folder,
)


def config_names() -> list[str]:
    r"""Returns the names of the shipped configurations, without the experiments in templates.

    Examples:
        >>> "grasp_gcn_df" in config_names()
        True
    """
    return sorted(
        entry.name.removesuffix(".yaml")
        for entry in _config_folder().iterdir()
        if entry.suffix == ".yaml" and entry.stem not in TEMPLATES
    )


def find_config(name: str) -> Path:
    r"""Returns the path of a configuration: a file, a shipped configuration by its name, or an
    experiment in a shipped template as :obj:`TEMPLATE/EXPERIMENT`. An experiment is written to a
    temporary file that exists until this process ends.

    Args:
        name (str): Path of a file, or name of a shipped configuration.

    Raises:
        FileNotFoundError: If neither exists. The message lists the shipped configurations.

    Examples:
        >>> find_config("grasp_gcn_df").name
        'grasp_gcn_df.yaml'
    """
    path = Path(name)
    if path.is_file():
        return path
    template, slash, experiment = name.partition("/")
    if template in TEMPLATES:
        configs = expand_template(template)
        if experiment in configs:
            expanded = scratch_folder() / template / f"{experiment}.yaml"
            expanded.parent.mkdir(exist_ok=True)
            text = yaml.safe_dump(configs[experiment], sort_keys=False)
            expanded.write_text(f"# {name}, expanded\n{text}", encoding="utf-8")
            return expanded
        missing = f"'{template}' has no '{experiment}'" if slash else f"'{template}' is a template"
        raise FileNotFoundError(
            f"{missing}; choose {template}/NAME with one of: {', '.join(configs)}"
        )
    shipped = _config_folder() / f"{name}.yaml"
    if shipped.is_file():
        return shipped
    raise FileNotFoundError(
        f"there is no file '{name}' and no shipped configuration of that name; the shipped "
        f"configurations are {', '.join(config_names())}, and TEMPLATE/EXPERIMENT for the "
        f"templates {', '.join(TEMPLATES)}"
    )


def load_config(name: str) -> dict[str, Any]:
    r"""Returns the content of a configuration: a YAML file, or a shipped configuration by its name.

    Args:
        name (str): Path of a file, or name of a shipped configuration.

    Examples:
        >>> load_config("grasp_gcn_df")["model"]["model"]["class_path"]
        'torch_geometric_tactile.nn.models.GraspGCN'
    """
    template, _, experiment = name.partition("/")
    if template in TEMPLATES and not Path(name).is_file():
        configs = expand_template(template)
        if experiment in configs:
            return configs[experiment]
    path = find_config(name)
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ValueError(f"configuration '{path}' must be a mapping (got {type(content).__name__})")
    return content
