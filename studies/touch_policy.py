r"""Does touch help a policy to lift unknown objects, and how much of the touch does it need?

Policies of :obj:`sim.GripperLift` are trained on noisy demonstrations of an expert that knows the
object, and judged by closed-loop success on the same 100 episodes, with objects from the held-out
corners of mass and friction and of held-out widths (docs/touch_policies.md, which was written
before the first training). The rows differ in their inputs alone: the network, its training and the
demonstrations of a seed are the same. `rule` rows are not trained: their one or two numbers are
those with the most successes on episodes with training objects.

Examples:
    PYTHONPATH=benchmarks python studies/touch_policy.py --out docs/results/touch_policies.json
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from joblib import Parallel, delayed
from shared import describe_machine, parse
from torch import Tensor, nn

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.experiments.differences import Difference
from torch_geometric_tactile.nn import TouchEncoder
from torch_geometric_tactile.sim import (
    LIFT_INPUTS,
    GripperLift,
    LiftObservation,
    PadSensor,
    draw_lift_object,
    lift_expert,
    lift_inputs,
    record_lift,
)
from torch_geometric_tactile.sim.gripper_lift import (
    CONTROL_RATE,
    MAX_LIFT_SPEED,
    MAX_LOG_CHANGE,
    MIN_SQUEEZE,
)

STEPS = 8  # of the inputs that a policy sees: 0.4 s
NUM_DEMONSTRATIONS, NUM_AGGREGATED, NOISE = 200, 200, 0.2
NUM_EPISODES, FIRST_EPISODE = 100, 1000
BATCH_SIZE, NUM_UPDATES, LEARNING_RATE = 128, 3000, 1e-3
ACTION_SCALE = np.array([MAX_LOG_CHANGE, MAX_LIFT_SPEED])
ROWS = (*LIFT_INPUTS, "encoder")
SENSORS = {"good": PadSensor(), "rough": PadSensor.rough(), "dead": PadSensor(dead=0.1)}
# Name of the condition: the sensor and the number of the demonstrations, and the rows.
CONDITIONS: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "clean": ("good", NUM_DEMONSTRATIONS, ROWS),
    "30 demonstrations": ("good", 30, ("wrench", "taxels", "encoder")),
    "rough sensor": ("rough", NUM_DEMONSTRATIONS, ("none", "wrench", "taxels", "encoder")),
}
# Further tests of the policies of "clean": the sensor, whether objects are narrow, and the rows.
TESTS: dict[str, tuple[str, bool, tuple[str, ...]]] = {
    "dead taxels": ("dead", False, ("wrench", "taxels", "encoder")),
    "narrow objects": ("good", True, ("wrench", "taxels", "encoder")),
}
# Differences that docs/touch_policies.md has a sentence for, whatever they are.
PAIRS = (
    *(("normal", "none"), ("total", "none"), ("wrench", "total"), ("taxels", "wrench")),
    *(("encoder", "taxels"), ("taxels", "none")),
)


class Policy(nn.Module):
    """Two hidden layers on the last steps of the inputs; touch may come as a token of an encoder."""

    def __init__(self, row: str, inputs: Tensor) -> None:
        super().__init__()
        self.encoder = None
        num_inputs = inputs.size(-1)
        if row == "encoder":
            self.encoder = TouchEncoder(GripperLift().layout, 64, in_channels=3)
            num_inputs -= 3 * self.encoder.num_taxels
        self.register_buffer("mean", inputs[..., :num_inputs].mean(dim=(0, 1)))
        self.register_buffer("scale", inputs[..., :num_inputs].std(dim=(0, 1)) + 1e-6)
        self.layers = nn.Sequential(
            nn.Linear(STEPS * num_inputs + (0 if self.encoder is None else 64), 256),
            *(nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 2)),
        )

    def forward(self, inputs: Tensor) -> Tensor:
        """Returns the scaled actions (B, 2) for inputs (B, STEPS, D)."""
        features = [((inputs[..., : len(self.mean)] - self.mean) / self.scale).flatten(1)]
        if self.encoder is not None:
            touch = inputs[..., len(self.mean) :]
            features.append(self.encoder(touch.unflatten(-1, (self.encoder.num_taxels, 3))))
        return self.layers(torch.cat(features, dim=1))


def inputs_of(row: str, observation: LiftObservation) -> np.ndarray:
    """Returns the inputs of a row at one step."""
    return lift_inputs(observation, "taxels" if row == "encoder" else row)


def windows(steps: np.ndarray) -> np.ndarray:
    """Returns the last steps (T, STEPS, D) at each step, the first one repeated before the start."""
    padded = np.concatenate([np.repeat(steps[:1], STEPS - 1, axis=0), steps])
    return np.lib.stride_tricks.sliding_window_view(padded, STEPS, axis=0).swapaxes(1, 2)


Episode = tuple[list[LiftObservation], np.ndarray]
Rule = Callable[[LiftObservation], float]  # the squeeze in newtons


@cache
def demonstrations(number: int, sensor: str) -> list[Episode]:
    """Returns the observations and the expert's actions of noisy demonstrations."""
    env, episodes = GripperLift(sensor=SENSORS[sensor]), []
    for seed in range(number):
        recording = record_lift(env, seed, noise=NOISE)
        motors = (
            recording.joint,
            *(recording.extra[k] for k in ("velocity", "command", "motor_force")),
        )
        columns = zip(recording.tactile, *motors, strict=True)
        episodes.append(([LiftObservation(*row) for row in columns], recording.action))
    return episodes


