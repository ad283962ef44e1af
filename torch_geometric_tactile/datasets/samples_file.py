r"""Labelled samples in a file of arrays."""

import logging
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import (
    Argument,
    ArgumentError,
    need,
    need_argument,
    with_context,
)
from torch_geometric_tactile._typing import PathLike, Transform
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.data._arrays import static_data_from_arrays
from torch_geometric_tactile.data._label_names import number_labels
from torch_geometric_tactile.data._recording_arrays import warn_of_rounding
from torch_geometric_tactile.io.samples_npz import read_samples_npz
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.sensors import grid as planar_grid

_PITCH = 0.005
_PARTS = {"train": 0, "val": 1, "validation": 1, "test": 2, "0": 0, "1": 1, "2": 2}
_OF_SAMPLES = ("x", "y", "trial", "group", "session", "set", "part", "time", "joint")
_MOST_WHOLE = 50
_TASKS = ("auto", "multiclass", "regression")
_logger = logging.getLogger(__name__)


class SamplesFile(StaticDataset):
    r"""The labelled samples of an npz file of plain arrays, as :func:`numpy.savez` writes them;
    :func:`~torch_geometric_tactile.io.read_samples_npz` lists their names.

    Readings :obj:`x` are :math:`(S, N)`, :math:`(S, N, F)`, or :math:`(S, N, \ldots)` with all
    further dimensions (time, axes) as channels; for a grid also :math:`(S, rows, cols)` and
    :math:`(S, rows, cols, \ldots)`. Missing readings are NaN.

    Labels :obj:`y` that are names, whole numbers (any codes) or booleans are classes, numbered in
    their order; others are numbers to be predicted. Whole numbers in floating point are taken for
    classes if they are few, and the log says so; :obj:`task` decides otherwise. Spellings of one
    class are joined (:obj:`"slip"` and :obj:`"Slip "`, 1 and :obj:`"1"`). Samples with the number
    -1 beside class 0 have no label and are left out, and the log says how many.

    Args:
        path (str or PathLike): The file.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of one
            that comes with the package, or a layout file. If left out, a :obj:`grid`, or the
            :obj:`pos` in the file.
        grid (str, optional): Rows and columns of a planar array, such as :obj:`"28x50"`.
        pitch (float): Distance between neighbouring taxels of the grid in metres.
        task (str): :obj:`"multiclass"`, :obj:`"regression"`, or :obj:`"auto"`.
        time_axis (int, optional): The dimension of :obj:`x` that is time, counted from the samples,
            which are 0, where samples are windows that are already cut; they have
            :obj:`num_frames` then.
        transform (callable, optional): Applied at every access.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file cannot be read, the layout is missing, given twice or has another
            number of taxels, or the labels are not of the task.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = f"{folder}/touches.npz"
        ...     np.savez(path, x=np.zeros((4, 2, 3)), y=["tap", "rub", "tap", "rub"])
        ...     dataset = SamplesFile(path, grid="2x3")
        >>> dataset, dataset.class_names, dataset.y.tolist()
        (SamplesFile(4), ['rub', 'tap'], [1, 0, 1, 0])
    """

    def __init__(
        self,
        path: PathLike,
        layout: TaxelLayout | PathLike | None = None,
        *,
        grid: str | None = None,
        pitch: float = _PITCH,
        task: Literal["auto", "multiclass", "regression"] = "auto",
        time_axis: int | None = None,
        transform: Transform | None = None,
    ) -> None:
        need_argument(task in _TASKS, "task", f"must be one of {list(_TASKS)} (got '{task}')")
        if layout is not None and grid is not None:
            raise ArgumentError(
                *("only one of ", Argument("layout"), " and ", Argument("grid")),
                f" may be given (got '{grid}' too)",
            )
        self.path = str(path)
        self.task = task
        content = read_samples_npz(path)
        try:
            size = None if grid is None else _grid_size(grid)
            self.layout = _layout(content, layout, size, pitch)
            x = content["x"] if time_axis is None else _time_last(content["x"], time_axis)
            content["x"] = _taxels_first(x, self.layout, size)
            content = _without_unlabelled(content, task, self.path)
            self._num_frames = None if time_axis is None else x.shape[-1]
            self._content: dict[str, np.ndarray] | None = content
            super().__init__(None, transform)
        except ValueError as error:
            raise with_context(f"'{self.path}': ", error) from error
        self._content = None

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Returns all samples."""
        content = self._content
        assert content is not None
        names: dict[str, list[str]] = {}
        columns: dict[str, Any] = {}
        if "time" in content:
            columns["time"] = content["time"].astype(np.float64)
        given, count = content.get("class_names"), len(content["x"])
        columns["y"], names["class"] = _target(content["y"], self.task, given, self.path)
        for key in ("trial", "group", "session", "set"):
            if key in content:
                names[key], columns[key] = _numbered(key, content[key])
        if "part" in content:
            columns["part"] = _part(content["part"])
        if "joint" in content:
            columns["joint"] = content["joint"].reshape(count, -1).astype(np.float32)
        edges = self.layout.adjacency.get("original")
        schema: dict[str, Any] = {"node": (), "edge": (), "shared": ()}
        data, _ = static_data_from_arrays(content["x"], self.layout, edges, columns, {}, schema)
        if self._num_frames is not None:
            data.num_frames = self._num_frames
        return data, names


def _without_unlabelled(
    content: dict[str, np.ndarray], task: str, path: str
) -> dict[str, np.ndarray]:
    # Without samples of class -1 beside 0: as in scikit-learn, nobody labelled them.
    y = content["y"].reshape(-1)
    count = len(content["x"])
    if task == "regression" or len(y) != count or y.dtype.kind not in "if":
        return content
    if y.min() != -1 or not (y == 0).any() or (y.dtype.kind == "f" and not _are_few_codes(y)):
        return content
    is_labelled = y != -1
    _logger.warning(
        "'%s': %d of %d samples have the label -1 beside 0, which stands for no label: they are "
        "left out (write -1 as a text in 'y' if it is a class)",
        path,
        count - int(is_labelled.sum()),
        count,
    )
    return {key: v[is_labelled] if key in _OF_SAMPLES else v for key, v in content.items()}


def _grid_size(text: str) -> tuple[int, int]:
    rows, _, cols = text.lower().partition("x")
    if not (rows.isascii() and rows.isdigit() and cols.isascii() and cols.isdigit()):
        raise ArgumentError(
            Argument("grid"), f" must be rows and columns such as 28x50 (got '{text}')"
        )
    return int(rows), int(cols)


def _layout(
    content: dict[str, np.ndarray],
    layout: TaxelLayout | PathLike | None,
    size: tuple[int, int] | None,
    pitch: float,
) -> TaxelLayout:
    if layout is not None:
        return as_layout(layout)
    if size is not None:
        return planar_grid(*size, pitch)
    shape = content["x"].shape
    if "pos" not in content:
        raise ArgumentError(
            *("its taxels must be known: give a ", Argument("layout"), " or a ", Argument("grid")),
            " of rows and columns, or put "
            f"their positions 'pos' in metres into the file (got none for 'x' of shape {shape})",
        )
    edges = content.get("edge_index")
    normal = content.get("normal")
    return TaxelLayout(
        name="samples",
        pos=torch.from_numpy(content["pos"].astype(np.float32)),
        normal=None if normal is None else torch.from_numpy(normal.astype(np.float32)),
        adjacency={} if edges is None else {"original": torch.from_numpy(edges.astype(np.int64))},
    )


def _time_last(x: np.ndarray, axis: int) -> np.ndarray:
    if not 0 < axis < x.ndim or x.shape[axis] < 2:
        raise ArgumentError(
            Argument("time_axis"),
            f" must be a dimension of 'x' of at least 2 frames, from 1 to {x.ndim - 1} "
            f"(got {axis} for shape {x.shape})",
        )
    return np.moveaxis(x, axis, -1)


def _taxels_first(x: np.ndarray, layout: TaxelLayout, size: tuple[int, int] | None) -> np.ndarray:
    count = layout.num_taxels
    if size is not None and x.shape[1:3] == size:
        x = x.reshape(len(x), count, *x.shape[3:])
    if x.shape[1] != count:
        expected = f"(num_samples, {count}, ...)"
        if size is not None:
            expected += f" or (num_samples, {size[0]}, {size[1]}, ...)"
        raise ValueError(f"'x' must have shape {expected} (got {x.shape})")
    x = x.reshape(len(x), count, -1)
    single = x.astype(np.float32)
    warn_of_rounding("x", x, single, stacklevel=6)
    x = single
    if np.isinf(x).any():
        sample, taxel, _ = np.argwhere(np.isinf(x))[0].tolist()
        raise ValueError(
            f"'x' must hold finite readings below 1e38, and NaN for missing ones (got infinity in "
            f"sample {sample}, taxel {taxel})"
        )
    return x


def _target(
    y: np.ndarray, task: str, class_names: np.ndarray | None, path: str
) -> tuple[Tensor, list[str]]:
    # Labels and the names of the classes; no names for numbers.
    if y.ndim > 1 and y[0].size == 1:
        y = y.reshape(len(y))
    is_float = y.dtype.kind == "f"
    if is_float and not np.isfinite(y).all():
        raise ValueError("'y' must be finite (got NaN or infinity): leave such samples out")
    if task == "auto":
        task = "regression" if is_float else "multiclass"
        if is_float and y.ndim == 1 and _are_few_codes(y):
            task = "multiclass"
            _logger.warning(
                "'%s': 'y' holds %d different whole numbers, which are taken for classes; "
                "the task 'regression' takes them for numbers",
                path,
                len(np.unique(y)),
            )
    if task == "regression":
        if y.dtype.kind not in "biuf" or y.ndim > 2:
            raise ValueError(
                f"'y' must hold one number or a row of numbers a sample to predict numbers (got "
                f"{y.dtype} of shape {y.shape})"
            )
        return torch.from_numpy(y.astype(np.float32)), []
    if y.ndim > 1:
        raise ValueError(
            f"'y' must hold one class a sample (got shape {y.shape}): of one column for each "
            "class, take y.argmax(axis=1)"
        )
    names, codes = _numbered("y", y)
    if len(names) < 2:
        raise ValueError(f"'y' must have at least 2 classes (got only '{names[0]}')")
    if class_names is not None and y.dtype.kind in "iub":
        given = [str(name) for name in class_names.reshape(-1)]
        if y.min() >= 0 and y.max() < len(given):
            names = [given[int(code)] for code in np.unique(y)]
    return codes, names


def _are_few_codes(y: np.ndarray) -> bool:
    values, counts = np.unique(y, return_counts=True)
    is_whole = bool((values == np.round(values)).all())
    return is_whole and len(values) <= _MOST_WHOLE and int(counts.min()) > 1


def _numbered(key: str, values: np.ndarray) -> tuple[list[str], Tensor]:
    values = values.reshape(len(values)) if values.size == len(values) else values
    need(values.ndim == 1, f"'{key}' must have one value a sample (got shape {values.shape})")
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise ValueError(f"'{key}' must be known for every sample (got NaN)")
    found, first, of_value = np.unique(values, return_index=True, return_inverse=True)
    order = np.argsort(first)  # the spelling that comes first is the name
    names, codes = number_labels(found[order].tolist())
    code_of_found = np.empty(len(found), dtype=np.int64)
    code_of_found[order] = codes
    return names, torch.from_numpy(code_of_found[of_value.reshape(-1)])


def _part(values: np.ndarray) -> Tensor:
    names, codes = _numbered("part", values)
    unknown = [name for name in names if name not in _PARTS]
    if unknown:
        raise ValueError(
            f"'part' must hold 0 (train), 1 (val) and 2 (test), or these names (got '{unknown[0]}')"
        )
    return torch.tensor([_PARTS[name] for name in names])[codes]
