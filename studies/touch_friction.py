r"""Where in the readings is the friction of an object? The mechanism behind docs/touch_policies.md.

Objects of training and held-out kinds are squeezed by a constant force, drawn anew for each episode,
and lifted slowly. Friction is estimated from the readings at each step after the lift began, by extra
trees in five folds over episodes, from three inputs: the ratios of shear to pressure of the taxels,
those of the sums of each pad, and both sums with the torque. Writes a picture and prints R².

Examples:
    PYTHONPATH=benchmarks python studies/touch_friction.py --picture docs/images/touch_friction.png
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from shared import parse
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.metrics import r2_score
from sklearn.model_selection import KFold, cross_val_predict

from torch_geometric_tactile.sim import GripperLift, draw_lift_object, lift_inputs

MAX_SQUEEZE, SPEED, STEPS = (1.0, 10.0), 0.003, 16
INPUTS = ("taxels", "wrench", "total")


def ratios(observation, name: str) -> np.ndarray:
    """Returns ratios of shear to pressure of one step."""
    if name == "taxels":
        readings = observation.readings
        shear = np.hypot(readings[:, 0], readings[:, 1])
        ratio = np.where(readings[:, 2] > 0.02, shear / readings[:, 2].clip(0.02), 0.0)
        return np.concatenate([ratio, np.sort(ratio)])
    numbers = lift_inputs(observation, name)[8:].reshape(2, -1)
    pressure = np.abs(numbers[:, 2:3]).clip(0.02)
    return np.concatenate([numbers / pressure, pressure], axis=1).ravel()


def record(num_episodes: int) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Returns the inputs by name (S, steps, D), the friction (S,) and the part of the weight that
    the pads carry (S, steps)."""
    env, draw = GripperLift(), np.random.default_rng(0)
    rows: dict[str, list] = {name: [] for name in INPUTS}
    friction, carried = [], []
    for seed in range(num_episodes):
        squeeze = float(np.exp(draw.uniform(*np.log(MAX_SQUEEZE))))
        observation = env.reset(2_000_000 + seed, draw_lift_object(seed, held_out=bool(seed % 2)))
        finished, steps, loads = False, [], []
        while not finished and len(steps) < STEPS:
            change = np.log(squeeze / env.command[0]) if env.is_touching else 0.0
            is_ready = env.is_touching and abs(change) < 0.01
            observation, finished = env.step([change, SPEED * is_ready])
            if is_ready:
                steps.append(observation)
                loads.append(env.load / (env.item.mass * 9.81))
        if len(steps) == STEPS:
            friction.append(env.item.friction)
            carried.append(loads)
            for name in INPUTS:
                rows[name].append([ratios(step, name) for step in steps])
    return {k: np.array(v) for k, v in rows.items()}, np.array(friction), np.array(carried)


def main() -> None:
    """Prints R² by step, and draws it."""
    options = {
        "--picture": (Path("touch_friction.png"), "file of the picture"),
        "--episodes": (600, "episodes"),
    }
    arguments = parse(__doc__, options)
    inputs, friction, carried = record(arguments.episodes)
    folds = KFold(5, shuffle=True, random_state=0)
    print(f"{len(friction)} episodes that held for {STEPS} steps")
    scores: dict[str, list[float]] = {name: [] for name in INPUTS}
    for step in range(STEPS):
        for name in INPUTS:
            model = ExtraTreesRegressor(200, min_samples_leaf=2, random_state=0, n_jobs=1)
            guess = cross_val_predict(model, inputs[name][:, step], friction, cv=folds)
            scores[name].append(r2_score(friction, guess))
    figure = Figure(figsize=(6, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    labels = {"taxels": "ratios of the taxels", "wrench": "force and torque of each pad"}
    labels["total"] = "force of each pad"
    time = 0.05 * np.arange(STEPS)
    for name in INPUTS:
        axes.plot(time, scores[name], marker="o", markersize=3, label=labels[name])
        print(name, " ".join(f"{score:.2f}" for score in scores[name]))
    axes.plot(time, carried.mean(axis=0), color="0.6", linestyle="--", label="part of the weight")
    print("part of the weight", " ".join(f"{part:.2f}" for part in carried.mean(axis=0)))
    axes.set(xlabel="time since the lift began in s", ylabel="R² of the friction", ylim=(-0.1, 1))
    axes.legend(loc="lower right", fontsize=8)
    figure.savefig(arguments.picture, dpi=150)


if __name__ == "__main__":
    main()