def train(row: str, episodes: Iterable[Episode], seed: int) -> Policy:
    """Returns a policy that imitates the actions."""
    episodes = list(episodes)
    steps = [np.stack([inputs_of(row, o) for o in observations]) for observations, _ in episodes]
    inputs = torch.from_numpy(np.concatenate([windows(s) for s in steps])).float()
    actions = torch.from_numpy(np.concatenate([a for _, a in episodes]) / ACTION_SCALE).float()
    torch.manual_seed(seed)
    policy = Policy(row, inputs)
    optimizer = torch.optim.AdamW(policy.parameters(), LEARNING_RATE, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, NUM_UPDATES)
    for _ in range(NUM_UPDATES):
        index = torch.randint(len(inputs), (BATCH_SIZE,))
        loss = nn.functional.mse_loss(policy(inputs[index]), actions[index])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return policy.eval()


class Runner:
    """Runs episodes side by side, so that a network decides about all of them at once."""

    def __init__(self, seeds: Iterable[int], sensor: str, held_out: bool, narrow: bool) -> None:
        self.envs, self.observations = [], []
        for seed in seeds:
            env = GripperLift(sensor=SENSORS[sensor])
            item = draw_lift_object(seed, held_out=held_out, narrow=narrow)
            self.observations.append(env.reset(seed, item))
            self.envs.append(env)

    @torch.no_grad()
    def run(self, row: str, policy: Policy, label: bool = False) -> tuple[list[str], list[Episode]]:
        """Returns the outcomes and, if asked, the observations with the expert's actions."""
        running = list(range(len(self.envs)))
        history = [[o] for o in self.observations]
        labels: list[list[np.ndarray]] = [[] for _ in self.envs]
        while running:
            steps = [np.stack([inputs_of(row, o) for o in history[i][-STEPS:]]) for i in running]
            inputs = np.stack([windows(s)[-1] for s in steps])
            actions = policy(torch.from_numpy(inputs).float()).double().numpy() * ACTION_SCALE
            still_running = []
            for i, action in zip(running, actions, strict=True):
                if label:
                    labels[i].append(lift_expert(self.envs[i]))
                observation, finished = self.envs[i].step(action)
                if not finished:
                    history[i].append(observation)
                    still_running.append(i)
            running = still_running
        outcomes = [env.outcome.label for env in self.envs]
        return outcomes, [(h, np.stack(a)) for h, a in zip(history, labels, strict=True) if label]


