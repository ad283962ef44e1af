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
    lift_observations,
    record_lift,
)
from torch_geometric_tactile.sim.gripper_lift import (
    CONTROL_RATE,
    MAX_LIFT_SPEED,
    MAX_LOG_CHANGE,
    MIN_SQUEEZE,
)

STEPS = 8  # of the inputs that a policy sees: 0.4 s
NUM_DEMONSTRATIONS, NUM_AGGREGATED, NOISE = 200, 200, 0.4
TEST_EPISODES = range(1000, 1100)
BATCH_SIZE, NUM_UPDATES, LEARNING_RATE = 128, 3000, 1e-3
ACTION_SCALE = np.array([MAX_LOG_CHANGE, MAX_LIFT_SPEED])
ROWS = (*LIFT_INPUTS, "encoder")
SENSORS = {
    "good": PadSensor(),
    "5 mN": PadSensor(gain_spread=0.08, offset=0.005),
    "10 mN": PadSensor(gain_spread=0.11, offset=0.01),
    "rough": PadSensor.rough(),
    "dead": PadSensor(dead=0.1),
}
# Name of the condition: the sensor and the number of the demonstrations, and the rows.
CONDITIONS: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "clean": ("good", NUM_DEMONSTRATIONS, ROWS),
    "30 demonstrations": ("good", 30, ("wrench", "taxels", "encoder")),
    "8 % gains, 5 mN offsets": ("5 mN", NUM_DEMONSTRATIONS, ("wrench", "taxels")),
    "11 % gains, 10 mN offsets": ("10 mN", NUM_DEMONSTRATIONS, ("wrench", "taxels")),
    "rough sensor": ("rough", NUM_DEMONSTRATIONS, ("none", "wrench", "taxels", "encoder")),
}
# Further tests of the policies of "clean": the sensor, whether objects are narrow, and the rows.
TESTS: dict[str, tuple[str, bool, tuple[str, ...]]] = {
    "dead taxels": ("dead", False, ("wrench", "taxels", "encoder")),
    "narrow objects": ("good", True, ("wrench", "taxels", "encoder")),
}
# Differences that docs/touch_policies.md has a sentence for, whatever they are.
PAIRS = (
    *(("none", "constant"), ("normal", "none"), ("total", "none"), ("wrench", "total")),
    *(("taxels", "wrench"), ("encoder", "taxels"), ("taxels", "none")),
    *(("ACT with touch", "none"), ("ACT with touch", "ACT")),
)


class Policy(nn.Module):
    """Two hidden layers on the last steps of the inputs; touch may be a token of an encoder."""

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
    return lift_inputs(observation, row if row in LIFT_INPUTS else "taxels")


def windows(steps: np.ndarray) -> np.ndarray:
    """Returns the last steps (T, STEPS, D) at each step; before the start, the first is repeated."""
    padded = np.concatenate([np.repeat(steps[:1], STEPS - 1, axis=0), steps])
    return np.lib.stride_tricks.sliding_window_view(padded, STEPS, axis=0).swapaxes(1, 2)


Episode = tuple[list[LiftObservation], np.ndarray]
Rule = Callable[[list[LiftObservation]], float]  # the squeeze in newtons after all steps


@cache
def demonstrations(number: int, sensor: str) -> list[Episode]:
    """Returns the observations and the expert's actions of noisy demonstrations."""
    env, episodes = GripperLift(sensor=SENSORS[sensor]), []
    for seed in range(number):
        recording = record_lift(env, seed, noise=NOISE)
        episodes.append((lift_observations(recording), recording.action))
    return episodes


def train(row: str, episodes: list[Episode], seed: int) -> nn.Module:
    """Returns a policy that imitates the actions."""
    inputs = inputs_table(row, episodes)
    actions = torch.from_numpy(np.concatenate([a for _, a in episodes]) / ACTION_SCALE).float()
    torch.manual_seed(seed)
    policy = Policy(row, inputs)

    def loss(index: Tensor) -> Tensor:
        return nn.functional.mse_loss(policy(inputs[index]), actions[index])

    return fit(policy, loss, len(inputs), LEARNING_RATE)


