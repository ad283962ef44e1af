r"""A data set of labelled samples in an npz file."""

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
from torch_geometric_tactile.data._levels import KNOWN_ATTRIBUTES
from torch_geometric_tactile.data._recording_arrays import warn_of_rounding
from torch_geometric_tactile.io.samples_npz import read_samples_npz
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.sensors import grid as planar_grid

_PITCH = 0.005  # metres
_PARTS = {"train": 0, "val": 1, "validation": 1, "test": 2, "0": 0, "1": 1, "2": 2}
_SAMPLE_ARRAYS = ("x", "y", "trial", "group", "session", "set", "part", "time", "joint")
_SHARED_ARRAYS = ("class_names", "pos", "normal", "edge_index")
_MAX_FLOAT_CLASSES = 50  # more different integers in floating point are a regression target
_TASKS = ("auto", "multiclass", "regression")
_logger = logging.getLogger(__name__)


class SamplesFile(StaticDataset):
    r"""A data set of labelled samples from an npz file of plain arrays, such as
    :func:`numpy.savez` writes. :func:`~torch_geometric_tactile.io.read_samples_npz` lists the names
    of the arrays. Further arrays of texts or integers :math:`(S,)`, such as :obj:`person`, are
    units by which :class:`~torch_geometric_tactile.data.Protocol` can split the samples.

    **Readings** :obj:`x` have shape :math:`(S, N)`, :math:`(S, N, F)` or :math:`(S, N, \ldots)`,
    where all further dimensions (time, axes) become channels. On a grid, they may also have shape
    :math:`(S, rows, cols)` or :math:`(S, rows, cols, \ldots)`. Missing readings are NaN.

    **Labels** :obj:`y`:

    * Names, integers (any codes) and booleans are classes, numbered in sorted order.
    * Floating-point numbers are a regression target. By default, up to 50 different integers in
      floating point are classes instead, and a warning is logged; set :obj:`task` to choose.
    * Different spellings of a class are merged, such as :obj:`"slip"` and :obj:`"Slip "`, or 1 and
      :obj:`"1"`.
    * If there is a class 0, samples with the label -1 are unlabelled and left out. A warning
      reports their number.

    Args:
        path (str or PathLike): The file.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of a
            layout of the package, or a layout file. The default is the :obj:`grid`, or a layout
            with the positions :obj:`pos` in the file.
        grid (str, optional): Rows and columns of a planar array, such as :obj:`"28x50"`.
        pitch (float): Distance between neighbouring taxels of the grid in metres.
        task (str): :obj:`"multiclass"`, :obj:`"regression"`, or :obj:`"auto"`.
        time_axis (int, optional): The dimension of :obj:`x` that is time, if the samples are
            windows. Dimension 0 is the samples. The samples then have :obj:`num_frames`.
        transform (callable, optional): Applied at every access.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If the file cannot be read, the layout is missing, ambiguous or has the wrong
            number of taxels, or the labels do not fit the task.

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
            self.layout = _find_layout(content, layout, size, pitch)
            x = content["x"] if time_axis is None else _time_last(content["x"], time_axis)
            content["x"] = _taxels_first(x, self.layout, size)
            content = _drop_unlabelled(content, task, self.path)
            self._num_frames = None if time_axis is None else x.shape[-1]
            self._content: dict[str, np.ndarray] | None = content
            self.named_units = [key for key in content if _is_unit(key)]
            super().__init__(None, transform)
        except ValueError as error:
            raise with_context(f"'{self.path}': ", error) from error
        self._content = None  # the arrays are now stored in the data set

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        r"""Returns all samples."""
        content = self._content
        assert content is not None
        names: dict[str, list[str]] = {}
        columns: dict[str, Any] = {}
        if "time" in content:
            columns["time"] = content["time"].astype(np.float64)
        class_names, num_samples = content.get("class_names"), len(content["x"])
        columns["y"], names["class"] = _target(content["y"], self.task, class_names, self.path)
        for key in ("trial", "group", "session", "set", *self.named_units):
            if key in content:
                names[key], columns[key] = _names_and_codes(key, content[key])
        if "part" in content:
            columns["part"] = _part(content["part"])
        if "joint" in content:
            columns["joint"] = content["joint"].reshape(num_samples, -1).astype(np.float32)
        edges = self.layout.adjacency.get("original")
        schema: dict[str, Any] = {"node": (), "edge": (), "shared": ()}
        data, _ = static_data_from_arrays(content["x"], self.layout, edges, columns, {}, schema)
        if self._num_frames is not None:
            data.num_frames = self._num_frames
        return data, names


def _is_unit(key: str) -> bool:
    # Returns whether a further array is a unit by which samples can be split. An array with the
    # name of an attribute that has another meaning is not a unit.
    level = KNOWN_ATTRIBUTES.get(key)
    is_reserved = isinstance(getattr(StaticData, key, None), property) or level is not None
    return key not in (*_SAMPLE_ARRAYS, *_SHARED_ARRAYS) and not is_reserved


def _drop_unlabelled(content: dict[str, np.ndarray], task: str, path: str) -> dict[str, np.ndarray]:
    # If there is a class 0, the label -1 stands for unlabelled samples, as in scikit-learn.
    y = content["y"].reshape(-1)
    num_samples = len(content["x"])
    if task == "regression" or len(y) != num_samples or y.dtype.kind not in "if":
        return content
    if y.min() != -1 or not (y == 0).any() or (y.dtype.kind == "f" and not _are_class_codes(y)):
        return content
    is_labelled = y != -1
    _logger.warning(
        "'%s': %d of %d samples have the label -1, which means unlabelled if there is a class 0: "
        "they are left out (write -1 as a text in 'y' if it is a class)",
        path,
        num_samples - int(is_labelled.sum()),
        num_samples,
    )
    return {
        key: array if key in _SHARED_ARRAYS else array[is_labelled]
        for key, array in content.items()
    }


def _grid_size(text: str) -> tuple[int, int]:
    rows, _, cols = text.lower().partition("x")
    if not (rows.isascii() and rows.isdigit() and cols.isascii() and cols.isdigit()):
        raise ArgumentError(
            Argument("grid"), f" must be rows and columns such as 28x50 (got '{text}')"
        )
    return int(rows), int(cols)


def _find_layout(
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
            *("its taxels must be known: pass a ", Argument("layout"), " or a ", Argument("grid")),
            " of rows and columns, or write "
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
    # Returns the readings as (S, N, C) in single precision.
    num_taxels = layout.num_taxels
    if size is not None and x.shape[1:3] == size:
        x = x.reshape(len(x), num_taxels, *x.shape[3:])
    if x.shape[1] != num_taxels:
        expected = f"(num_samples, {num_taxels}, ...)"
        if size is not None:
            expected += f" or (num_samples, {size[0]}, {size[1]}, ...)"
        raise ValueError(f"'x' must have shape {expected} (got {x.shape})")
    x = x.reshape(len(x), num_taxels, -1)
    single = x.astype(np.float32)
    warn_of_rounding("x", x, single, stacklevel=6)  # the line that calls SamplesFile
    x = single
    if np.isinf(x).any():
        sample, taxel, _ = np.argwhere(np.isinf(x))[0].tolist()
        raise ValueError(
            f"'x' must hold finite readings below 1e38, or NaN where one is missing (got infinity "
            f"in sample {sample}, taxel {taxel})"
        )
    return x


def _target(
    y: np.ndarray, task: str, class_names: np.ndarray | None, path: str
) -> tuple[Tensor, list[str]]:
    # Returns the labels and the names of the classes. A regression target has no names.
    if y.ndim > 1 and y[0].size == 1:
        y = y.reshape(len(y))
    is_float = y.dtype.kind == "f"
    if is_float and not np.isfinite(y).all():
        sample = int(np.argwhere(~np.isfinite(y))[0][0])
        raise ValueError(
            f"'y' must be finite (got NaN or infinity in sample {sample}): leave such samples out"
        )
    if task == "auto":
        task = "regression" if is_float else "multiclass"
        if is_float and y.ndim == 1 and _are_class_codes(y):
            task = "multiclass"
            _logger.warning(
                "'%s': 'y' holds %d different integers, which are used as classes; "
                "set the task to 'regression' to use them as numbers",
                path,
                len(np.unique(y)),
            )
    if task == "regression":
        if y.dtype.kind not in "biuf" or y.ndim > 2:
            raise ValueError(
                f"'y' must hold one number or one row of numbers per sample for regression (got "
                f"{y.dtype} of shape {y.shape})"
            )
        return torch.from_numpy(y.astype(np.float32)), []
    if y.ndim > 1:
        raise ValueError(
            f"'y' must hold one class per sample (got shape {y.shape}): if it has one column for "
            "each class, write y.argmax(axis=1)"
        )
    names, codes = _names_and_codes("y", y)
    if len(names) < 2:
        raise ValueError(f"'y' must have at least 2 classes (got only '{names[0]}')")
    if class_names is not None and y.dtype.kind in "iub":
        all_names = [str(name) for name in class_names.reshape(-1)]
        if y.min() >= 0 and y.max() < len(all_names):
            names = [all_names[int(code)] for code in np.unique(y)]
    return codes, names


def _are_class_codes(y: np.ndarray) -> bool:
    # A value that occurs only once is more likely a measurement than a class.
    values, counts = np.unique(y, return_counts=True)
    are_integers = bool((values == np.round(values)).all())
    return are_integers and len(values) <= _MAX_FLOAT_CLASSES and int(counts.min()) > 1


def _names_and_codes(key: str, values: np.ndarray) -> tuple[list[str], Tensor]:
    values = values.reshape(len(values)) if values.size == len(values) else values
    need(values.ndim == 1, f"'{key}' must have one value per sample (got shape {values.shape})")
    if values.dtype.kind == "f" and np.isnan(values).any():
        sample = int(np.isnan(values).argmax())
        raise ValueError(
            f"'{key}' must be known for every sample (got NaN in sample {sample}): fill it in, or "
            "leave out such samples"
        )
    unique, first, inverse = np.unique(values, return_index=True, return_inverse=True)
    order = np.argsort(first)  # the first spelling of a class becomes its name
    names, codes = number_labels(unique[order].tolist())
    code_of_unique = np.empty(len(unique), dtype=np.int64)
    code_of_unique[order] = codes
    return names, torch.from_numpy(code_of_unique[inverse.reshape(-1)])


def _part(values: np.ndarray) -> Tensor:
    names, codes = _names_and_codes("part", values)
    unknown = [name for name in names if name not in _PARTS]
    if unknown:
        raise ValueError(
            f"'part' must hold 0 (train), 1 (val) and 2 (test), or these names (got '{unknown[0]}')"
        )
    return torch.tensor([_PARTS[name] for name in names])[codes]
