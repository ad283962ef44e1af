"""Draws docs/images/touch_policies.gif: two policies lift one object, without and with touch.

Both are rows of studies/touch_policy.py, trained here once more with seed 1. The object is that of
the first test episode on which they end differently. MuJoCo draws without a screen with
MUJOCO_GL=egl (or osmesa).

Examples:
    export MUJOCO_GL=egl PYTHONPATH=benchmarks:studies
    python docs/images/draw_lift_film.py docs/images/touch_policies.gif
"""

import argparse
from pathlib import Path

import matplotlib
import numpy as np
import torch
from draw_lift import BLUE, GREEN, GREY, ORANGE, scene
from PIL import Image
from touch_policy import (
    ACTION_SCALE,
    NUM_DEMONSTRATIONS,
    STEPS,
    TEST_EPISODES,
    demonstrations,
    inputs_of,
    train,
    windows,
)

from torch_geometric_tactile.sim import GripperLift, draw_lift_object

matplotlib.use("Agg")
import matplotlib.pyplot as plt

TITLES = {"none": "motors only", "taxels": "motors and touch"}
FRAME_MS, LAST_MS = 100, 2500


@torch.no_grad()
def run_episode(row: str, policy: torch.nn.Module, seed: int) -> tuple[GripperLift, list]:
    """Returns the finished task, and the picture, the squeeze and the outcome at each step, which
    is empty before the end."""
    env, steps, finished = GripperLift(), [], False
    history = [env.reset(seed, draw_lift_object(seed, held_out=True))]
    draw = scene(env, 360, 360)
    while not finished:
        inputs = windows(np.stack([inputs_of(row, o) for o in history[-STEPS:]]))[-1:]
        action = policy(torch.from_numpy(inputs.copy()).float())[0].double().numpy() * ACTION_SCALE
        observation, finished = env.step(action)
        history.append(observation)
        steps.append((draw(), env.squeeze, env.outcome.label if finished else ""))
    return env, steps


def draw_frame(episodes: dict[str, list], step: int, need: float) -> Image.Image:
    """Returns the picture of a step: scenes above, squeeze and need below."""
    figure, axes = plt.subplots(
        2, 2, figsize=(6, 4.6), height_ratios=(2, 1), layout="constrained", sharey="row"
    )
    length = max(len(rows) for rows in episodes.values())
    top = 1.3 * max(1.6 * need + 0.5, *(row[1] for rows in episodes.values() for row in rows))
    for column, (row, rows) in enumerate(episodes.items()):
        image, _, label = rows[min(step, len(rows) - 1)]
        scene, lines = axes[:, column]
        scene.imshow(image)
        scene.axis("off")
        scene.set_title(TITLES[row], fontsize=11)
        color = GREEN if label == "success" else ORANGE
        scene.text(
            0.5,
            0.02,
            label,
            color=color,
            fontsize=14,
            ha="center",
            weight="bold",
            transform=scene.transAxes,
        )
        seen = [squeeze for _, squeeze, _ in rows[: step + 1]]
        lines.axhspan(need, 1.6 * need + 0.5, color=GREEN, alpha=0.2, label="holds, not crushed")
        lines.axhline(need, color=GREY, lw=1)
        lines.plot(np.arange(1, len(seen) + 1) / 20, seen, color=BLUE)
        lines.set(xlim=(0, length / 20), ylim=(0, top), xlabel="time in s")
    axes[1, 0].set_ylabel("squeeze in N")
    axes[1, 0].legend(loc="upper left", fontsize=8, frameon=False)
    figure.canvas.draw()
    image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])
    plt.close(figure)
    return image


def main() -> None:
    """Draws the film."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    torch.set_num_threads(1)
    policies = {row: train(row, demonstrations(NUM_DEMONSTRATIONS, "good"), 1) for row in TITLES}
    for seed in TEST_EPISODES:
        runs = {row: run_episode(row, policy, seed) for row, policy in policies.items()}
        if len({env.outcome.label for env, _ in runs.values()}) > 1:
            break
    env, _ = runs["none"]
    episodes = {row: steps for row, (_, steps) in runs.items()}
    last = max(len(steps) for steps in episodes.values()) - 1
    frames = [draw_frame(episodes, step, env.need) for step in (*range(0, last, 2), last)]
    palette = frames[-1].quantize(128)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    small[0].save(out, save_all=True, append_images=small[1:], duration=durations, loop=0)
    print(seed, env.item, {row: env.outcome.label for row, (env, _) in runs.items()})


if __name__ == "__main__":
    main()