def run_seed(condition: str, row: str, seed: int) -> list[dict[str, Any]]:
    """Returns the outcomes of one row and seed: behaviour cloning, and one round of DAgger."""
    torch.set_num_threads(1)
    sensor, number, _ = CONDITIONS[condition]
    results = []

    def test(
        policy: Policy,
        name: str,
        column: str,
        sensor: str,
        held_out: bool = True,
        narrow: bool = False,
    ) -> None:
        seeds = range(FIRST_EPISODE, FIRST_EPISODE + NUM_EPISODES)
        outcomes, _ = Runner(seeds, sensor, held_out, narrow).run(row, policy)
        run = {"condition": name, "row": row, "column": column, "seed": seed}
        results.append({**run, "outcomes": outcomes})

    episodes = demonstrations(number, sensor)
    policy = train(row, episodes, seed)
    test(policy, condition, "cloning", sensor)
    if condition != "clean":
        return results
    for name, (test_sensor, narrow, rows) in TESTS.items():
        if row in rows:
            test(policy, name, "cloning", test_sensor, narrow=narrow)
    test(policy, "new objects", "cloning", sensor, held_out=False)
    seeds = range(NUM_DEMONSTRATIONS, NUM_DEMONSTRATIONS + NUM_AGGREGATED)
    _, more = Runner(seeds, sensor, held_out=False, narrow=False).run(row, policy, label=True)
    policy = train(row, [*episodes, *more], seed)
    test(policy, condition, "dagger", sensor)
    test(policy, "new objects", "dagger", sensor, held_out=False)
    return results


def run_rule(rule: Rule, seeds: Iterable[int], held_out: bool) -> list[str]:
    """Returns the outcomes of a rule for the squeeze, which lifts slowly in the first second."""
    env, outcomes = GripperLift(), []
    for seed in seeds:
        observation = env.reset(seed, draw_lift_object(seed, held_out=held_out))
        finished, speed, lifted = False, 0.0, 0
        while not finished:
            change = 0.0
            if env.is_touching:
                change = math.log(max(rule(observation), MIN_SQUEEZE) / env.command[0])
                is_ready = change < MAX_LOG_CHANGE
                lifted += is_ready
                limit = 0.003 if lifted < CONTROL_RATE else MAX_LIFT_SPEED
                speed = min(speed + 0.01, limit) if is_ready else 0.0
            observation, finished = env.step([change, speed])
        outcomes.append(env.outcome.label)
    return outcomes


def rules() -> dict[str, list[Rule]]:
    """Returns the rules of each input, with all candidate numbers."""

    def constant(force: float) -> Rule:
        return lambda observation: force

    def from_wrench(ratio: float, radius: float) -> Rule:
        def squeeze(observation: LiftObservation) -> float:
            pads = lift_inputs(observation, "wrench")[8:].reshape(2, 6)
            shear = np.hypot(pads[:, 0], pads[:, 1]).mean()
            twist = np.abs(pads[:, 5]).mean()
            return ratio * (shear + twist / radius) + 0.4

        return squeeze

    ratios = np.geomspace(1.2, 5, 8)
    return {
        "none": [constant(f) for f in np.geomspace(0.5, 12, 14)],
        "total": [from_wrench(r, math.inf) for r in ratios],
        "wrench": [from_wrench(r, radius) for r, radius in product(ratios, (0.004, 0.006, 0.009))],
    }


def best_rule(name: str) -> list[dict[str, Any]]:
    """Returns the outcomes of the rule with the most successes on the first 60 demonstrations."""

    def successes(rule: Rule) -> int:
        return run_rule(rule, range(60), held_out=False).count("success")

    best = max(rules()[name], key=successes)
    tests = range(FIRST_EPISODE, FIRST_EPISODE + NUM_EPISODES)
    outcomes = run_rule(best, tests, held_out=True)
    run = {"condition": "clean", "row": name, "column": "rule", "seed": 0}
    return [{**run, "outcomes": outcomes}]


def run_expert() -> list[dict[str, Any]]:
    """Returns the outcomes of the expert, which knows the object."""
    outcomes = []
    env = GripperLift()
    for seed in range(FIRST_EPISODE, FIRST_EPISODE + NUM_EPISODES):
        outcomes.append(record_lift(env, seed, draw_lift_object(seed, held_out=True)).label)
    return {
        "condition": "clean",
        "row": "expert",
        "column": "rule",
        "seed": 0,
        "outcomes": outcomes,
    }


def successes(results: list[dict[str, Any]], condition: str, row: str, column: str) -> np.ndarray:
    """Returns the successes (seeds, episodes) in percent."""
    runs = [
        r for r in results if (r["condition"], r["row"], r["column"]) == (condition, row, column)
    ]
    runs.sort(key=lambda run: run["seed"])
    return np.array([[100.0 * (o == "success") for o in run["outcomes"]] for run in runs])


