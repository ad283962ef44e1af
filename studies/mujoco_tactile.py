r"""Our contact model of a skin beside MuJoCo's own tactile sensor, on the same presses.

A sphere, a lying cylinder and a flat box are pressed on a pad with known forces and without
friction. The skin is that of the simulated hand: a sphere of 3.5 mm below the surface for each
taxel, whose contact forces are the readings. The other pad is one box of the same softness with
MuJoCo's ``tactile`` sensor, which returns how deep each taxel is inside the other body. Printed are
the correlation of both pressure maps over the taxels, the error of the total force (the depths
times one stiffness, fitted on the sphere), and the time of a step.

Examples:
    PYTHONPATH=benchmarks python studies/mujoco_tactile.py
"""

import time
from collections.abc import Callable

import mujoco
import numpy as np
from shared import parse, print_setting

from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.sim.hand_model import _SOLIMP, ContactParameters

PITCH = 0.004667
MASS, HEIGHT = 0.2, 0.01
SHAPES = {
    "sphere": f'type="sphere" size="{1.5 * HEIGHT}"',
    "cylinder": f'type="cylinder" size="{HEIGHT} 0.012" euler="90 0 0"',
    "box": f'type="box" size="0.012 0.007 {HEIGHT}"',
}
FORCES = (1.0, 2.0, 4.0)  # newtons


def pad(size: int) -> np.ndarray:
    r"""The taxels of a square pad around the origin, in metres :math:`(N, 3)`."""
    pos = grid(size, size, PITCH).pos.double().numpy()
    return pos - pos.mean(axis=0)


def scene(shape: str, skin: str, assets: str = "", sensors: str = "") -> str:
    r"""The MJCF of a pad below a body that moves up and down."""
    option = '<option timestep="0.002" integrator="implicitfast" cone="elliptic" gravity="0 0 0"/>'
    start = (1.5 if shape == "sphere" else 1.0) * HEIGHT + 1e-4
    return f"""<mujoco>{option}<asset>{assets}</asset><worldbody>{skin}
    <body name="item" pos="0.0013 0.0007 {start}"><joint name="z" type="slide" axis="0 0 1"/>
    <geom name="item" {SHAPES[shape]} mass="{MASS}" condim="1" {softness()}/></body></worldbody>
    <sensor>{sensors}</sensor></mujoco>"""


def softness() -> str:
    return f'solref="{ContactParameters().skin_time} 1" solimp="{_SOLIMP}"'


def ours(shape: str, size: int) -> str:
    radius = ContactParameters().taxel_radius
    return scene(
        shape,
        "".join(
            f'<geom type="sphere" size="{radius}" pos="{x} {y} {-radius}" condim="1" {softness()}/>'
            for x, y, _ in pad(size)
        ),
    )


def theirs(shape: str, size: int) -> str:
    # A mesh is turned to its principal axes: the normal of this one is its x, and its y is
    # shorter than its z by less than a micrometre, so that nothing is turned.
    pos = pad(size) * (1.0, 1.0, 0.0)
    vertex = " ".join(f"0 {y:.9f} {-x * 1.00001:.9f}" for x, y, _ in pos)
    corner = [r * size + c for r in range(size - 1) for c in range(size - 1)]
    cells = [(i, i + 1, i + size, i + 1, i + size + 1, i + size) for i in corner]
    face = " ".join(str(i) for cell in cells for i in cell)
    half = (size + 1) * PITCH / 2
    return scene(
        shape,
        f'<geom type="box" size="{half} {half} 0.01" pos="0 0 -0.01" condim="1" {softness()}/>'
        '<geom name="place" type="box" size="1e-4 1e-4 1e-4" contype="0" conaffinity="0" '
        'quat="0.70710678 0 -0.70710678 0"/>',
        f'<mesh name="taxels" inertia="shell" vertex="{vertex}" face="{face}"/>',
        '<tactile geom="place" mesh="taxels"/>',
    )


def forces(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    r"""The normal force on each taxel in newtons, of our model."""
    out, six = np.zeros(model.ngeom - 1), np.zeros(6)
    for i, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, i, six)
        out[min(contact.geom)] += six[0]
    return out


def depths(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    r"""The depth of each taxel in metres, of MuJoCo's sensor."""
    return np.array(data.sensordata.reshape(3, -1)[0])


def pressed(
    text: str, force: float, read: Callable[[mujoco.MjModel, mujoco.MjData], np.ndarray]
) -> tuple[np.ndarray, float]:
    r"""Returns the reading at rest under a force, and the seconds of a step."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = -force
    steps = 1500
    start = time.perf_counter()
    for _ in range(steps):
        mujoco.mj_step(model, data)
    seconds = (time.perf_counter() - start) / steps
    return read(model, data), seconds


def main() -> None:
    options = parse(__doc__, {"--size": (9, "taxels along an edge of the pad")})
    print_setting("mujoco", "numpy")
    found = {}
    for shape in SHAPES:
        for force in FORCES:
            found[shape, force] = (
                pressed(ours(shape, options.size), force, forces),
                pressed(theirs(shape, options.size), force, depths),
            )
    totals = np.array([found["sphere", force][1][0].sum() for force in FORCES])
    stiffness = (totals @ np.array(FORCES)) / (totals @ totals)
    print(f"stiffness fitted on the sphere: {stiffness:.0f} N/m")
    print(
        "| press | force | touched, ours / MuJoCo | correlation | error, ours | MuJoCo | "
        "step, ours | MuJoCo |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for (shape, force), ((a, first), (b, second)) in found.items():
        errors = [100 * (total / force - 1) for total in (a.sum(), stiffness * b.sum())]
        print(
            f"| {shape} | {force:g} N | {(a > 0).sum()} / {(b > 0).sum()} | "
            f"{np.corrcoef(a, b)[0, 1]:.2f} | {errors[0]:+.1f} % | {errors[1]:+.0f} % | "
            f"{1e6 * first:.0f} µs | {1e6 * second:.0f} µs |"
        )


if __name__ == "__main__":
    main()
