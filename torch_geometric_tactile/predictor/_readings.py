r"""Conversion of arrays to tensors, and the options with which predictors read files."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

ArrayLike = Tensor | np.ndarray | Sequence[Any]

# Options for labels and size limits are left out: a file to predict has no labels, and a predictor
# file from someone else must not set limits.
_OPTION_TYPES: dict[str, type | tuple[type, ...]] = {
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
    "separator": str,
    "decimal": str,
    "encoding": str,
    "preamble": int,
    "unit_row": bool,
    "time_format": str,
    "missing": list,
}


def select_read_options(options: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns the options of :func:`~torch_geometric_tactile.io.read_recording` that a predictor
    stores. They determine how numbers are read. Labels and regular expressions are left out.

    Examples:
        >>> select_read_options({"tactile": ("thumb", "index"), "joint": "q.*", "label": "grasp"})
        {'tactile': ['thumb', 'index']}
    """
    option_values = {k: list(v) if isinstance(v, tuple) else v for k, v in options.items()}
    return {key: value for key, value in option_values.items() if _is_valid(key, value)}


def check_read_options(options: Any) -> dict[str, Any]:
    r"""Checks and returns the options from a predictor file, which may come from someone else."""
    if not isinstance(options, Mapping):
        raise ValueError(f"its 'read_options' must be a mapping (got {str(options)[:80]})")
    for key, value in options.items():
        if not _is_valid(key, value):
            raise ValueError(
                f"its 'read_options' must be some of {[*_OPTION_TYPES]}, names as lists of texts "
                f"(got {str(key)[:40]!r}: {str(value)[:80]})"
            )
    return dict(options)


def _is_valid(key: str, value: Any) -> bool:
    if not isinstance(value, _OPTION_TYPES.get(key, ())):
        return False
    if isinstance(value, list):
        items = str | int | float if key == "missing" else str
        return all(isinstance(item, items) for item in value)
    return isinstance(value, bool) == (_OPTION_TYPES[key] is bool)


def array_shape(array: ArrayLike) -> tuple[int, ...]:
    r"""Returns the shape of an array or of nested sequences."""
    return tuple(array.shape) if hasattr(array, "shape") else np.shape(array)


def to_float_tensor(
    name: str, array: ArrayLike, dtype: torch.dtype, device: torch.device | None
) -> Tensor:
    r"""Returns an array as a tensor of floating-point numbers. Masked and infinite numbers become
    NaN.
    """
    try:
        if isinstance(array, np.ma.MaskedArray):
            array = np.ma.filled(array.astype(np.result_type(array.dtype, np.float32)), np.nan)
        elif isinstance(array, np.ndarray) and not array.flags.writeable:
            array = array.copy()  # PyTorch has no read-only tensors and would warn
        tensor = torch.as_tensor(array).to(device=device, dtype=dtype)
        return tensor.masked_fill(tensor.isinf(), torch.nan)  # an infinite number is not a reading
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"'{name}' must be an array of numbers ({error})") from error


def joint_rows(angles: Tensor, num_frames: int, num_joints: int | None) -> Tensor:
    r"""Returns one row of joint angles per frame. A single row of :obj:`angles` is repeated.

    Shapes:
        - **output:** :math:`(B, J)`
    """
    angles_shape = tuple(angles.shape)
    if angles.dim() == 1:
        angles = angles.expand(num_frames, -1)
    has_row_per_frame = angles.dim() == 2 and len(angles) == num_frames
    if not has_row_per_frame or num_joints not in (None, angles.size(1)):
        expected_size = num_joints or "num_joints"
        raise ValueError(
            f"'joint' must have shape ({expected_size},) or ({num_frames}, {expected_size}), "
            f"angles in radians (got {angles_shape})"
        )
    return angles
