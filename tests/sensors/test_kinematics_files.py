import json
import math

import pytest
import torch
from small_chains import CHAIN, angles, urdf

from torch_geometric_tactile.sensors import HandKinematics, Joint, allegro_uskin, stock_path

HAND = HandKinematics.allegro()
LAYOUT = allegro_uskin()


def swing(name, parent, child):
    return Joint(name, parent, child, axis=(0, 0, 1))


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ([], r"at least one joint that moves \(got none\)"),
        ([Joint("a", "base", "tip")], r"at least one joint that moves \(got none\)"),
        ([swing("a", "base", "x"), swing("a", "x", "y")], "'joints' must have different names"),
        ([swing(str(i), str(i), str(i + 1)) for i in range(1001)], r"at most 1000 \(got 1001\)"),
        (
            [swing("a", "base", "x"), swing("b", "base", "y"), swing("c", "x", "y")],
            r"a link must have one parent \(got 'y' below 'base' and 'x'\)",
        ),
        (
            [swing("a", "base", "x"), swing("b", "other", "y")],
            r"one root \(got roots \['base', 'other'\]\)",
        ),
        ([swing("a", "x", "y"), swing("b", "y", "x")], r"one root \(got roots \[\]\)"),
        (
            [swing("a", "base", "z"), swing("b", "x", "y"), swing("c", "y", "x")],
            r"got a ring of \['x', 'y'\]",
        ),
    ],
)
def test_links_that_are_no_tree(joints, message):
    with pytest.raises(ValueError, match=message):
        HandKinematics(joints)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"xyz": (0, 0)}, r"'xyz' of joint 'a' must be three finite numbers \(got \(0.0, 0.0\)\)"),
        ({"axis": (0, 0, 0)}, "the axis of joint 'a' must not be zero"),
        (
            {"lower": 1.0, "upper": 0.0},
            r"joint 'a' must be at most 'upper' \(got 1.0 and 0.0\)",
        ),
        (
            {"lower": math.nan},
            r"'lower' of joint 'a' must be at most 'upper' \(got nan and inf\)",
        ),
    ],
)
def test_joint_rejects(changes, message):
    with pytest.raises(ValueError, match=message):
        Joint("a", "base", "tip", **changes)


def test_limits_of_a_joint_may_meet():
    joint = Joint("a", "base", "tip", lower=0.5, upper=0.5)
    assert (joint.lower, joint.upper) == (0.5, 0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no xml", "is not a URDF of a hand: syntax error"),
        ("<mujoco/>", r"root element must be 'robot' \(got 'mujoco'\)"),
        ('<robot name="r"/>', "at least one joint that moves"),
        (urdf(CHAIN).replace('"fixed"', '"prismatic"'), r"joint 'nail' must be .*got 'prismatic'"),
        (urdf(CHAIN).replace('<parent link="arm"/>', ""), "joint 'knuckle' must have a parent"),
        (urdf(CHAIN).replace('<child link="tip"/>', "<child/>"), "joint 'nail' must have a child"),
        (urdf(CHAIN).replace("0.5 0.0 0.0", "0.5 zero 0"), r"must have numbers \(got 'zero'\)"),
        (urdf(CHAIN).replace("0.5 0.0 0.0", "0_5 0 0"), r"must have numbers \(got '0_5'\)"),
        (
            urdf(CHAIN).replace("<origin xyz", "<origin xyy"),
            r"must have only the attributes .*\(got 'xyy'\)",
        ),
        (urdf(CHAIN).replace("<origin", "<origim"), r"at most once \(got 'origim'\)"),
        (urdf(CHAIN).replace(" type=", " tpye="), r"only a name and a type \(got 'tpye'\)"),
        (
            urdf(CHAIN).replace("<joint", "<joimt").replace("</joint", "</joimt"),
            "each link must be",
        ),
        (urdf(CHAIN).replace("utf-8", "utf-9"), "unknown encoding"),
    ],
)
def test_from_urdf_rejects(text, message, write):
    path = write(text)
    with pytest.raises(ValueError, match=message) as error:
        HandKinematics.from_urdf(path)
    assert "hand.urdf' is not a URDF of a hand" in str(error.value)