def inputs_table(row: str, episodes: list[Episode]) -> Tensor:
    """Returns the inputs (S, STEPS, D) of all steps of episodes."""
    steps = [np.stack([inputs_of(row, o) for o in observations]) for observations, _ in episodes]
    return torch.from_numpy(np.concatenate([windows(s) for s in steps])).float()


def fit(
    policy: nn.Module, loss: Callable[[Tensor], Tensor], num_steps: int, rate: float
) -> nn.Module:
    """Trains a policy by the loss of random steps, and returns it."""
    optimizer = torch.optim.AdamW(policy.parameters(), rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, NUM_UPDATES)
    for _ in range(NUM_UPDATES):
        optimizer.zero_grad()
        loss(torch.randint(num_steps, (BATCH_SIZE,))).backward()
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
    def run(
        self, row: str, policy: nn.Module, label: bool = False
    ) -> tuple[list[str], list[Episode]]:
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


def run_seed(
    condition: str,
    row: str,
    seed: int,
    train: Callable[[str, list[Episode], int], nn.Module] = train,
) -> list[dict[str, Any]]:
    """Returns the outcomes of one row and seed: behaviour cloning, and one round of DAgger."""
    torch.set_num_threads(1)
    sensor, number, _ = CONDITIONS[condition]
    results = []

    def test(
        policy: nn.Module,
        name: str,
        column: str,
        sensor: str,
        held_out: bool = True,
        narrow: bool = False,
    ) -> None:
        outcomes, _ = Runner(TEST_EPISODES, sensor, held_out, narrow).run(row, policy)
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
        history = [env.reset(seed, draw_lift_object(seed, held_out=held_out))]
        finished, speed, lifted = False, 0.0, 0
        while not finished:
            change = 0.0
            if env.is_touching:
                change = math.log(max(rule(history), MIN_SQUEEZE) / env.command[0])
                is_ready = change < MAX_LOG_CHANGE
                lifted += is_ready
                limit = 0.003 if lifted < CONTROL_RATE else MAX_LIFT_SPEED
                speed = min(speed + 0.01, limit) if is_ready else 0.0
            observation, finished = env.step([change, speed])
            history.append(observation)
        outcomes.append(env.outcome.label)
    return outcomes


def from_motors(ratio: float, least: float) -> Rule:
    """Returns a rule that squeezes in proportion to what the lift motor carries."""

    def squeeze(history: list[LiftObservation]) -> float:
        force = [o.force[1] for o in history]
        return ratio * max(0.0, np.mean(force[-4:]) - np.mean(force[:4])) + least

    return squeeze


def from_wrench(ratio: float, radius: float) -> Rule:
    """Returns a rule that squeezes in proportion to the load that the pads feel."""
    return lambda history: ratio * felt_load(history[-1], radius) + 0.4


def from_taxels(ratio: float, part: float) -> Rule:
    """Returns a rule that also divides by the friction. On taxels that slip, it is the ratio of
    shear to pressure: the quantile `part` of the ratios, the largest one so far."""

    def squeeze(history: list[LiftObservation]) -> float:
        frictions = [0.05]
        for observation in history:
            shear, pressure = np.hypot(*observation.readings.T[:2]), observation.readings[:, 2]
            if (pressure > 0.05).sum() > 4:
                felt = shear[pressure > 0.05] / pressure[pressure > 0.05]
                frictions.append(float(np.quantile(felt, part)))
        return ratio * felt_load(history[-1], 0.006) / max(frictions) + 0.4

    return squeeze


def felt_load(observation: LiftObservation, radius: float) -> float:
    """Returns the load of a pad in newtons: its shear, and its torque as a force at a radius."""
    pads = lift_inputs(observation, "wrench")[8:].reshape(2, 6)
    shear, twist = np.hypot(pads[:, 0], pads[:, 1]).mean(), np.abs(pads[:, 5]).mean()
    return float(np.hypot(shear, twist / radius))


