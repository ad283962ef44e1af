import numpy as np
import pytest

from torch_geometric_tactile.sim import SHAPES, drawn_objects
from torch_geometric_tactile.sim._object_sets import OBJECT_SETS, object_set

TOLD = ("width", "mass", "friction", "soft")


def table(objects):
    return np.array([[getattr(item, name) for name in TOLD] for item in objects], dtype=float)


def test_shapes_take_turns_and_names_are_different():
    objects = drawn_objects(9)
    assert [item.shape for item in objects] == [*SHAPES, *SHAPES, "sphere"]
    assert [item.name for item in objects[:5]] == [
        "sphere_000", "cylinder_000", "box_000", "ellipsoid_000", "sphere_001"
    ]  # fmt: skip
    assert len({item.name for item in drawn_objects(200)}) == 200


def test_sizes_are_continuous_and_within_their_range():
    objects = drawn_objects(400)
    width = np.array([item.width for item in objects])
    assert 0.060 <= width.min() < 0.062
    assert 0.093 < width.max() <= 0.095
    assert len(set(width.tolist())) > 350
    for item in objects:
        x, y, z = item.size
        assert 0.06 <= item.mass <= 0.35
        assert 0.3 <= item.friction <= 1.0
        if item.shape == "sphere":
            assert x == y == z
        else:
            assert 0.12 <= y <= 0.2
            assert item.shape != "cylinder" or x == z


@pytest.mark.parametrize(("count", "most"), [(40, 0.2), (400, 0.08), (2000, 0.04)])
@pytest.mark.parametrize("seed", range(3))
def test_size_mass_friction_and_softness_are_not_correlated(count, most, seed):
    correlation = np.corrcoef(table(drawn_objects(count, seed)).T)
    assert np.abs(correlation - np.eye(4)).max() < most


@pytest.mark.parametrize(("count", "most"), [(40, 0.1), (400, 0.03)])
def test_shape_says_nothing_about_the_rest(count, most):
    objects = drawn_objects(count)
    numbers, shape = table(objects), np.array([item.shape for item in objects])
    means = np.array([numbers[shape == name].mean(axis=0) for name in SHAPES])
    assert (means.std(axis=0) < most * numbers.std(axis=0)).all()


def test_within_a_shape_they_are_hardly_correlated():
    objects = drawn_objects(400)
    for name in SHAPES:
        numbers = table([item for item in objects if item.shape == name])
        assert np.abs(np.corrcoef(numbers.T) - np.eye(4)).max() < 0.2


def test_more_objects_begin_with_the_same_and_seeds_differ():
    assert drawn_objects(50)[:13] == drawn_objects(13)
    assert drawn_objects(8, seed=1) != drawn_objects(8)


def test_set_of_drawn_objects():
    assert object_set("shapes", 3, seed=4) == ("shapes", drawn_objects(3, 4))
    assert object_set("shapes")[1] == OBJECT_SETS["shapes"]() == drawn_objects(40, 0)


def test_bad_numbers_are_named():
    with pytest.raises(ValueError, match=r"'num_objects' must be at least 1 \(got 0\)"):
        drawn_objects(0)
    with pytest.raises(ValueError, match=r"'seed' must not be negative \(got -1\)"):
        drawn_objects(seed=-1)
