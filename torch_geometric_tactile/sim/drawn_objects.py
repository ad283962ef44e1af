r"""Objects with drawn shapes, sizes, masses and frictions."""

from functools import lru_cache

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import Shape
from torch_geometric_tactile.sim.objects import GraspObject

#: The shapes of drawn objects.
SHAPES: tuple[Shape, ...] = ("sphere", "cylinder", "box", "ellipsoid")
NUM_DRAWN = 40
_WIDTH = (0.060, 0.095)  # m
_HEIGHT = (0.050, 0.090)  # m, of boxes and ellipsoids
_LENGTH = (0.120, 0.200)  # m, of all but spheres
_MASS = (0.06, 0.35)  # kg
_FRICTION = (0.3, 1.0)
_PER_BLOCK = 10  # objects of a shape that are drawn together
_NUM_NUMBERS = 6
_CANDIDATES = 1000


def drawn_objects(num_objects: int = NUM_DRAWN, seed: int = 0) -> list[GraspObject]:
    r"""Draws objects whose size says nothing about mass, friction and softness, and whose shape
    says nothing about any of them: spheres, cylinders, boxes and ellipsoids in turn, with widths
    from 60 to 95 mm.

    Width, height, length, mass (from 60 to 350 g, its logarithm), friction (from 0.3 to 1) and
    softness are drawn uniformly and independently of each other. So that few objects are balanced
    as well, ten objects of a shape are drawn together: each number once in each tenth of its range,
    in the order, of a thousand, in which width, mass, friction and softness are least correlated. A
    sphere is as high and as long as it is wide, and a cylinder as high as wide. Objects are the
    same however many are drawn.

    Args:
        num_objects (int): Number of objects.
        seed (int): Which objects.

    Raises:
        ValueError: If there are fewer than one, or the seed is negative.

    Examples:
        >>> [item.name for item in drawn_objects(5)]
        ['sphere_000', 'cylinder_000', 'box_000', 'ellipsoid_000', 'sphere_001']
    """
    need(num_objects >= 1, "'num_objects' must be at least 1", num_objects)
    need(seed >= 0, "'seed' must not be negative", seed)
    objects = []
    for i in range(num_objects):
        number, place = divmod(i, len(SHAPES))
        block, row = divmod(number, _PER_BLOCK)
        objects.append(_drawn_object(SHAPES[place], number, _block(seed, place, block)[row]))
    return objects


@lru_cache
def _block(seed: int, place: int, block: int) -> np.ndarray:
    # Numbers from 0 to 1 of ten objects of a shape: of many Latin hypercubes, the least correlated.
    rng = np.random.default_rng([seed, place, block])
    strata = np.broadcast_to(
        np.arange(_PER_BLOCK)[:, None], (_CANDIDATES, _PER_BLOCK, _NUM_NUMBERS)
    )
    ranks = rng.permuted(strata, axis=1)
    properties = np.concatenate([ranks[..., [0, 3, 4]], ranks[..., 5:] < _PER_BLOCK // 2], axis=-1)
    properties = (properties - properties.mean(axis=1, keepdims=True)) / properties.std(
        axis=1, keepdims=True
    )
    correlation = np.abs(np.einsum("cni,cnj->cij", properties, properties))
    correlation[:, range(4), range(4)] = 0.0
    best = ranks[correlation.max(axis=(1, 2)).argmin()]
    return np.asarray((best + rng.random(best.shape)) / _PER_BLOCK)


def _drawn_object(shape: Shape, number: int, drawn: np.ndarray) -> GraspObject:
    def between(i: int, span: tuple[float, float]) -> float:
        return float(span[0] + drawn[i] * (span[1] - span[0]))

    width = round(between(0, _WIDTH), 5)
    height = round(between(1, _HEIGHT), 5) if shape in ("box", "ellipsoid") else width
    length = width if shape == "sphere" else round(between(2, _LENGTH), 5)
    low, high = np.log(_MASS)
    return GraspObject(
        name=f"{shape}_{number:03d}",
        shape=shape,
        size=(width, length, height),
        mass=round(float(np.exp(between(3, (low, high)))), 4),
        friction=round(between(4, _FRICTION), 3),
        soft=bool(drawn[5] < 0.5),
    )
