r"""The base class of transforms, with the properties that each transform declares."""

from collections.abc import Callable, Set
from inspect import signature
from typing import TYPE_CHECKING, Any

from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout

_DECLARED = ("reads", "writes", "per_frame")


class TactileTransform(BaseTransform):
    r"""The base class of transforms that declare their properties. Data sets, predictors and the
    ONNX export read these declarations, so that a new transform needs only one class and a test.

    A subclass declares the following class attributes, or properties if they depend on arguments:

    * :obj:`reads`: names of the attributes on which the output depends. If all samples share them,
      a predictor computes the output once.
    * :obj:`writes`: names of the attributes that the transform sets.
    * :obj:`per_frame`: whether it changes each frame of a window independently of other frames.
    * :obj:`is_random`: whether it draws random numbers; :obj:`False` by default.
    * :obj:`causal`: whether it works without later frames; :obj:`True` by default.
    * :obj:`supports_static`: whether it accepts many samples :math:`(B, N, F)` at once;
      :obj:`True` by default.

    A subclass that overrides :obj:`forward` must declare :obj:`reads` again. Otherwise, the
    declarations of its base class do not apply, and the subclass is called for each sample.

    Raises:
        TypeError: If a class that defines :obj:`forward` lacks a declaration.

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

    if TYPE_CHECKING:  # for mypy, subclasses can replace properties by attributes or properties

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
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a function with the same effect on a frame or window in an exported graph, in
        which shapes and branches must not depend on values. The default is the transform itself.

        Args:
            constants (StaticData): The attributes that are the same for all frames, before the
                transform.
            changing (set of str): The attributes that differ from frame to frame.

        Raises:
            NotImplementedError: If the transform cannot be exported.
        """
        return self

    def __repr__(self) -> str:
        arguments = []
        for name in signature(type(self)).parameters:
            value = getattr(self, name, None)
            if isinstance(value, TaxelLayout):
                arguments.append(repr(value.name))
            elif name != "generator" and hasattr(self, name):
                arguments.append(f"{name}={value!r}")
        return f"{type(self).__name__}({', '.join(arguments)})"
