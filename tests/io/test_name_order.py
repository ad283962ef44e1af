import re
from pathlib import Path

import numpy as np
import pytest

from torch_geometric_tactile.io._name_order import check_name_order
from torch_geometric_tactile.io._named_csv import read_named_csv

FILE = Path("grasp.csv")


def named(*forms, taxels=range(12)):
    """Names of forms with a number in them, axis after axis."""
    return [form.format(i) for form in forms for i in taxels]


def by_taxel(*forms, taxels=range(12)):
    return [form.format(i) for i in taxels for form in forms]


GRID = [f"p{row}_{col}" for row in range(12) for col in range(11)]
FLAT_FINGERS = named("thumb_{}", "index_{}", "ring_{}")
HONEST = [
    (named("s{}"), 1),
    (sorted(named("s{:02}")), 1),  # numbers of two digits are in both orders
    (["s3", "s1", "s10", "s2"], 1),  # in no order
    (["thumb", "index", "middle", "ring"], 1),
    (GRID, 1),
    ([f"p{row}_{col}" for col in range(11) for row in range(12)], 1),  # column by column
    (by_taxel("x{}", "y{}", "z{}"), 3),
    (by_taxel("x{}", "y{}", "z{}", taxels=range(3)), 3),  # as many taxels as channels
    (by_taxel("t{}_c0", "t{}_c1", "t{}_c2", taxels=range(3)), 3),
    ([f"{f}_{a}" for f in ("thumb", "index", "ring") for a in "xyz"], 3),
    ([f"{f}_{i}" for f in ("thumb", "index", "ring") for i in range(3)], 3),
    ([f"{f}_{i}" for f in ("left", "right") for i in range(2)], 2),
    (FLAT_FINGERS, 3),  # four taxels of three channels on each, counted through
    (named("x{}", "y{}", "z{}"), 1),  # each column a taxel
    (["x0", "y0", "x1"], 3),
    ([], 1),
]


@pytest.mark.parametrize(("names", "num_channels"), HONEST)
def test_an_order_that_names_allow_is_read(names, num_channels):
    check_name_order(FILE, "tactile", names, num_channels)


@pytest.mark.parametrize(
    ("names", "right"),
    [
        (sorted(named("s{}")), "s0, s1, s2, s3, s4, s5, s6, s7, ..."),
        (sorted(named("thumb_{}_force")), "thumb_0_force, thumb_1_force, thumb_2_force"),
        (sorted(GRID), "p0_0, p0_1, p0_2, p0_3"),
        (sorted(GRID, key=lambda name: name.split("_")[::-1]), "p0_0, p0_1, p0_2"),
        (by_taxel("x{}", "y{}", taxels=(0, 1, 10, 11, 2, 3)), "x0, y0, x1, y1, x2, y2, x3, y3"),
        (sorted(named("x{}")) + sorted(named("y{}")), "x0, x1, x2"),
        (["a", "s1", "s10", "b", "s2"], "a, s1, s2, b, s10"),
    ],
)
def test_numbers_that_are_sorted_as_texts_are_refused(names, right):
    message = rf"sorted as text \(.*\) and not by number \({re.escape(right)}"
    with pytest.raises(ValueError, match=message):
        check_name_order(FILE, "tactile", names)


@pytest.mark.parametrize(
    ("names", "num_channels", "right"),
    [
        (["x0", "x1", "y0", "y1", "z0", "z1"], 3, "x0, y0, z0, x1, y1, z1"),
        (named("{}_x", "{}_y"), 2, "0_x, 0_y, 1_x, 1_y"),
        (named("ax{:02}", "ay{:02}", "az{:02}"), 3, "ax00, ay00, az00, ax01"),
        (named("x{}", "y{}", "z{}", taxels=range(3)), 3, "x0, y0, z0, x1"),
        (named("thumb_x{}", "thumb_y{}", "thumb_z{}"), 3, "thumb_x0, thumb_y0, thumb_z0, thumb_x1"),
        ([f"{f}_{a}{i}" for a in "xyz" for f in ("thumb", "index") for i in (1, 2)], 3, "thumb_x1"),
        (["x_thumb", "x_index", "y_thumb", "y_index"], 2, "x_thumb, y_thumb, x_index"),
        (named("p{}", "t{}", taxels=range(4)), 2, "p0, t0, p1, t1"),
        (named("normal_{}", "shear_{}", taxels=range(5)), 2, "normal_0, shear_0, normal_1"),
    ],
)
def test_one_axis_after_the_other_is_refused(names, num_channels, right):
    message = rf"sorted by axis \(.*\) and not by taxel \(.*{right}"
    with pytest.raises(ValueError, match=message):
        check_name_order(FILE, "tactile", names, num_channels)


def write(path, names):
    cells = ",".join(str(i) for i in range(len(names)))
    path.write_text(f"time,{','.join(names)}\n0,{cells}\n0.01,{cells}\n")
    return path


@pytest.mark.parametrize("options", [{}, {"tactile": r"s\d+"}])
def test_a_file_in_the_order_of_texts_needs_a_list(tmp_path, options):
    names = named("s{}")
    path = write(tmp_path / "a.csv", sorted(names))
    message = r"'tactile' must list the columns of '.*a.csv' .*: give tactile=\['s0', 's1', 's2', "
    with pytest.raises(ValueError, match=message):
        read_named_csv(path, **options)
    read = read_named_csv(path, tactile=names)
    assert read.tactile[0, 2, 0] == sorted(names).index("s2")
    kept = read_named_csv(path, tactile=sorted(names))
    assert kept.tactile[0, :, 0].tolist() == [*range(12)]


def test_joints_in_the_order_of_texts_need_a_list(tmp_path):
    path = write(tmp_path / "a.csv", ["pad", *sorted(named("j{}"))])
    with pytest.raises(ValueError, match=r"'joint' must list .* give joint=\['j0', 'j1', 'j2', "):
        read_named_csv(path, joint=r"j\d+")
    assert read_named_csv(path, joint=named("j{}")).joint[0, 2] == 5


def test_a_file_of_one_axis_after_the_other_needs_a_list(tmp_path):
    path = write(tmp_path / "a.csv", ["x0", "x1", "y0", "y1", "z0", "z1"])
    with pytest.raises(ValueError, match=r"give tactile=\['x0', 'y0', 'z0', 'x1', 'y1', 'z1'\]"):
        read_named_csv(path, num_channels=3)
    names = ["x0", "y0", "z0", "x1", "y1", "z1"]
    read = read_named_csv(path, tactile=names, num_channels=3)
    np.testing.assert_array_equal(read.tactile[0], [[0, 2, 4], [1, 3, 5]])
    assert read_named_csv(path).num_taxels == 6
