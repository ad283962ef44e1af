r"""Objects for the simulated hand."""

from dataclasses import dataclass, replace
from itertools import product

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Shape
from torch_geometric_tactile.data._paper_objects import PAPER_OBJECTS
from torch_geometric_tactile.data._paper_objects import PROPERTIES as _PROPERTIES

#: The properties of objects, in the order of the "Tactile Object Property Recognition ..." paper.
PROPERTIES = _PROPERTIES

_MASS = {"light": 0.08, "heavy": 0.35}  # kg
_FRICTION = {"slippery": 0.30, "non-slippery": 1.0}

_SHAPES = ("box", "cylinder", "ellipsoid", "sphere")


@dataclass(frozen=True)
class GraspObject:
    r"""An object for the simulated hand. Sizes and labels follow the descriptions in the papers;
    masses and friction coefficients are plausible, not measured.

    The plan of a grasp may depend on the size, but not on the mass, friction and softness.

    Args:
        name (str): Name of the object.
        shape (str): :obj:`"box"`, :obj:`"cylinder"` (axis along :math:`y`), :obj:`"ellipsoid"` or
            :obj:`"sphere"`.
        size (tuple of float): Full extent along :math:`x` (between fingers and thumb), :math:`y`
            (across the fingers) and :math:`z` (upwards), in metres.
        mass (float): Mass in kilograms.
        friction (float): Coefficient of sliding friction against the skin.
        soft (bool): Whether the surface is soft.

    Raises:
        ValueError: If the shape is unknown or a number is not positive.

    Examples:
        >>> paper8()[3].labels
        (0, 1, 0, 1, 1, 0)
    """

    name: str
    shape: Shape
    size: tuple[float, float, float]
    mass: float
    friction: float
    soft: bool

    def __post_init__(self) -> None:
        need(self.shape in _SHAPES, f"'shape' must be one of {_SHAPES} (got '{self.shape}')")
        if self.shape == "cylinder" and self.size[0] != self.size[2]:
            raise ValueError(f"a cylinder must be as wide as it is high (got {self.size})")
        if self.shape == "sphere" and len(set(self.size)) > 1:
            raise ValueError(f"a sphere must have one size in all directions (got {self.size})")
        for key, numbers in (
            ("size", self.size),
            ("mass", [self.mass]),
            ("friction", [self.friction]),
        ):
            if not all(0 < number < float("inf") for number in numbers):
                raise ValueError(f"'{key}' must be positive (got {numbers})")

    @property
    def width(self) -> float:
        r"""The extent between fingers and thumb in metres."""
        return self.size[0]

    @property
    def labels(self) -> tuple[int, ...]:
        r"""The six properties in the order of :obj:`PROPERTIES`: 1 if the object has a property,
        otherwise 0.
        """
        properties = {
            "heavy" if self.mass > sum(_MASS.values()) / 2 else "light",
            "soft" if self.soft else "hard",
            "slippery" if self.friction < sum(_FRICTION.values()) / 2 else "non-slippery",
        }
        return tuple(int(name in properties) for name in PROPERTIES)


def _make_object(
    name: str, shape: Shape, millimetres: tuple[float, float, float], properties: str
) -> GraspObject:
    weight, softness, slip = properties.split()
    x, y, z = millimetres
    return GraspObject(
        name=name,
        shape=shape,
        size=(x / 1000, y / 1000, z / 1000),
        mass=_MASS[weight],
        friction=_FRICTION[slip],
        soft=softness == "soft",
    )


def paper8() -> list[GraspObject]:
    r"""Returns the eight objects of the "Tactile Object Property Recognition ..." paper as
    primitive shapes. There is one object for each combination of two masses, two degrees of
    softness and two friction coefficients.

    Examples:
        >>> [item.name for item in paper8()][:3]
        ['plastic_tube', 'sponge', 'mayonnaise']
    """
    shapes: dict[str, tuple[Shape, tuple[float, float, float]]] = {  # sizes in millimetres
        "plastic_tube": ("cylinder", (56, 170, 56)),
        "sponge": ("box", (70, 115, 60)),
        "mayonnaise": ("ellipsoid", (68, 190, 68)),
        "kitchen_paper": ("cylinder", (90, 220, 90)),
        "potato_chip_can": ("cylinder", (74, 200, 74)),
        "mango_replica": ("ellipsoid", (80, 115, 80)),
        "saran_wrap": ("box", (50, 220, 50)),
        "purse": ("box", (60, 120, 85)),
    }
    return [
        _make_object(name, *shapes[name], " ".join(PAPER_OBJECTS[name])) for name in PAPER_OBJECTS
    ]


def control8() -> list[GraspObject]:
    r"""Returns eight objects with the same shape and size, one for each combination of mass,
    softness and friction. Their shape does not distinguish them.

    Examples:
        >>> objects = control8()
        >>> len(objects), {item.size for item in objects}
        (8, {(0.068, 0.18, 0.068)})
    """
    return [
        _make_object(
            f"{weight}_{softness}_{slip}", "cylinder", (68, 180, 68), f"{weight} {softness} {slip}"
        )
        for weight, softness, slip in product(
            ("light", "heavy"), ("hard", "soft"), ("slippery", "non-slippery")
        )
    ]


def twenty() -> list[GraspObject]:
    r"""Returns twenty objects: five shapes in four sizes. The "Morphology-Specific Convolutional
    Neural Networks ..." paper has the same number of objects.

    Examples:
        >>> len(twenty()), twenty()[0].name
        (20, 'tube_0')
    """
    shapes = [
        _make_object("tube", "cylinder", (64, 180, 64), "light soft slippery"),
        _make_object("can", "cylinder", (68, 120, 68), "light hard non-slippery"),
        _make_object("ball", "ellipsoid", (76, 90, 76), "light soft non-slippery"),
        _make_object("bottle", "ellipsoid", (68, 190, 68), "heavy hard slippery"),
        _make_object("carton", "box", (62, 130, 66), "heavy hard non-slippery"),
    ]
    return [
        replace(item, name=f"{item.name}_{i}", size=_scale(item.size, factor))
        for item in shapes
        for i, factor in enumerate((0.85, 0.95, 1.05, 1.15))
    ]


def _scale(size: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    x, y, z = size
    return (round(x * factor, 4), round(y * factor, 4), round(z * factor, 4))
