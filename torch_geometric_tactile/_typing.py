r"""Type aliases."""

from collections.abc import Callable
from os import PathLike as _PathLike
from typing import Any, Literal

PathLike = str | _PathLike[str]
Transform = Callable[[Any], Any]
Filter = Callable[[Any], bool]
ThresholdMetric = Literal["accuracy", "balanced_accuracy", "f1", "f1_positive"]
