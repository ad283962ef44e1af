r"""What a transform says about itself."""

from collections.abc import Callable, Set
from inspect import signature
from typing import TYPE_CHECKING, Any

from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout

_DECLARED = ("reads", "writes", "per_frame")


class TactileTransform(BaseTransform):
    r"""The base class of transforms that say what they do, in one place. Data sets, predictors and
    the ONNX export ask them, so that a new transform is one class and its test.

    A subclass declares, as class attributes, or as properties if they depend on arguments:

    * :obj:`reads`, :obj:`writes`: names of the attributes that its result follows from, and of
      those that it sets. If all samples share what it reads, a predictor computes it once.
    * :obj:`per_frame`: whether it does the same to each frame of a window by itself.
    * :obj:`is_random`: whether it draws random numbers (not, by default).
    * :obj:`causal`: whether it uses no frames to come (so it is, by default).
    * :obj:`supports_static`: whether it takes many samples :math:`(B, N, F)` at once (so it does,
      by default).

    What a class declares does not hold for a subclass with a :obj:`forward` of its own, unless that
    declares :obj:`reads` again; without, it is called for each sample by itself.

    Raises:
        TypeError: If a class with a :obj:`forward` lacks a declaration.

    Examples:
        >>> class Rectify(TactileTransform):
        ...     reads, writes, per_frame = ("x",), ("x",), True
        ...     def forward(self, data):
        ...         data.x = data.x.clamp(min=0)
        ...         return data
        >>> Rectify().is_random
        False
    """

    causal: bool = True
    supports_static: bool = True

    if TYPE_CHECKING:  # properties, which class attributes and properties may take the place of

        @property
        def reads(self) -> tuple[str, ...]: ...  # noqa: D102
        @property
        def writes(self) -> tuple[str, ...]: ...  # noqa: D102
        @property
        def per_frame(self) -> bool: ...  # noqa: D102
        @property
        def is_random(self) -> bool: ...  # noqa: D102

    else:
        is_random = False

    def __init_subclass__(cls, **arguments: Any) -> None:
        super().__init_subclass__(**arguments)
        missing = [name for name in _DECLARED if not hasattr(cls, name)]
        if "forward" in vars(cls) and missing:
            raise TypeError(
                f"'{missing[0]}' of {cls.__name__} must be declared, as in "
                f'reads, writes, per_frame = ("x",), ("x",), True (got none)'
            )

    def graph_step(
        self, known: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns what does the same to one frame or window in an exported graph, in which no
        shape and no choice may depend on values: the transform itself, unless a class says
        otherwise.

        Args:
            known (StaticData): What is the same for all frames, before the transform.
            changing (set of str): The attributes that differ from frame to frame.

        Raises:
            NotImplementedError: If there is no such graph.
        """
        return self

    def __repr__(self) -> str:
        shown = []
        for name in signature(type(self)).parameters:
            value = getattr(self, name, None)
            if isinstance(value, TaxelLayout):
                shown.append(repr(value.name))
            elif name != "generator" and hasattr(self, name):
                shown.append(f"{name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"
