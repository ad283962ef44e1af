r"""Names and options that version 0.3.0 removed. Version 0.4.0 deletes this module."""

from collections.abc import Callable
from typing import Any

_PACKAGE = "torch_geometric_tactile."

# What to do now, by a name below the package, or by a command with its option. Each has a row in
# docs/migration.md.
_OWN_ESTIMATOR = "write a short estimator around the network (docs/compare.md), or use skorch"
REPLACEMENTS: dict[str, str] = {
    "io.append_hdf5": "write frames with McapWriter, and convert the file with write_hdf5",
    "loader.DistributedBlockSampler": "use BlockSampler in one process; Lightning shares samples",
    "training.NetworkClassifier": _OWN_ESTIMATOR,
    "training.NetworkRegressor": _OWN_ESTIMATOR,
    "training.TactileClassifier": "use TactileModule, the same class",
}


def removal_message(name: str) -> str | None:
    r"""Returns the text of the error for a removed name, or :obj:`None` for any other."""
    replacement = REPLACEMENTS.get(name)
    return None if replacement is None else f"'{name}' was removed in version 0.3.0: {replacement}"


def removed_names(
    package: str, fallback: Callable[[str], Any] | None = None
) -> Callable[[str], Any]:
    r"""Returns a :obj:`__getattr__` of a package that raises :obj:`ImportError` for removed names,
    since ``from package import name`` hides the message of an :obj:`AttributeError`.
    """

    def get(name: str) -> Any:
        message = removal_message(f"{package}.{name}".removeprefix(_PACKAGE))
        if message is not None:
            raise ImportError(message)
        if fallback is not None:
            return fallback(name)
        raise AttributeError(f"module '{package}' has no attribute '{name}'")

    return get
