r"""Joints of a kinematic chain."""

import math
from dataclasses import dataclass
from typing import Any

from torch_geometric_tactile.sensors._content_checks import MAX_NUMBER, need_text


@dataclass(frozen=True)
class Joint:
    r"""A joint of a kinematic chain.

    Args:
        name (str): Name of the joint.
        parent (str): Name of the link that carries the joint.
        child (str): Name of the link that the joint moves.
        xyz (tuple of float): Origin of the child in the parent's frame, in metres.
        rpy (tuple of float): Rotation of the child at angle zero, about the parent's fixed
            :math:`x`, then :math:`y`, then :math:`z` axis, in radians.
        axis (tuple of float, optional): Axis of rotation in the child's frame. It is normalised.
            :obj:`None` for a fixed joint.
        lower (float): Lower limit in radians.
        upper (float): Upper limit in radians.

    Raises:
        ValueError: If a name is not a string, a vector is not three finite numbers, the axis is
            zero, or the lower limit is above the upper one.

    Examples:
        >>> Joint("bend", "palm", "tip", xyz=(0.0, 0.0, 0.1), axis=(0.0, 1.0, 0.0), upper=1.6).upper
        1.6
    """

    name: str
    parent: str
    child: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] | None = None
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        for key in ("name", "parent", "child"):
            need_text(getattr(self, key), f"'{key}' of a joint")
        for key in ("lower", "upper"):
            if isinstance(getattr(self, key), str | bool):
                raise ValueError(
                    f"'{key}' of joint '{self.name}' must be a number (got {getattr(self, key)!r})"
                )
        for key in ("xyz", "rpy", "axis"):
            value = getattr(self, key)
            if value is None and key == "axis":
                continue
            if isinstance(value, str) or any(isinstance(number, str | bool) for number in value):
                raise ValueError(f"'{key}' of joint '{self.name}' must be numbers (got {value!r})")
            value = tuple(float(number) for number in value)
            if len(value) != 3 or not all(abs(number) <= MAX_NUMBER for number in value):
                raise ValueError(
                    f"'{key}' of joint '{self.name}' must be three finite numbers (got {value})"
                )
            object.__setattr__(self, key, value)
        if self.axis is not None:
            length = math.hypot(*self.axis)
            if not 0 < length < math.inf:
                raise ValueError(
                    f"the axis of joint '{self.name}' must not be zero (got {self.axis})"
                )
            # A unit axis stays as it is: dividing again would change its last digits in a copy.
            if not math.isclose(length, 1.0, rel_tol=1e-15):
                object.__setattr__(self, "axis", tuple(number / length for number in self.axis))
        if not float(self.lower) <= float(self.upper):
            raise ValueError(
                f"'lower' of joint '{self.name}' must be at most 'upper' (got {self.lower} and "
                f"{self.upper})"
            )

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values. Infinite limits are left out."""
        content: dict[str, Any] = {"name": self.name, "parent": self.parent, "child": self.child}
        content |= {"xyz": list(self.xyz), "rpy": list(self.rpy)}
        if self.axis is not None:
            content["axis"] = list(self.axis)
        for key in ("lower", "upper"):
            if math.isfinite(getattr(self, key)):
                content[key] = float(getattr(self, key))
        return content