def difference(first: np.ndarray, second: np.ndarray) -> Difference:
    """Returns the difference of two rows on the same episodes, by the rule for one test part."""
    gain = first - second
    return Difference(
        mean=float(gain.mean()),
        over_splits=math.nan,
        over_units=float(gain.mean(axis=0).std(ddof=1) / math.sqrt(gain.shape[1])),
        num_splits=1,
        num_units=gain.shape[1],
        unit="episode",
        has_one_test_part=True,
        over_seeds=float(gain.mean(axis=1).std(ddof=1) / math.sqrt(len(gain))),
        num_seeds=len(gain),
    )


def describe(values: np.ndarray) -> str:
    """Returns the mean of the seeds with its deviation."""
    means = values.mean(axis=1) if len(values) else values
    spread = f" ± {means.std(ddof=1):.1f}" if len(means) > 1 else ""
    return f"{means.mean():.1f}{spread}" if len(means) else ""


def failures(results: list[dict[str, Any]], condition: str, row: str) -> str:
    """Returns how cloned policies failed, in percent of the episodes."""
    key = (condition, row, "cloning")
    runs = [r for r in results if (r["condition"], r["row"], r["column"]) == key]
    counts = Counter(o for run in runs for o in run["outcomes"] if o != "success")
    share = 100 / max(1, len(runs) * NUM_EPISODES)
    return ", ".join(f"{name} {share * n:.0f} %" for name, n in counts.most_common())


def write_tables(results: list[dict[str, Any]]) -> str:
    """Returns the tables of success in Markdown."""
    lines = []
    rows_of = {name: rows for name, (*_, rows) in (CONDITIONS | TESTS).items()}
    for condition, rows in {**rows_of, "new objects": ROWS}.items():
        is_clean = condition == "clean"
        columns = ("cloning", "dagger", "rule") if is_clean else ("cloning", "dagger")
        lines += [
            f"\n**{condition}**\n",
            f"| input | {' | '.join(columns)} | failures of cloning |",
            "|---" * (len(columns) + 2) + "|",
        ]
        for row in (*rows, *(["expert"] if is_clean else [])):
            cells = [describe(successes(results, condition, row, column)) for column in columns]
            lines.append(f"| {row} | {' | '.join(cells)} | {failures(results, condition, row)} |")
        for column, (first, second) in product(columns[:2], PAIRS):
            pair = [successes(results, condition, row, column) for row in (first, second)]
            if len(pair[0]) > 1 and pair[0].shape == pair[1].shape:
                gain = difference(*pair)
                lines.append(
                    f"\n{column}, {first} - {second}: {gain.mean:+.1f} ± {gain.margin:.1f}, "
                    f"{gain.verdict}"
                )
    return "\n".join(lines)


def main() -> None:
    """Runs what the file does not have yet, and prints the tables."""
    arguments = parse(
        __doc__,
        {
            "--out": (Path("touch_policies.json"), "file of the runs"),
            "--seeds": (5, "seeds of a row"),
            "--jobs": (2, "runs at once"),
            "--conditions": ([*CONDITIONS], "conditions to run"),
        },
    )
    out = arguments.out
    results = json.loads(out.read_text())["results"] if out.is_file() else []
    done = {(r["condition"], r["row"], r["seed"]) for r in results}
    tasks = [
        (condition, row, seed)
        for condition in arguments.conditions
        for seed in range(1, arguments.seeds + 1)
        for row in CONDITIONS[condition][-1]
    ]
    calls = [delayed(run_seed)(*task) for task in tasks if task not in done]
    if not any(r["column"] == "rule" for r in results):
        calls += [delayed(best_rule)(name) for name in rules()]
        calls += [delayed(run_expert)()]
    for new in Parallel(arguments.jobs, return_as="generator_unordered")(calls):
        results += new
        content = {"machine": describe_machine(), "results": results}
        with atomic_path(out) as path:
            path.write_text(json.dumps(content), encoding="utf-8")
    print(write_tables(results))


if __name__ == "__main__":
    import touch_policy  # as a module, whose functions other processes find

    touch_policy.main()