def rules() -> dict[str, dict[str, Rule]]:
    """Returns the rules of each input, with all candidate numbers. Pressure alone allows no better
    one than the motors."""
    constants, ratios = np.geomspace(0.5, 12, 14).round(2), np.geomspace(1.2, 5, 8).round(2)
    factors, times = np.geomspace(0.8, 2.4, 7).round(2), (0.0, 0.5, 1.0, 1.5, 2.0)
    radii, parts = (0.004, 0.006, 0.009), (0.6, 0.75, 0.9)
    return {
        "constant": {f"{n} N": from_motors(0.0, n) for n in constants},
        "none": {
            f"{r} times the lift force and {n} N": from_motors(r, n)
            for r, n in product(times, constants[:10])
        },
        "total": {f"{r} times the load and 0.4 N": from_wrench(r, math.inf) for r in ratios},
        "wrench": {
            f"{r} times the load, radius {n} m, and 0.4 N": from_wrench(r, n)
            for r, n in product(ratios, radii)
        },
        "taxels": {
            f"{r} times the load over the friction, quantile {n}, and 0.4 N": from_taxels(r, n)
            for r, n in product(factors, parts)
        },
    }


def best_rule(name: str) -> list[dict[str, Any]]:
    """Returns the outcomes of the rule with the most successes on the first 60 demonstrations."""
    candidates = rules()[name]

    def successes(numbers: str) -> int:
        return run_rule(candidates[numbers], range(60), held_out=False).count("success")

    best = max(candidates, key=successes)
    return [
        {
            "condition": "clean" if held_out else "new objects",
            "row": name,
            "column": "rule",
            "seed": 0,
            "rule": best,
            "outcomes": run_rule(candidates[best], TEST_EPISODES, held_out),
        }
        for held_out in (True, False)
    ]


def run_expert() -> list[dict[str, Any]]:
    """Returns the outcomes of the expert, which knows the object."""
    env, results = GripperLift(), []
    for held_out in (True, False):
        items = [draw_lift_object(seed, held_out=held_out) for seed in TEST_EPISODES]
        pairs = zip(TEST_EPISODES, items, strict=True)
        outcomes = [record_lift(env, seed, item).label for seed, item in pairs]
        condition = "clean" if held_out else "new objects"
        run = {"condition": condition, "row": "expert", "column": "rule", "seed": 0}
        results.append({**run, "outcomes": outcomes})
    return results


Run = tuple[str, str, str]  # condition, row and column


def outcomes_of(results: list[dict[str, Any]], run: Run) -> np.ndarray:
    """Returns the outcomes (seeds, episodes) of a run."""
    runs = [r for r in results if (r["condition"], r["row"], r["column"]) == run]
    return np.array([r["outcomes"] for r in sorted(runs, key=lambda r: r["seed"])])


