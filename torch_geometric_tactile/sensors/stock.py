r"""Layouts and kinematic chains in the data files of the package."""

import copy
import os
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors.layout import TaxelLayout

_KINDS = ("chains", "layouts")
# Sensor names that XELA's server sends, in lower case, and their layouts.
_PRODUCT_NAMES = {
    "xr1844": "uspa44",
    "xr1944": "uspa44",
    "xr1946": "uspa46",
    "xr23ahrcpp": "allegro_uskin_368",
}


def stock_path(kind: str, name: str) -> Path:
    r"""Returns the path of a data file of the package. Copy it to edit it.

    Args:
        kind (str): :obj:`"layouts"` or :obj:`"chains"`.
        name (str): Name of the file without suffix, such as :obj:`"allegro_uskin"`, or XELA's name
            of the sensor, such as :obj:`"XR1944"`. Upper and lower case are equal.

    Raises:
        ValueError: If there is no such file. The message lists the available names.

    Examples:
        >>> stock_path("layouts", "allegro_uskin").name
        'allegro_uskin.json'
    """
    need(kind in _KINDS, f"'kind' must be one of {list(_KINDS)} (got '{kind}')")
    stem = _stem(name)
    if stem not in stock_names(kind):
        raise ArgumentError(Argument("name"), f" must be one of {stock_names(kind)} (got '{name}')")
    return _folder(kind) / f"{stem}.json"


def stock_names(kind: str = "layouts") -> list[str]:
    r"""Returns the names of the data files of the package.

    Args:
        kind (str): :obj:`"layouts"` or :obj:`"chains"`.

    Examples:
        >>> "allegro_uskin" in stock_names()
        True
    """
    return sorted(file.stem for file in _folder(kind).glob("*.json"))


def _stem(name: str) -> str:
    return _PRODUCT_NAMES.get(name.lower(), name.lower())


def _folder(kind: str) -> Path:
    return Path(str(files(__package__) / kind))


def stock_layout(name: str) -> TaxelLayout:
    r"""Loads a layout of the package by its name.

    Args:
        name (str): Name of the layout, such as :obj:`"biotac"`, as in :func:`stock_path`.

    Raises:
        ValueError: If there is no such layout.

    Examples:
        >>> stock_layout("biotac").num_taxels
        19
    """
    # A copy, since a caller could change its tensors in place.
    return copy.deepcopy(_load_cached(stock_path("layouts", name)))


@lru_cache(maxsize=8)  # Reading the file of a hand takes 0.05 s.
def _load_cached(path: Path) -> TaxelLayout:
    return TaxelLayout.load(path)


def as_layout(layout: TaxelLayout | PathLike) -> TaxelLayout:
    r"""Returns a layout unchanged, or loads it by its name or from a layout file.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, its name such as :obj:`"biotac"` as in
            :func:`stock_path`, or the path of a JSON file written by :meth:`TaxelLayout.save`. A
            string that ends in :obj:`.json` or contains a folder is a path.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If there is no layout with this name, or the file is not a layout.

    Examples:
        >>> as_layout("biotac")
        TaxelLayout('biotac', num_taxels=19, patches=1, digits=1)
    """
    if isinstance(layout, TaxelLayout):
        return layout
    if not isinstance(layout, str | os.PathLike):
        raise ArgumentError(
            Argument("layout"),
            " must be a TaxelLayout, the name of a layout or the path of a layout file (got "
            f"{type(layout).__name__})",
        )
    text = str(layout)
    is_path = not isinstance(layout, str) or text.endswith(".json") or Path(text).name != text
    if is_path:
        path = os.path.expanduser(text)
        if not os.path.exists(path):
            raise FileNotFoundError(
                f"there is no layout file '{text}': write one with TaxelLayout.save, or "
                f"use one of {stock_names('layouts')}"
            )
        return TaxelLayout.load(path)
    if _stem(text) not in stock_names("layouts"):
        raise ArgumentError(
            Argument("layout"),
            f" must be one of {stock_names('layouts')}, or the path of a layout file "
            f"(.json) (got '{text}')",
        )
    return stock_layout(text)
