r"""Names and options that version 0.3.0 removed. Version 0.4.0 deletes this module."""

from collections.abc import Callable
from typing import Any

_PACKAGE = "torch_geometric_tactile."

# What to do now, by a name below the package, or by a command with its option. Each has a row in
# docs/migration.md.
_PRETRAINING = (
    "with few labels, compare 'descriptors_forest' and 'descriptors_svm', which were as accurate"
)
REPLACEMENTS: dict[str, str] = {
    "nn.TaxelEncoder": "use TaxelNet",
    "nn.models.TaxelEncoder": "use TaxelNet",
    "predictor.PretrainedEncoder": _PRETRAINING,
    "tactile compare --encoder": _PRETRAINING,
    "tactile pretrain": _PRETRAINING,
    "training.PretrainSettings": _PRETRAINING,
    "training.PretrainStep": _PRETRAINING,
    "training.pretrain": _PRETRAINING,
}

# Files of removed features.
LAST_READER = "version 0.2.1 is the last version that reads it"
ENCODER_KEY = "torch_geometric_tactile.encoder"
ENCODER_CLASSES = ("TaxelEncoder", "TunedEncoder", "EncoderScale")


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
