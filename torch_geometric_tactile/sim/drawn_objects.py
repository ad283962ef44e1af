r"""Objects with random sizes, masses and frictions."""

from functools import lru_cache

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Shape
from torch_geometric_tactile.sim.objects import GraspObject

#: The shapes of drawn objects.
SHAPES: tuple[Shape, ...] = ("sphere", "cylinder", "box", "ellipsoid")
NUM_DRAWN = 40
_WIDTH = (0.060, 0.095)  # m
_HEIGHT = (0.050, 0.090)  # m; for boxes and ellipsoids
_LENGTH = (0.120, 0.200)  # m; for all shapes except spheres
_MASS = (0.06, 0.35)  # kg
_FRICTION = (0.3, 1.0)
_BLOCK_SIZE = 10  # number of objects of a shape that are drawn together
_NUM_QUANTITIES = 6  # width, height, length, mass, friction, softness
_NUM_CANDIDATES = 1000  # Latin hypercubes per block; the least correlated is used


def drawn_objects(num_objects: int = NUM_DRAWN, seed: int = 0) -> list[GraspObject]:
    r"""Returns random spheres, cylinders, boxes and ellipsoids in turn, with widths from 60 to
    95 mm. Their size, mass, friction and softness are independent of each other and of the shape.

    Width, height, length, the logarithm of the mass (60 to 350 g), friction (0.3 to 1) and softness
    are drawn uniformly. A sphere has equal width, height and length, and a cylinder has equal width
    and height.

    To balance small sets of objects as well, ten objects of a shape are drawn together. Each
    quantity has one value in each tenth of its range. Of a thousand random orders, the order with
    the smallest correlation between width, mass, friction and softness is used. With a larger
    number of objects, the first objects stay the same.

    Args:
        num_objects (int): Number of objects.
        seed (int): Seed, which must not be negative.

    Raises:
        ValueError: If :obj:`num_objects` is below one, or if the seed is negative.

    Examples:
        >>> [item.name for item in drawn_objects(5)]
        ['sphere_000', 'cylinder_000', 'box_000', 'ellipsoid_000', 'sphere_001']
    """
    need(num_objects >= 1, "'num_objects' must be at least 1", num_objects)
    need(seed >= 0, "'seed' must not be negative", seed)
    objects = []
    for i in range(num_objects):
        number, shape_index = divmod(i, len(SHAPES))
        block, row = divmod(number, _BLOCK_SIZE)
        fractions = _draw_block(seed, shape_index, block)[row]
        objects.append(_make_object(SHAPES[shape_index], number, fractions))
    return objects


@lru_cache
def _draw_block(seed: int, shape_index: int, block: int) -> np.ndarray:
    # Returns the positions of ten objects of a shape in the ranges of the quantities, from 0 to 1.
    rng = np.random.default_rng([seed, shape_index, block])
    strata = np.broadcast_to(
        np.arange(_BLOCK_SIZE)[:, None], (_NUM_CANDIDATES, _BLOCK_SIZE, _NUM_QUANTITIES)
    )
    ranks = rng.permuted(strata, axis=1)
    properties = np.concatenate([ranks[..., [0, 3, 4]], ranks[..., 5:] < _BLOCK_SIZE // 2], axis=-1)
    properties = (properties - properties.mean(axis=1, keepdims=True)) / properties.std(
        axis=1, keepdims=True
    )
    correlation = np.abs(np.einsum("cni,cnj->cij", properties, properties))
    correlation[:, range(4), range(4)] = 0.0
    least_correlated = ranks[correlation.max(axis=(1, 2)).argmin()]
    return np.asarray((least_correlated + rng.random(least_correlated.shape)) / _BLOCK_SIZE)


def _make_object(shape: Shape, number: int, fractions: np.ndarray) -> GraspObject:
    def quantity(i: int, span: tuple[float, float]) -> float:
        return float(span[0] + fractions[i] * (span[1] - span[0]))

    width = round(quantity(0, _WIDTH), 5)
    height = round(quantity(1, _HEIGHT), 5) if shape in ("box", "ellipsoid") else width
    length = width if shape == "sphere" else round(quantity(2, _LENGTH), 5)
    low, high = np.log(_MASS)
    return GraspObject(
        name=f"{shape}_{number:03d}",
        shape=shape,
        size=(width, length, height),
        mass=round(float(np.exp(quantity(3, (low, high)))), 4),
        friction=round(quantity(4, _FRICTION), 3),
        soft=bool(fractions[5] < 0.5),
    )