def test_from_urdf_names_that_do_not_fit(write):
    path = write(urdf(CHAIN))
    with pytest.raises(ValueError, match=r"\['elbow', 'knuckle'\] \(got 'wrist'\)"):
        HandKinematics.from_urdf(path, joint_names=["elbow", "wrist"])
    with pytest.raises(ValueError, match=r"moving joints.*\(got 'nail'\)"):
        HandKinematics.from_urdf(path, joint_names=["nail"])
    with pytest.raises(ValueError, match="'joint_names' must name each joint once"):
        HandKinematics.from_urdf(path, joint_names=["elbow", "elbow"])


JOINT = {"name": "a", "parent": "base", "child": "tip", "axis": [0, 0, 1]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "Expecting property name"),
        ([], "must be a JSON object with the key 'joints'"),
        ({"joints": [{"name": "a"}]}, "must list the arguments of Joint: .* missing 2 required"),
        ({"joints": [{**JOINT, "color": "red"}]}, "unexpected keyword argument 'color'"),
        ({"joints": [{**JOINT, "xyz": None}]}, "is not a table of joints"),
        ({"joints": ["a"]}, "is not a table of joints"),
        ({"joints": {"a": 1}}, r"'joints' must be a list \(got {'a': 1}\)"),
        ({"joints": [JOINT], "jolnts": []}, r"must have only the keys .*\(got 'jolnts'\)"),
        ({"joints": [JOINT], "name": 5}, r"'name' must be a string \(got 5\)"),
        ({"joints": [{**JOINT, "parent": ["base"]}]}, "'parent' of a joint must be a string"),
        ({"joints": [{**JOINT, "xyz": ["1", 0, 0]}]}, "'xyz' of joint 'a' must be numbers"),
        ({"joints": [{**JOINT, "xyz": [10**400, 0, 0]}]}, "int too large"),
        ({"joints": [{**JOINT, "lower": "-1"}]}, r"'lower' of joint 'a' must be a number"),
        ('{"joints": NaN}', r"numbers must be finite \(got NaN\)"),
    ],
)
def test_load_rejects_a_damaged_table(content, message, write):
    path = write(content, "hand.json")
    with pytest.raises(ValueError, match=message) as error:
        HandKinematics.load(path)
    assert "hand.json' is not a table of joints" in str(error.value)


def test_load_edited_table_has_the_edit(write):
    content = json.loads(stock_path("chains", "allegro_right").read_text(encoding="utf-8"))
    content["joints"][0]["xyz"][0] += 0.01
    hand = HandKinematics.load(write(content, "hand.json"))
    joint = angles(16)
    moved = hand.link_pose(joint).translation - HAND.link_pose(joint).translation
    index = [i for i, name in enumerate(HAND.link_names) if name in {
        "link_0", "link_1", "link_2", "link_3", "link_3_tip"
    }]  # fmt: skip
    expected = torch.zeros(21, 3).double()
    expected[index, 0] = 0.01
    assert torch.allclose(moved, expected, atol=1e-12)


@pytest.mark.parametrize("hand", [HAND, HandKinematics(CHAIN, name="arm")])
def test_plain_data_gives_the_same_hand(hand):
    content = json.loads(json.dumps(hand.to_dict()))
    again = HandKinematics.from_dict(content)
    assert again.joints == hand.joints
    assert again.name == hand.name
    assert again.link_names == hand.link_names
    assert again.to_dict() == hand.to_dict()


def test_slanted_axis_survives_copies_exactly():
    joint = Joint("a", "b", "c", axis=(0.1, 0.7, -0.3))
    assert Joint(**joint.to_dict()) == joint
    assert math.hypot(*joint.axis) == pytest.approx(1.0, abs=1e-15)
    assert "lower" not in joint.to_dict()
