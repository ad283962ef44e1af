import numpy as np

from torch_geometric_tactile.sim.simulate_bigs import _LINKS, _POSTURE, _arm_joints, _link_transform


def hand_of(joints):
    frame = np.eye(4)
    for (a, alpha, d), angle in zip(_LINKS, joints, strict=True):
        frame = frame @ _link_transform(a, alpha, d, angle)
    return frame


def test_arm_rests_in_its_posture_with_the_hand_down():
    assert np.allclose(_arm_joints(np.zeros((1, 6))), _POSTURE)
    assert np.allclose(hand_of(_POSTURE)[:3, 2], [0, 0, -1], atol=1e-9)


def test_small_motions_are_those_of_the_hand():
    step = 1e-4
    for axis in range(6):
        moved = np.zeros((1, 6))
        moved[0, axis] = step
        before, after = hand_of(_POSTURE), hand_of(_arm_joints(moved)[0])
        turn = after[:3, :3] @ before[:3, :3].T
        angles = np.array(
            [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        )
        got = np.concatenate([after[:3, 3] - before[:3, 3], angles / 2])
        assert np.allclose(got, moved[0], atol=step / 1000)
