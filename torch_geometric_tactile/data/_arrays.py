r"""Converts the user's arrays to samples."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data._label_names import label_numbers, number_labels
from torch_geometric_tactile.data._levels import NAMED
from torch_geometric_tactile.data._recording_arrays import (
    checked_numbers,
    refuse_masked,
    warn_of_rounding,
)
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors._checks import check_edges

_COLUMNS = ("y", "group", "trial", "session", "joint", "time")
_NAMED_COLUMNS = ("y", "group", "trial", "session")  # a number or a name for each sample
_MAY_MISS = ("x", "joint")
_DOUBLE_PRECISION = ("time",)  # seconds since an epoch need more than single precision


def static_data_from_arrays(
    x: Any,
    layout: TaxelLayout,
    edge_index: Any | None,
    columns: Mapping[str, Any],
    names: Mapping[str, Sequence[str]],
    schema: Mapping[str, Any],
) -> tuple[StaticData, dict[str, list[str]]]:
    r"""Checks arrays against a layout and returns them as samples, together with the names of the
    integers in :obj:`y`, :obj:`group`, :obj:`trial`, :obj:`session` and further attributes.

    Args:
        x (array-like): Readings.
        layout (TaxelLayout): The taxels.
        edge_index (array-like, optional): The edges of every sample.
        columns (Mapping): Further attributes by name; those that are :obj:`None` are skipped.
        names (Mapping): Names of classes, groups and sessions in the order of their numbers.
        schema (Mapping): Names of node, edge and shared attributes, as in
            :class:`~torch_geometric_tactile.data.StaticData`.

    Shapes:
        - **x:** Readings :math:`(S, N, F)`, or :math:`(S, N)` for one channel.
        - **edge_index:** :math:`(2, |\mathcal{E}|)`

    Raises:
        ValueError: If an array does not fit the layout or the number of samples.
    """
    x = _checked_x(x, layout)
    name_lists = {key: list(map(str, texts)) for key, texts in names.items() if len(texts)}
    values: dict[str, Any] = {}
    for key, value in columns.items():
        if value is None:
            continue
        if key in _NAMED_COLUMNS or key not in (*_COLUMNS, *itertools.chain(*schema.values())):
            value = _names_to_numbers(key, value, name_lists)
        values[key] = value if key in schema.get("shared", ()) else _as_column(key, value)
        if key in _COLUMNS:
            _check_rows(key, values[key], x.size(0))
    edges = None
    if edge_index is not None:
        edges = check_edges(as_tensor("edge_index", edge_index), layout.num_taxels)
    pose = {} if {"pos", "normal"} & values.keys() else _shared_pose(layout)
    arguments: dict[str, Any] = {**pose, **values, **schema}
    return StaticData(x=x, edge_index=edges, **arguments), name_lists


def _shared_pose(layout: TaxelLayout) -> dict[str, Tensor]:
    # The positions and normals of a layout with one link. With several links, they are in several
    # coordinate frames and cannot be compared; `TaxelPose` computes them from joint angles.
    if len(layout.link_names) > 1:
        return {}
    return {"pos": layout.pos} | ({} if layout.normal is None else {"normal": layout.normal})


def as_tensor(name: str, value: Any) -> Tensor:
    r"""Returns numbers as a tensor, without a copy if possible. Masked readings become NaN.

    Raises:
        ValueError: If the values are not numbers, their rows differ in length, or a value other
            than a reading or a joint angle is masked.
    """
    if isinstance(value, Tensor):
        return value
    if isinstance(value, np.ma.MaskedArray) and name in _MAY_MISS:
        single = value.dtype.kind != "f" or value.dtype.itemsize < 8
        value = checked_numbers(name, value, np.float32 if single else np.float64)
    refuse_masked(name, value)
    array = np.asarray(value) if not _is_ragged(value) else np.empty(0, dtype=object)
    if array.dtype.kind not in "biuf":
        raise ValueError(
            f"'{name}' must hold numbers, the same number in each row (got {array.dtype})"
        )
    if array.dtype.kind == "u" and array.dtype.itemsize > 1:
        array = array.astype(np.int64)  # torch can neither index with nor compare larger unsigned
    if not array.flags.writeable or not array.dtype.isnative:
        array = array.astype(array.dtype.newbyteorder("="))
    return torch.from_numpy(np.ascontiguousarray(array).reshape(array.shape))


def _is_ragged(value: Any) -> bool:
    try:
        np.asarray(value)
    except ValueError:
        return True
    return False


def _checked_x(x: Any, layout: TaxelLayout) -> Tensor:
    x = as_tensor("x", x)
    x_float = x.float()
    if x.element_size() >= 4:  # NumPy has no bfloat16, and shorter types convert exactly
        warn_of_rounding(
            "x", x.detach().cpu().numpy(), x_float.detach().cpu().numpy(), stacklevel=5
        )
    x = x_float
    num_taxels = layout.num_taxels
    if x.dim() == 2 and x.size(1) == num_taxels:
        x = x.unsqueeze(-1)
    if x.dim() != 3 or x.size(1) != num_taxels:
        raise ValueError(
            f"'x' must have shape (num_samples, {num_taxels}, num_channels), since layout "
            f"'{layout.name}' has {num_taxels} taxels (got {tuple(x.shape)})"
        )
    if x.isinf().any():
        sample, taxel, channel = x.isinf().nonzero()[0].tolist()
        raise ValueError(
            f"'x' must hold finite readings, or NaN where one is missing (got infinity in sample "
            f"{sample}, taxel {taxel}, channel {channel})"
        )
    return x


def _as_column(key: str, value: Any) -> Tensor:
    value = as_tensor(key, value)
    if value.is_floating_point() and key not in _DOUBLE_PRECISION:
        value = value.float()
        if key in _NAMED_COLUMNS and value.dim() == 1:
            _refuse_missing(key, value.isnan().tolist(), value.tolist())
        return value
    if value.dtype in (torch.int8, torch.int16, torch.int32, torch.uint8) or (
        key == "y" and value.dtype == torch.bool
    ):
        return value.long()
    return value


def _check_rows(key: str, value: Tensor, num_samples: int) -> None:
    if value.dim() == 0 or value.size(0) != num_samples:
        raise ValueError(
            f"'{key}' must have {num_samples} rows, one for each sample of 'x' "
            f"(got shape {tuple(value.shape)})"
        )


def _names_to_numbers(key: str, value: Any, name_lists: dict[str, list[str]]) -> Any:
    # Converts names to numbers, and returns numbers unchanged. Adds the names to `name_lists`
    # unless the caller has listed them.
    if isinstance(value, Tensor):
        return value
    array = np.asarray(value) if not _is_ragged(value) else np.empty(0)
    if array.dtype.kind not in "UO":
        return value
    # Read as objects, since NumPy turns a missing value in a list of texts into a text.
    items = list(np.asarray(value, dtype=object).flat)
    _refuse_missing(key, [_is_missing(item) for item in items], items)
    if array.dtype.kind == "O" and not all(isinstance(item, str) for item in items):
        is_numeric = all(isinstance(item, int | float | np.number) for item in items)
        return np.array(array.tolist()) if is_numeric else value
    need(array.ndim == 1, f"'{key}' must have one name for each sample (got shape {array.shape})")
    kind = NAMED.get(key, key)
    if kind not in name_lists:
        name_lists[kind], codes = number_labels(array.tolist())
        return torch.from_numpy(codes)
    names, labels = name_lists[kind], array.tolist()
    numbers = dict(zip(labels, label_numbers(names, labels), strict=True))
    unknown = sorted(label for label, number in numbers.items() if number is None)
    need(not unknown, f"'{kind}_names' must name every '{key}' (got {names} without {unknown})")
    return torch.tensor([numbers[label] for label in labels], dtype=torch.long)


def _is_missing(item: Any) -> bool:
    # NaN and NaT differ from themselves, and the NA of pandas has no truth value.
    try:
        return item is None or bool(item != item)
    except TypeError:
        return True


def _refuse_missing(key: str, is_missing: Sequence[bool], values: Sequence[Any]) -> None:
    if not any(is_missing):
        return
    first = is_missing.index(True)
    raise ValueError(
        f"'{key}' must have a value for each sample (got {values[first]} in sample {first}, and "
        f"{sum(is_missing)} of {len(values)} are missing): fill them in, or leave out these samples"
    )


def layout_from_pos(data: StaticData) -> TaxelLayout:
    r"""Returns a layout with its taxels at the positions that all samples share.

    Raises:
        ValueError: If the samples do not share positions :math:`(N, 3)`.
    """
    pos = data.pos
    if pos is None or pos.dim() != 2 or pos.size(1) != 3:
        pos_text = "none" if pos is None else f"shape {tuple(pos.shape)}"
        raise ValueError(
            f"'layout' must be given, since the samples do not share one 'pos' of shape "
            f"(num_taxels, 3) (got {pos_text})"
        )
    return TaxelLayout(name="data", pos=pos)
