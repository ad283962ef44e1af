r"""Joint angles of an arm that moves the hand of the simulated BiGS set."""

from functools import lru_cache

import numpy as np

# Denavit-Hartenberg parameters a (m), alpha (rad) and d (m) of a seven-joint WAM.
_LINKS = (
    (0.0, -np.pi / 2, 0.0),
    (0.0, np.pi / 2, 0.0),
    (0.045, -np.pi / 2, 0.55),
    (-0.045, np.pi / 2, 0.0),
    (0.0, -np.pi / 2, 0.3),
    (0.0, np.pi / 2, 0.0),
    (0.0, 0.0, 0.06),
)
_POSTURE = np.array([0.0, 0.7, 0.0, 1.9, 0.0, np.pi - 2.6, 0.0])  # hand down, before the arm


def arm_joints(hand: np.ndarray) -> np.ndarray:
    r"""Returns joint angles of a seven-joint arm in radians :math:`(K, 7)` for places and turns of
    the hand.

    The physics has no arm: its hand moves by itself. These are the angles with which a WAM would
    move it, to first order about one posture, with the smallest sum of squares.

    Shapes:
        - **hand:** x, y, z in metres, and turns about x, y, z in radians :math:`(K, 6)`,
          from the place where the arm has that posture.
    """
    return np.asarray(_POSTURE + hand @ np.linalg.pinv(_jacobian()).T)


@lru_cache(maxsize=1)
def _jacobian() -> np.ndarray:
    frames = [np.eye(4)]
    for (a, alpha, d), angle in zip(_LINKS, _POSTURE, strict=True):
        frames.append(frames[-1] @ _link(a, alpha, d, float(angle)))
    end = frames[-1][:3, 3]
    axes = [(frame[:3, 2], frame[:3, 3]) for frame in frames[:-1]]
    return np.array([np.concatenate([np.cross(z, end - p), z]) for z, p in axes]).T


def _link(a: float, alpha: float, d: float, angle: float) -> np.ndarray:
    c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
