from dataclasses import replace
from itertools import product

import pytest

from torch_geometric_tactile.sim import (
    PROPERTIES,
    GraspObject,
    control8,
    paper8,
    twenty,
)
from torch_geometric_tactile.sim._object_sets import OBJECT_SETS

CAN = GraspObject("can", "cylinder", (0.07, 0.12, 0.07), mass=0.1, friction=1.0, soft=False)


def test_properties_are_in_the_order_of_the_paper():
    assert PROPERTIES == ("light", "heavy", "hard", "soft", "non-slippery", "slippery")


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("plastic_tube", (1, 0, 0, 1, 0, 1)),
        ("sponge", (1, 0, 0, 1, 1, 0)),
        ("mayonnaise", (0, 1, 0, 1, 0, 1)),
        ("kitchen_paper", (0, 1, 0, 1, 1, 0)),
        ("potato_chip_can", (1, 0, 1, 0, 0, 1)),
        ("mango_replica", (1, 0, 1, 0, 1, 0)),
        ("saran_wrap", (0, 1, 1, 0, 0, 1)),
        ("purse", (0, 1, 1, 0, 1, 0)),
    ],
)
def test_labels_of_the_eight_objects(name, labels):
    (item,) = (item for item in paper8() if item.name == name)
    assert item.labels == labels


@pytest.mark.parametrize("objects", [paper8, control8])
def test_every_combination_once(objects):
    combinations = [(item.mass, item.soft, item.friction) for item in objects()]
    assert sorted(combinations) == sorted(product((0.08, 0.35), (False, True), (0.3, 1.0)))
    assert len({item.labels for item in objects()}) == 8
    assert len({item.name for item in objects()}) == 8


def test_control_objects_have_one_shape_and_size():
    assert {(item.shape, item.size) for item in control8()} == {("cylinder", (0.068, 0.18, 0.068))}


def test_control_objects_are_named_after_what_they_are():
    for item in control8():
        named = [item.name.split("_").count(name) for name in PROPERTIES]
        assert tuple(named) == item.labels


def test_twenty_have_names_shapes_and_sizes_of_their_own():
    items = twenty()
    assert len({item.name for item in items}) == len({item.size for item in items}) == 20
    assert {item.shape for item in items} == {"box", "cylinder", "ellipsoid"}
    assert len({item.name.rpartition("_")[0] for item in items}) == 5


def test_object_sets_are_made_anew():
    for name, make in OBJECT_SETS.items():
        assert make() == make(), name
        assert make() is not make()


def test_bad_values_are_named():
    with pytest.raises(
        ValueError, match=r"a sphere must have one size .* \(got \(0.07, 0.12, 0.07"
    ):
        replace(CAN, shape="sphere")
    with pytest.raises(ValueError, match=r"'shape' must be .* \(got 'cone'\)"):
        replace(CAN, shape="cone")
    with pytest.raises(ValueError, match=r"as wide as it is high \(got \(0.07, 0.12, 0.08\)\)"):
        replace(CAN, size=(0.07, 0.12, 0.08))
    with pytest.raises(ValueError, match=r"'size' must be positive \(got \(0.07, 0, 0.07\)\)"):
        replace(CAN, size=(0.07, 0, 0.07))
    for value in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="'mass' must be positive"):
            replace(CAN, mass=value)
        with pytest.raises(ValueError, match="'friction' must be positive"):
            replace(CAN, friction=value)
