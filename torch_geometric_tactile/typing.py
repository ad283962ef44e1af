r"""Type aliases."""

from collections.abc import Callable
from os import PathLike as _PathLike
from typing import Any

PathLike = str | _PathLike[str]
Transform = Callable[[Any], Any]
Filter = Callable[[Any], bool]
