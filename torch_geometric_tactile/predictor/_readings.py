r"""How readings and recordings come to a predictor."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

ArrayLike = Tensor | np.ndarray | Sequence[Any]

# Neither labels nor limits: a file to predict has no labels, and may be another's.
_TYPES: dict[str, type | tuple[type, ...]] = {
    "tactile": list,
    "joint": list,
    "num_channels": int,
    "time": str,
    "time_unit": str,
    "rate": (int, float),
    "forces": bool,
    "num_taxels": int,
    "num_joints": int,
    "header": bool,
}


def stored_options(options: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns what a predictor keeps of options of
    :func:`~torch_geometric_tactile.io.read_recording`: how numbers are read, but neither labels nor
    expressions.

    Examples:
        >>> stored_options({"tactile": ("thumb", "index"), "joint": "q.*", "label": "grasp"})
        {'tactile': ['thumb', 'index']}
    """
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in options.items()}
    return {key: value for key, value in plain.items() if _is_valid(key, value)}


def checked_options(options: Any) -> dict[str, Any]:
    r"""Returns options that :func:`stored_options` returned, from a file that may be another's."""
    if not isinstance(options, Mapping):
        raise ValueError(f"its 'read_options' must be a mapping (got {str(options)[:80]})")
    for key, value in options.items():
        if not _is_valid(key, value):
            raise ValueError(
                f"its 'read_options' must be some of {[*_TYPES]}, names as lists of texts (got "
                f"{str(key)[:40]!r}: {str(value)[:80]})"
            )
    return dict(options)


def _is_valid(key: str, value: Any) -> bool:
    if not isinstance(value, _TYPES.get(key, ())):
        return False
    if isinstance(value, list):
        return all(isinstance(name, str) for name in value)
    return isinstance(value, bool) == (_TYPES[key] is bool)


def shape_of(value: ArrayLike) -> tuple[int, ...]:
    r"""Returns the shape of an array, or of nested sequences."""
    return tuple(value.shape) if hasattr(value, "shape") else np.shape(value)


def as_numbers(
    name: str, value: ArrayLike, dtype: torch.dtype, device: torch.device | None
) -> Tensor:
    r"""Returns an array as a tensor of floating-point numbers, NaN where there is none."""
    try:
        if isinstance(value, np.ma.MaskedArray):  # what is masked is missing
            value = np.ma.filled(value.astype(np.result_type(value.dtype, np.float32)), np.nan)
        elif isinstance(value, np.ndarray) and not value.flags.writeable:
            value = value.copy()  # PyTorch has no tensors that cannot be written
        tensor = torch.as_tensor(value).to(device=device, dtype=dtype)
        return tensor.masked_fill(tensor.isinf(), torch.nan)  # no reading: it is missing too
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"'{name}' must be an array of numbers ({error})") from error


def joint_rows(angles: Tensor, num_frames: int, num_joints: int | None) -> Tensor:
    r"""Returns the joint angles of frames, which are given as one row for all or a row for each.

    Shapes:
        - **output:** :math:`(B, J)`
    """
    given = tuple(angles.shape)
    if angles.dim() == 1:
        angles = angles.expand(num_frames, -1)
    fits = angles.dim() == 2 and len(angles) == num_frames
    if not fits or num_joints not in (None, angles.size(1)):
        number = num_joints or "num_joints"
        raise ValueError(
            f"'joint' must have shape ({number},) or ({num_frames}, {number}), angles in radians "
            f"(got {given})"
        )
    return angles
