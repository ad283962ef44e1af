r"""Named sets of objects."""

from collections.abc import Callable, Sequence
from pathlib import Path

from torch_geometric_tactile.sim.drawn_objects import NUM_DRAWN, drawn_objects
from torch_geometric_tactile.sim.objects import GraspObject, control8, paper8, twenty

#: Functions that return the sets of objects for :func:`simulate`, by name.
OBJECT_SETS: dict[str, Callable[[], list[GraspObject]]] = {
    "paper8": paper8,
    "control8": control8,
    "twenty": twenty,
    "shapes": drawn_objects,
}


def object_set(
    objects: str | Sequence[GraspObject], num_objects: int | None = None, seed: int = 0
) -> tuple[str, list[GraspObject]]:
    r"""Returns the name and the objects of a set of objects to grasp.

    Args:
        objects (str or sequence of GraspObject): Name of the set, or your own objects with
            different names.
        num_objects (int, optional): Number of objects in :obj:`"shapes"`.
        seed (int): Seed of the objects in :obj:`"shapes"`.

    Raises:
        ValueError: If the set is unknown or empty, if names are not unique or not valid file names,
            or if :obj:`num_objects` is given for a set other than :obj:`"shapes"`.

    Examples:
        >>> name, objects = object_set("shapes", num_objects=2)
        >>> [item.name for item in objects]
        ['sphere_000', 'cylinder_000']
    """
    if num_objects is not None and not (isinstance(objects, str) and objects == "shapes"):
        raise ValueError(
            f"'num_objects' must be left out for objects other than 'shapes' (got {num_objects})"
        )
    if isinstance(objects, str):
        if objects not in OBJECT_SETS:
            raise ValueError(f"'objects' must be one of {list(OBJECT_SETS)} (got '{objects}')")
        if objects == "shapes":
            return objects, drawn_objects(NUM_DRAWN if num_objects is None else num_objects, seed)
        return objects, OBJECT_SETS[objects]()
    items = list(objects)
    for item in items:
        if not isinstance(item, GraspObject) or Path(item.name).name != item.name:
            raise ValueError(
                "'objects' must be the name of a set, or GraspObjects with names that are valid "
                f"file names (got {item!r})"
            )
    names = [item.name for item in items]
    if not items or len(set(names)) < len(names):
        raise ValueError(f"'objects' must be objects with different names (got {names})")
    return "own", items
