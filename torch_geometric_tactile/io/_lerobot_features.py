r"""Features of LeRobot data sets: their names, shapes, columns and Hugging Face's description."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._wide_csv_header import wide_csv_header

TACTILE, STATE = "observation.tactile", "observation.state"
TACTILE_FRAMES, STATE_FRAMES = f"{TACTILE}_frames", f"{STATE}_frames"
FRAME_TIMES = f"{TACTILE_FRAMES}_time"
INDICES = ("frame_index", "episode_index", "index", "task_index")

_SCHEMA_KEY = b"huggingface"


def require_pyarrow() -> Any:
    r"""Returns pyarrow, with its parts for Parquet and computing."""
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(
            "LeRobot data sets need pyarrow: pip install 'torch-geometric-tactile[lerobot]'"
        ) from error
    return pyarrow


def taxel_names(num_taxels: int, num_channels: int) -> list[str]:
    r"""Returns the names of the readings of one frame, as in wide CSV.

    Examples:
        >>> taxel_names(2, 1)
        ['taxel_0_x', 'taxel_1_x']

    Shapes:
        - **num_taxels:** Number of taxels :math:`N`.
        - **num_channels:** Number of channels of a taxel :math:`C`.
    """
    return wide_csv_header(num_taxels, num_channels, 0)[1:]


def shape_of_names(names: Any) -> tuple[int, int] | None:
    r"""Returns the numbers of taxels and channels if the names are those of :func:`taxel_names`.

    Examples:
        >>> shape_of_names(["taxel_0_x", "taxel_0_y", "taxel_1_x", "taxel_1_y"])
        (2, 2)
    """
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return None
    num_channels = sum(name.startswith("taxel_0_") for name in names)
    if not num_channels or len(names) % num_channels:
        return None
    shape = (len(names) // num_channels, num_channels)
    return shape if names == taxel_names(*shape) else None


def feature(size: int, names: list[str] | None = None, dtype: str = "float32") -> dict[str, Any]:
    r"""Returns the description of a feature of one dimension."""
    return {"dtype": dtype, "shape": [size], "names": names}


def touch_features(recording: Recording, rows: int) -> dict[str, Any]:
    r"""Returns the features of the readings."""
    shape = (recording.num_taxels, recording.num_channels)
    out = {TACTILE: feature(shape[0] * shape[1], taxel_names(*shape))}
    if rows:
        out[TACTILE_FRAMES] = feature(rows * shape[0] * shape[1])
        out[FRAME_TIMES] = feature(rows)
    return out


def column(values: np.ndarray) -> Any:
    r"""Returns the column of a feature as LeRobot has it: one value a step is no list.

    Shapes:
        - **values:** Values :math:`(T, ...)`.
    """
    pa = require_pyarrow()
    array = pa.array(np.ascontiguousarray(values).ravel())
    size = values[0].size
    return array if size == 1 else pa.FixedSizeListArray.from_arrays(array, size)


def schema_metadata(
    features: Mapping[str, Any], metadata: Mapping[bytes, bytes] | None = None
) -> dict[bytes, bytes]:
    r"""Returns the metadata of a Parquet file with which :obj:`datasets` reads it."""
    content: dict[str, Any] = {}
    if metadata is not None:
        content = json.loads(metadata[_SCHEMA_KEY])
    known = content.setdefault("info", {}).setdefault("features", {})
    for name, description in features.items():
        (size,) = description["shape"]
        value = {"dtype": description["dtype"], "_type": "Value"}
        known[name] = (
            value if size == 1 else {"feature": value, "length": size, "_type": "Sequence"}
        )
    return {**(metadata or {}), _SCHEMA_KEY: json.dumps(content).encode()}
