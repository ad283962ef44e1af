import numpy as np
import pytest

from torch_geometric_tactile.sim._bigs_plan import draw_grasp

COUNT = 2000


@pytest.fixture(scope="module")
def drawn():
    """The parameters of many grasps of each object, by their names."""
    rng = np.random.default_rng(0)
    many = {shape: [draw_grasp(shape, rng) for _ in range(COUNT)] for shape in SHAPES}
    return {
        (shape, name): np.array([getattr(grasp, name) for grasp in grasps])
        for shape, grasps in many.items()
        for name in grasps[0]._fields
    }


SHAPES = ("cylinder", "box", "ball")
RANGES = [
    ("cylinder", "half_width", 0.036, 0.042),
    ("box", "half_width", 0.033, 0.039),
    ("ball", "half_width", 0.036, 0.043),
    ("cylinder", "half_height", 0.060, 0.075),
    ("box", "half_height", 0.033, 0.039),
    ("cylinder", "mass", 0.32, 0.44),
    ("box", "mass", 0.27, 0.37),
    ("ball", "mass", 0.24, 0.34),
    ("cylinder", "height", -0.025, 0.025),
    ("box", "height", -0.005, 0.027),
    ("ball", "height", -0.008, 0.008),
    ("cylinder", "spread", 0.35, 0.65),
    ("ball", "spread", 0.35, 0.65),
    *((shape, "grip", 1.0, 14.0) for shape in SHAPES),
    *((shape, "balance", 0.55, 1.45) for shape in SHAPES),
    ("box", "delay", 0.0, 0.15),
    ("box", "speed", 0.55, 0.75),
    ("box", "hold", 0.9, 1.3),
    ("box", "rise", 0.12, 0.18),
    ("box", "lift", 1.0, 1.4),
    ("box", "pause", 2.05, 2.25),
    ("box", "shake", 0.02944, 0.03456),
    ("box", "shake_time", 0.48, 0.54),
]


def test_parameters_fill_their_ranges(drawn):
    for shape, name, low, high in RANGES:
        ends = drawn[shape, name].min(), drawn[shape, name].max()
        assert ends == pytest.approx((low, high), abs=0.01 * (high - low)), (shape, name)
    assert (drawn["ball", "half_height"] == drawn["ball", "half_width"]).all()


def test_deviations_of_pose_friction_and_grip(drawn):
    for shape, median, grip in (
        ("cylinder", 0.60, 4.33),
        ("box", 0.50, 2.60),
        ("ball", 0.62, 3.28),
    ):
        yaw = 0.06 if shape == "box" else 0.3
        for name, mean, deviation in [
            ("offset", 0.0, (0.003, 0.004)),
            ("turn", 0.0, (0.07, 0.07, yaw)),
            ("bend", 0.05, (0.10,) * 3),
            ("twist", 0.0, (0.15,) * 3),
        ]:
            values = drawn[shape, name]
            assert values.std(axis=0) == pytest.approx(deviation, rel=0.08), (shape, name)
            assert np.abs(values.mean(axis=0) - mean).max() < 0.1 * max(deviation), (shape, name)
        friction = np.log(drawn[shape, "friction"] / median)
        assert (friction.mean(), friction.std()) == pytest.approx((0, 0.07), abs=0.006)
        assert np.median(drawn[shape, "grip"]) == pytest.approx(grip, rel=0.05)
        assert np.quantile(drawn[shape, "grip"], 0.25) == pytest.approx(grip / 1.401, rel=0.06)
    assert drawn["box", "spread"].std() == pytest.approx(0.05, rel=0.08)
    assert abs(drawn["box", "spread"].mean()) < 0.005
    assert np.quantile(drawn["box", "balance"], 0.25) == pytest.approx(0.852, abs=0.02)
