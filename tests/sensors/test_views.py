import pytest
import torch

from torch_geometric_tactile.sensors import HandKinematics, Joint, TaxelLayout
from torch_geometric_tactile.sensors._views import facing_axes, open_angles, pads_side_by_side


def test_an_open_hand_shows_the_pads_of_its_thumb():
    expected = torch.zeros(16)
    expected[12], expected[13] = 0.263, 1.1
    torch.testing.assert_close(open_angles(HandKinematics.allegro()), expected)


def test_an_open_hand_keeps_to_its_limits():
    joints = [
        Joint("joint_12.0", "palm", "base", axis=(0, 0, 1), lower=0.5),
        Joint("joint_13.0", "base", "thumb", axis=(0, 0, 1), upper=1.0),
    ]
    assert open_angles(HandKinematics(joints)).tolist() == [0.5, 1.0]


LINE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
WALL = [*LINE, [0.0, 0.0, 2.0]]
X, Y, Z = [1, 0, 0], [0, 1, 0], [0, 0, 1]


def negative(axis):
    return [-number for number in axis]


@pytest.mark.parametrize(
    ("pos", "normal", "axes"),
    [
        (WALL, [Z] * 3, [X, Y, Z]),
        (WALL, [negative(Z)] * 3, [Y, X, negative(Z)]),
        (WALL, [Y] * 3, [Z, X, Y]),
        (WALL, [negative(Y)] * 3, [X, Z, negative(Y)]),
        (WALL, [X] * 3, [Y, Z, X]),
        (WALL, [[0.8, 0, 0.6]] * 3, [Y, [-0.6, 0, 0.8], [0.8, 0, 0.6]]),
        (WALL, [[0.6, 0, 0.8]] * 3, [[0.8, 0, -0.6], Y, [0.6, 0, 0.8]]),
        (LINE, [Z, negative(Z)], [X, Y, Z]),
        (WALL, None, [Z, X, Y]),
        ([[3.0, 3.0, 3.0]], None, [X, Y, Z]),
    ],
    ids=["z", "-z", "y", "-y", "x", "slanted x", "slanted z", "cancelling", "flat", "one"],
)
def test_a_pad_is_seen_from_its_normals_or_along_its_least_extent(pos, normal, axes):
    normal = None if normal is None else torch.tensor(normal).float()
    found = facing_axes(torch.tensor(pos), normal)
    torch.testing.assert_close(found, torch.tensor(axes).double())


def test_pads_are_side_by_side_half_of_the_largest_apart():
    pads = torch.tensor([[1, 0, 0], [7, 7, 7], [5, 0, 0], [8, 7, 7], [1, 2, 0], [7, 10, 7]])
    normal = torch.tensor([Z] * 6).float()
    link = {"link": [0, 1] * 3, "link_names": ("wide", "high")}
    layout = TaxelLayout("two", pads.float(), normal, **link)
    (wide, first, shift), (high, second, more) = pads_side_by_side(layout)
    assert (wide.tolist(), high.tolist()) == ([0, 2, 4], [1, 3, 5])
    assert first.equal(second)
    assert first.equal(torch.eye(3).double())
    assert shift.tolist() == [-1, -1, 0]
    assert more.tolist() == pytest.approx([4 + 0.5 * 4 - 7, -8.5, -7])
