r"""Messages to the viewer's page."""

import json
import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np


def pack_message(head: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> bytes:
    r"""Returns a message to the page: the number of bytes of the head (32 bits, little-endian), the
    head as JSON, and the arrays as float32, little-endian. The head names the arrays and their
    shapes in order, under :obj:`"arrays"`; they begin at a multiple of four bytes.
    """
    arrays = arrays or {}
    shapes = [[name, list(array.shape)] for name, array in arrays.items()]
    text = json.dumps(_finite({**head, "arrays": shapes}), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    parts = [np.ascontiguousarray(array, dtype="<f4").tobytes() for array in arrays.values()]
    return b"".join([struct.pack("<I", len(text)), text, *parts])


def _finite(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return value
