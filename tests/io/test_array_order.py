import numpy as np
import pytest

from torch_geometric_tactile.io._array_order import StoredArray, parse_axis_order, to_axes

AXES = ("frame", "electrode", "finger")
SIZES = {"frame": 4, "electrode": 5, "finger": 3}


@pytest.mark.parametrize(
    ("text", "stored"),
    [
        ("a/b", StoredArray(("a/b",))),
        (" a b [frame finger] ", StoredArray(("a b",), "frame finger")),
        ("l|m | r", StoredArray(("l", "m", "r"))),
        ("l | m | r [frame\n electrode]", StoredArray(("l", "m", "r"), "frame\n electrode")),
        ("@success", StoredArray(("@success",))),
    ],
)
def test_stored_array_of_text(text, stored):
    assert StoredArray.from_text("electrodes", text) == stored


@pytest.mark.parametrize("text", ["", "[frame]", "a | b", "a | | c", "a [b] c", "a [", 3])
def test_stored_array_of_other_text(text):
    with pytest.raises(ValueError, match=r"field 'pac' must be 'NAME', 'NAME \[ORDER\]' or 'LEFT"):
        StoredArray.from_text("pac", text)


@pytest.mark.parametrize(
    ("order", "groups"),
    [
        ("frame electrode finger", [["frame"], ["electrode"], ["finger"]]),
        ("(frame finger) electrode", [["frame", "finger"], ["electrode"]]),
        ("(finger)(electrode frame)", [["finger"], ["electrode", "frame"]]),
    ],
)
def test_parsed_order(order, groups):
    assert parse_axis_order("electrodes", order, AXES) == groups


@pytest.mark.parametrize(
    "order",
    [
        *("", "frame electrode", "frame electrode finger finger", "frame electrode thumb"),
        *("frame (electrode finger", "frame electrode) finger", "((frame) electrode finger)"),
        *("() frame electrode finger", "frame, electrode, finger", "frame electrode finger 3"),
    ],
)
def test_parsed_order_refuses(order):
    with pytest.raises(ValueError, match=r"order of 'electrodes' must name frame, electrode, f"):
        parse_axis_order("electrodes", order, AXES)


@pytest.mark.parametrize(
    "order",
    [
        *("frame electrode finger", "finger electrode frame", "frame (finger electrode)"),
        *("frame (electrode finger)", "(frame finger) electrode", "(electrode frame finger)"),
    ],
)
@pytest.mark.parametrize("num_frames", [4, None])
def test_arranged_undoes_any_order(order, num_frames):
    ours = np.arange(60).reshape(4, 5, 3)
    groups = parse_axis_order("electrodes", order, AXES)
    flat = [axis for group in groups for axis in group]
    shape = [int(np.prod([SIZES[axis] for axis in group])) for group in groups]
    theirs = ours.transpose([AXES.index(axis) for axis in flat]).reshape(shape)
    sizes = {**SIZES, "frame": num_frames}
    assert np.array_equal(to_axes("a", theirs, groups, sizes), ours)


def test_arranged_by_hand():
    # Two frames of a left and a right finger with two electrodes, finger by finger.
    groups = [["frame"], ["finger", "electrode"]]
    sizes = {"frame": None, "electrode": 2, "finger": 2}
    found = to_axes("a", np.array([[1, 2, 30, 40], [5, 6, 70, 80]]), groups, sizes)
    assert found.tolist() == [[[1, 30], [2, 40]], [[5, 70], [6, 80]]]


@pytest.mark.parametrize(
    ("shape", "groups", "message"),
    [
        ((4, 5), [[a] for a in AXES], r"^a must have 3 dimensions, 'frame electrode finger' \(got"),
        (
            (4, 6, 3),
            [[a] for a in AXES],
            r"^a must have 5 rows of 'electrode' .*\(got shape \(4, 6",
        ),
        ((4, 3, 5), [[a] for a in AXES], r"must have 5 rows of 'electrode'"),
        ((4, 16), [["frame"], ["finger", "electrode"]], r"3 x 5 = 15 rows of 'finger electrode'"),
        ((13, 5), [["frame", "finger"], ["electrode"]], r"4 x 3 = 12 rows of 'frame finger' .*13"),
        ((3, 5, 3), [[a] for a in AXES], r"must have 4 rows of 'frame'"),
    ],
)
def test_arranged_refuses(shape, groups, message):
    with pytest.raises(ValueError, match=message):
        to_axes("a", np.zeros(shape), groups, SIZES)


def test_arranged_finds_one_size_only():
    groups = [["frame", "finger"], ["electrode"]]
    with pytest.raises(ValueError, match=r"any number x 3 rows of 'frame finger'.*\(13, 5\)"):
        to_axes("a", np.zeros((13, 5)), groups, {**SIZES, "frame": None})
    found = to_axes("a", np.zeros((0, 5)), groups, {**SIZES, "frame": None})
    assert found.shape == (0, 5, 3)
