r"""Type aliases."""

from collections.abc import Callable
from os import PathLike as _PathLike
from typing import Any, Literal

PathLike = str | _PathLike[str]
Transform = Callable[[Any], Any]
Filter = Callable[[Any], bool]
ThresholdMetric = Literal["accuracy", "balanced_accuracy", "f1", "f1_positive"]

#: Shapes of simulated objects.
Shape = Literal["box", "cylinder", "ellipsoid", "sphere"]
#: Treatment of frames that arrive before the previous ones are fetched.
Policy = Literal["all", "drop_oldest", "newest"]
