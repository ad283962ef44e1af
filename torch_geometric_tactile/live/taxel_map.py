r"""Maps from the taxel order of a device to the order of a layout."""

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import printable, read_json
from torch_geometric_tactile._typing import PathLike

if TYPE_CHECKING:
    from torch_geometric_tactile.sensors import TaxelLayout

_KEYS = ("index", "num_taxels", "layout", "source", "models")


class TaxelOrder(NamedTuple):
    r"""Name and size of a layout that is not loaded.

    Args:
        name (str): Name of the layout.
        num_taxels (int): Number of taxels :math:`N`.

    Examples:
        >>> TaxelOrder("allegro_uskin_368", 368).num_taxels
        368
    """

    name: str
    num_taxels: int


class TaxelMap:
    r"""Maps the taxels of a source to the order of a layout.

    Args:
        index (sequence of int): For each taxel of the layout, its index in the source, or -1 if the
            source lacks it :math:`(N,)`.
        num_taxels (int): Number of taxels of the source :math:`M`.
        layout (str): Name of the layout.
        source (str): Reference for the order, such as a document of the manufacturer.
        models (sequence of str): Model names of the sensors that send this order.

    Raises:
        ValueError: If :obj:`index` holds anything except integers from -1 to :math:`M - 1`, or
            repeats a taxel of the source.

    Examples:
        >>> TaxelMap([2, -1, 0], num_taxels=3).apply(np.float32([[10], [20], [30]]))
        array([[30.],
               [nan],
               [10.]], dtype=float32)
    """

    def __init__(
        self,
        index: Sequence[int] | np.ndarray,
        num_taxels: int,
        *,
        layout: str = "",
        source: str = "",
        models: Sequence[str] = (),
    ) -> None:
        if isinstance(num_taxels, bool) or not isinstance(num_taxels, int) or num_taxels < 1:
            raise ValueError(f"'num_taxels' must be a positive integer (got {num_taxels!r})")
        for name, text in (("layout", layout), ("source", source)):
            if not isinstance(text, str):
                raise ValueError(f"'{name}' must be a string (got {type(text).__name__})")
        is_list = isinstance(models, list | tuple)
        if not is_list or not all(isinstance(model, str) for model in models):
            raise ValueError(f"'models' must be a list of strings (got {models!r:.80})")
        self.models = tuple(models)
        self.index = _validate_index(index, num_taxels)
        self.num_taxels = num_taxels
        self.layout = layout
        self.source = source
        self._missing = np.flatnonzero(self.index < 0)

    def apply(self, tactile: np.ndarray) -> np.ndarray:
        r"""Returns readings in the order of the layout. Readings of missing taxels are NaN.

        Args:
            tactile (numpy.ndarray): Readings in the order of the source :math:`(M, C)`, float32.

        Returns:
            numpy.ndarray: Readings :math:`(N, C)`.

        Raises:
            ValueError: If the number of taxels is not :obj:`num_taxels`.
        """
        if len(tactile) != self.num_taxels:
            raise ValueError(
                f"'tactile' must have {self.num_taxels} taxels for this map (got {len(tactile)})"
            )
        out: np.ndarray = tactile[self.index]  # index -1, of missing taxels, selects the last one
        out[self._missing] = np.nan
        return out

    def save(self, path: PathLike) -> None:
        r"""Writes the map to a JSON file that can be edited by hand.

        Args:
            path (str or PathLike): The file. If writing fails, no partial file is left.
        """
        content = {
            "layout": self.layout,
            "source": self.source,
            "num_taxels": self.num_taxels,
            "index": self.index.tolist(),
            **({"models": list(self.models)} if self.models else {}),
        }
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, name_or_path: PathLike) -> Self:
        r"""Reads a map of this package by its name, or a map from a file.

        Args:
            name_or_path (str or PathLike): Name of the map, such as :obj:`"xela_allegro_368"`, or
                path of a JSON file written by :meth:`save`. Strings that end in :obj:`.json` or
                contain a folder are paths.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If there is no map with this name, or the file is not a map.
        """
        text = str(name_or_path)
        if not isinstance(name_or_path, str) or text.endswith(".json") or Path(text).name != text:
            return cls._read(Path(text).expanduser())
        if text not in cls.names():
            raise ValueError(
                f"'name_or_path' must be one of {cls.names()}, or the path of a map (.json) (got "
                f"{text!r})"
            )
        return cls._read(_folder() / f"{text}.json")

    @classmethod
    def for_sensor(
        cls, models: Sequence[str], num_taxels: int, layout: "TaxelOrder | TaxelLayout"
    ) -> Self | None:
        r"""Returns the map of this package from the taxel order of a sensor to the order of a
        layout, or :obj:`None` if there is no such map and the numbers of taxels differ.

        Args:
            models (sequence of str): Model names that the sensor reports.
            num_taxels (int): Number of taxels of the sensor :math:`M`.
            layout (TaxelOrder or TaxelLayout): The layout.

        Raises:
            ValueError: If there is no such map and the layout has the same number of taxels, since
                their order may differ.

        Examples:
            >>> TaxelMap.for_sensor(["XR23AHRCPP"], 368, TaxelOrder("allegro_uskin_368", 368))
            TaxelMap(368 -> 368, missing=0, layout='allegro_uskin_368')
        """
        sensors = {model.upper() for model in models}
        for name in cls.names():
            taxel_map = cls.load(name)
            is_matching = (taxel_map.layout, taxel_map.num_taxels) == (layout.name, num_taxels)
            if is_matching and sensors and sensors <= {model.upper() for model in taxel_map.models}:
                return taxel_map
        if num_taxels == layout.num_taxels:
            model_names = ", ".join(sorted(map(printable, sensors - {""}))) or "an unknown model"
            raise ValueError(
                f"the sensor ({model_names}) sends {num_taxels} taxels in the order of its wiring, "
                f"which may differ from layout '{printable(layout.name)}': give a taxel map "
                "(--map FILE), or --map none if both orders are equal"
            )
        return None

    @staticmethod
    def names() -> list[str]:
        r"""Returns the names of the maps of this package."""
        return sorted(file.stem for file in _folder().glob("*.json"))

    @classmethod
    def _read(cls, path: Path) -> Self:
        try:
            content = read_json(path)
            if not isinstance(content, dict) or not {"index", "num_taxels"} <= content.keys():
                raise ValueError("it must be a JSON object with 'index' and 'num_taxels'")
            unknown = [key for key in content if key not in _KEYS]
            if unknown:
                raise ValueError(
                    f"its keys must be among {list(_KEYS)} (got '{printable(unknown[0])}')"
                )
            return cls(**content)
        except ValueError as error:
            raise ValueError(f"'{path}' is not a taxel map: {error}") from error

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.num_taxels} -> {len(self.index)}, "
            f"missing={len(self._missing)}, layout={self.layout!r})"
        )


def _folder() -> Path:
    return Path(str(files(__package__) / "taxel_maps"))


def _validate_index(index: Any, num_taxels: int) -> np.ndarray:
    if isinstance(index, Sequence) and any(isinstance(entry, bool) for entry in index):
        raise ValueError("'index' must be a list of integers (got a boolean)")
    try:
        array = np.asarray(index)
    except (ValueError, OverflowError):  # rows of different lengths, too large numbers
        array = np.zeros((0, 0))
    if array.ndim != 1 or len(array) == 0 or array.dtype.kind not in "iu":
        raise ValueError(
            "'index' must be a list of integers, one for each taxel of the layout (got shape "
            f"{array.shape} of {array.dtype})"
        )
    if array.min() < -1 or array.max() >= num_taxels:
        invalid_index = array.min() if array.min() < -1 else array.max()
        raise ValueError(
            f"'index' must hold indices from 0 to {num_taxels - 1}, or -1 for a missing taxel (got "
            f"{invalid_index})"
        )
    array = array.astype(np.intp)
    indices, counts = np.unique(array[array >= 0], return_counts=True)
    if (counts > 1).any():
        raise ValueError(
            f"'index' must hold each index at most once (got {indices[counts > 1][0]} twice)"
        )
    return array
