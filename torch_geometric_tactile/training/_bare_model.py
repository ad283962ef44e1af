r"""A model from a checkpoint without what its inputs went through."""

import warnings
from collections.abc import Mapping
from typing import Any


def warn_of_scaling(checkpoint: Mapping[str, Any]) -> None:
    r"""Warns if the model of a checkpoint was trained on readings that fitted transforms, such as
    scalers, had changed.
    """
    names = fitted_names(checkpoint)
    if names:
        warnings.warn(
            f"this model was trained on readings that {', '.join(names)} transformed, but a module "
            "from a checkpoint has no transforms: for raw readings use "
            "Predictor.from_checkpoint(path); to test it, use "
            "trainer.test(module, datamodule=data, ckpt_path=path)",
            stacklevel=3,
        )


def fitted_names(checkpoint: Mapping[str, Any]) -> list[str]:
    r"""Returns the classes of the fitted transforms that a checkpoint holds for the predictor."""
    entry = checkpoint.get("predictor")
    header = entry.get("header") if isinstance(entry, Mapping) else None
    left = [header.get("transform")] if isinstance(header, Mapping) else []
    names = []
    while left:  # not by recursion, whose depth a received file could choose
        value = left.pop()
        if isinstance(value, Mapping):
            if value.get("state") and isinstance(value.get("class"), str):
                names.append(value["class"])
            left += reversed(list(value.values()))
        elif isinstance(value, list):
            left += reversed(value)
    return names