def difference(results: list[dict[str, Any]], first: Run, second: Run) -> str:
    """Returns the difference of two runs on the same episodes, by the rule for one test part. A
    rule or the expert has no seeds."""
    pair = [100.0 * (outcomes_of(results, run) == "success") for run in (first, second)]
    if not all(len(values) for values in pair) or max(len(values) for values in pair) < 2:
        return ""
    gain = pair[0] - pair[1]
    found = Difference(
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
    names = [f"{row}, {column}, {condition}" for condition, row, column in (first, second)]
    return f"| {names[0]} | {names[1]} | {found.mean:+.1f} ± {found.margin:.1f} | {found.verdict} |"


def describe(outcomes: np.ndarray) -> str:
    """Returns the successes in percent, with the deviation over seeds."""
    means = 100.0 * (outcomes == "success").mean(axis=1) if len(outcomes) else outcomes
    spread = f" ± {means.std(ddof=1):.1f}" if len(means) > 1 else ""
    return f"{means.mean():.1f}{spread}" if len(means) else ""


def describe_failures(outcomes: np.ndarray) -> str:
    """Returns how policies failed, in percent of the episodes."""
    counts = Counter(outcomes.ravel().tolist())
    del counts["success"]
    return ", ".join(f"{name} {100 * n / outcomes.size:.0f} %" for name, n in counts.most_common())


def write_tables(results: list[dict[str, Any]]) -> str:
    """Returns the tables of success and of differences in Markdown."""
    runs = list(dict.fromkeys((r["condition"], r["row"], r["column"]) for r in results))
    order = ["constant", *ROWS, "ACT", "ACT with touch", "expert"]
    runs.sort(key=lambda run: (run[0], order.index(run[1])))
    lines = []
    for condition in dict.fromkeys(run[0] for run in runs):
        columns = [
            c for c in ("cloning", "dagger", "rule") if any(r[::2] == (condition, c) for r in runs)
        ]
        head = f"| input | {' | '.join(columns)} | failures of {columns[0]} |"
        lines += [f"\n**{condition}**\n", head, "|---" * (len(columns) + 2) + "|"]
        for row in dict.fromkeys(run[1] for run in runs if run[0] == condition):
            found = [outcomes_of(results, (condition, row, column)) for column in columns]
            cells = [describe(outcomes) for outcomes in found]
            lines.append(f"| {row} | {' | '.join(cells)} | {describe_failures(found[0])} |")
    pairs = [
        (
            (condition, first, column),
            (condition, second, "rule" if second == "constant" else column),
        )
        for condition, column in dict.fromkeys(run[::2] for run in runs if run[2] != "rule")
        for first, second in PAIRS
    ]
    for condition, row, column in runs:
        policy = (condition, row, column)
        if column == "dagger":
            pairs.append((policy, (condition, row, "cloning")))
        if condition not in ("clean", "new objects"):
            pairs.append((policy, ("clean", row, "cloning")))
        elif column != "rule":
            pairs += [(policy, (condition, row, "rule")), (policy, (condition, "expert", "rule"))]
    lines += ["\n| first | second | difference | verdict |", "|---|---|---:|---|"]
    return "\n".join([*lines, *filter(None, (difference(results, *pair) for pair in pairs))])


def main() -> None:
    """Runs what the file does not have yet, and prints the tables."""
    arguments = parse(
        __doc__,
        {
            "--out": (Path("touch_policies.json"), "file of the runs"),
            "--seeds": (5, "seeds of a row"),
            "--jobs": (2, "runs at once"),
            "--conditions": ([*CONDITIONS, "rules"], "conditions to run"),
        },
    )
    results = read(arguments.out)
    tasks = [
        (condition, row, seed)
        for condition in arguments.conditions
        if condition != "rules"
        for seed in range(1, arguments.seeds + 1)
        for row in CONDITIONS[condition][-1]
    ]
    done = {(r["condition"], r["row"], r["seed"]) for r in results}
    calls = [delayed(run_seed)(*task) for task in tasks if task not in done]
    if "rules" in arguments.conditions:
        names = [name for name in rules() if ("clean", name, 0) not in done]
        calls += [delayed(best_rule)(name) for name in names]
        calls += [delayed(run_expert)()] * (("clean", "expert", 0) not in done)
    run(arguments.out, arguments.jobs, calls)


def read(path: Path) -> list[dict[str, Any]]:
    """Returns the results of a file, none if there is no file."""
    return json.loads(path.read_text())["results"] if path.is_file() else []


def run(out: Path, jobs: int, calls: list[Any]) -> None:
    """Runs what is missing, adds the results to a file, and prints the tables."""
    for new in Parallel(jobs, return_as="generator_unordered")(calls):
        content = {"machine": describe_machine(), "results": read(out) + new}
        with atomic_path(out) as path:
            path.write_text(json.dumps(content), encoding="utf-8")
    print(write_tables(read(out)))


if __name__ == "__main__":
    import touch_policy  # as a module, whose functions other processes find

    touch_policy.main()
