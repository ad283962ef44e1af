"""Columns of a recording in the order of others."""

import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._column_order import column_names, in_column_order

COLUMNS = {"tactile": ["thumb_x", "thumb_y", "index_x", "index_y"], "joint": ["q0", "q1"]}


def recording(columns=COLUMNS):
    tactile = [[[1.0, 2.0], [3.0, 4.0]], [[5.0, 6.0], [7.0, 8.0]]]
    meta = {"unit": "newton", "column_names": columns}
    return Recording([0.0, 0.1], tactile, joint=[[0.25, 0.5], [1.0, 2.0]], meta=meta)


def test_readings_and_angles_follow_the_wanted_names():
    wanted = {"tactile": ["index_y", "thumb_x", "thumb_y", "index_x"], "joint": ("q1", "q0")}
    found = in_column_order(recording(), wanted)
    assert found.tactile.tolist() == [[[4, 1], [2, 3]], [[8, 5], [6, 7]]]
    assert found.joint.tolist() == [[0.5, 0.25], [2.0, 1.0]]
    assert found.meta["unit"] == "newton"
    assert column_names(found) == {"tactile": wanted["tactile"], "joint": ["q1", "q0"]}


@pytest.mark.parametrize("wanted", [COLUMNS, {"joint": ["q0", "q1"]}, {}])
def test_recording_in_the_wanted_order_is_returned_as_it_is(wanted):
    made = recording()
    assert in_column_order(made, wanted) is made


def test_columns_that_are_not_known_are_left_in_their_order():
    made = recording({"joint": ["q0", "q1"]})
    assert column_names(made) == {"joint": ["q0", "q1"]}
    assert in_column_order(made, {"tactile": ["index_y", "thumb_x"]}) is made


@pytest.mark.parametrize(
    ("key", "wanted", "difference"),
    [
        ("tactile", ["thumb_y", "index_x", "index_y"], "'thumb_x' in place of none"),
        ("joint", ["q1", "q0", "q2"], "none in place of 'q2'"),
        ("joint", ["q1", "q2"], "'q0' in place of 'q2'"),
        ("joint", list("abcdefgh"), "'q0', 'q1' in place of 'a', 'b', 'c', 'd', 'e', 'f' and 2 mo"),
    ],
)
def test_columns_of_other_names_are_refused_with_the_difference(key, wanted, difference):
    match = rf"columns of '{key}' must have the expected names, .* \(got {difference}"
    with pytest.raises(ValueError, match=match):
        in_column_order(recording(), {key: wanted})


@pytest.mark.parametrize(
    ("columns", "size", "key"),
    [
        ({"tactile": ["a", "b", "c"]}, 4, "tactile"),
        ({"tactile": ["a", "b", "c", "d", "e"]}, 4, "tactile"),
        ({"tactile": ["a", "b", "c", "c"]}, 4, "tactile"),
        ({"tactile": ["a", "b", "c", "d", "d"]}, 4, "tactile"),
        ({"tactile": ["a", "b", "c", 1]}, 4, "tactile"),
        ({"tactile": "abcd"}, 4, "tactile"),
        ({"joint": ["q0"]}, 2, "joint"),
        (5, 4, "tactile"),
    ],
)
def test_names_that_are_not_those_of_the_columns_are_refused(columns, size, key):
    match = rf"'column_names' in 'meta' must name each of the {size} columns of '{key}' once"
    with pytest.raises(ValueError, match=match):
        column_names(recording(columns))
