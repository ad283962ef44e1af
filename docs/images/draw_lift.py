"""Draws docs/images/gripper_lift.png: an episode of the gripper that lifts an unknown object.

MuJoCo draws without a screen with MUJOCO_GL=osmesa (or egl).

Examples:
    MUJOCO_GL=osmesa python docs/images/draw_lift.py docs/images/gripper_lift.png
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import matplotlib
import mujoco
import numpy as np

from torch_geometric_tactile.sim import GripperLift, LiftObject, lift_expert

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ITEM = LiftObject(mass=0.25, friction=0.5, offset=0.008)
WEIGHT = ITEM.mass * 9.81
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#8a97a6"


def scene(env: GripperLift, height: int, width: int) -> Callable[[], np.ndarray]:
    """Returns a function that draws the running episode."""
    renderer = mujoco.Renderer(env.model, height, width)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0, 0, 0.05
    camera.distance, camera.azimuth, camera.elevation = 0.2, 70, -12

    def draw() -> np.ndarray:
        renderer.update_scene(env.data, camera)
        return renderer.render().copy()

    return draw


def run_episode(seed: int) -> tuple[GripperLift, np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Returns the task, (time, squeeze, load, slide, tilt, height) of each step, the forces on the
    taxels and the pictures."""
    env = GripperLift()
    env.reset(seed, ITEM)
    draw = scene(env, 480, 400)
    rows, forces, images, finished = [], [], [], False
    while not finished:
        observation, finished = env.step(lift_expert(env))
        height = observation.position[1]
        rows.append((env.squeeze, env.load, 1e3 * env.slide, np.rad2deg(env.tilt), 1e3 * height))
        forces.append(env.taxel_force[:16])
        images.append(draw())
    numbers = np.column_stack([np.arange(1, len(rows) + 1) / 20, np.array(rows)])
    return env, numbers, forces, images


def draw_pad(axes: plt.Axes, force: np.ndarray, title: str) -> None:
    """Draws pressure as areas, and the ratio of shear to pressure relative to the friction as
    arrows."""
    column, row = np.meshgrid(np.arange(4), np.arange(4))
    pressure = force[:, 2].clip(min=1e-6)
    ratio = force[:, :2] / pressure[:, None] / ITEM.friction
    ratio[force[:, 2] < 0.01] = 0
    slips = np.linalg.norm(ratio, axis=1) > 0.95
    size = 900 * pressure / 0.45
    axes.scatter(column, row, s=size, color=[ORANGE if slip else BLUE for slip in slips], alpha=0.4)
    axes.quiver(column, row, *ratio.T, angles="xy", scale_units="xy", scale=1.3, width=0.012)
    axes.set(xlim=(-0.8, 3.8), ylim=(-1.2, 3.8), xticks=[], yticks=[], aspect="equal")
    axes.set_title(title, fontsize=9)


def draw_lines(axes: np.ndarray, env: GripperLift, numbers: np.ndarray) -> None:
    """Draws squeeze and need, load and weight, slide and tilt over time."""
    time, squeeze, load, slide, tilt, height = numbers.T
    axes[0].plot(time, squeeze, color=BLUE, label="squeeze")
    axes[0].axhline(env.need, color=GREEN, label="need")
    axes[0].axhline(1.6 * env.need + 0.5, color=ORANGE, ls="--", label="crushed above")
    axes[0].plot(time, env.need * load.clip(min=0) / WEIGHT, color=GREEN, ls=":", label="need now")
    axes[0].set_ylabel("N")
    axes[1].plot(time, load, color=BLUE, label="load")
    axes[1].axhline(WEIGHT, color=GREY, label="weight")
    axes[1].set_ylabel("N")
    height_axis = axes[1].twinx()
    height_axis.plot(time, height, color=ORANGE, label="height")
    height_axis.set_ylabel("height in mm")
    axes[2].plot(time, slide / 3, color=BLUE, label="slide / 3 mm")
    axes[2].plot(time, tilt / 10, color=ORANGE, label="tilt / 10°")
    axes[2].axhline(1, color=GREY, ls="--")
    for panel in axes:
        panel.set_xlabel("time in s")
        panel.legend(fontsize=7, loc="upper right" if panel is axes[2] else "lower right")


def main() -> None:
    """Draws the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    env, numbers, forces, images = run_episode(seed=1)
    carried = numbers[:, 2] / WEIGHT
    moments = [0, int(np.argmax(carried > 0.4)), int(np.argmax(carried > 0.99)), len(images) - 1]
    figure, axes = plt.subplots(3, 4, figsize=(10, 8), layout="constrained")
    for i, k in enumerate(moments):
        axes[0, i].imshow(images[k])
        axes[0, i].axis("off")
        axes[0, i].set_title(f"{numbers[k, 0]:.2f} s", fontsize=9)
        draw_pad(
            axes[1, i], forces[k], f"{max(0, round(100 * carried[k]))} % of the weight carried"
        )
    draw_lines(axes[2, :3], env, numbers)
    axes[2, 3].axis("off")
    note = (
        "Second row: the left pad.\nArea: pressure. Arrow: shear over\npressure and friction.\n"
        "Orange: a taxel that slips."
    )
    axes[2, 3].text(0, 0.5, note, fontsize=9)
    figure.savefig(out, dpi=80)
    print(env.outcome)


if __name__ == "__main__":
    main()
