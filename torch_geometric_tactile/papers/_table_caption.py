r"""What a table of ours is made of."""

from collections.abc import Sequence
from typing import Any

from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.plan import Plan, PlanRun
from torch_geometric_tactile.experiments.source import DataSource

NOTHING = "\N{EN DASH}"


def caption(run: PlanRun) -> str:
    r"""Returns what a table is made of: source, protocols, seeds, epochs, samples and hardware."""
    plan, results = run.plan, [result for _, result in run.results]
    table = plan.table
    seeds = "0" if plan.seeds == 1 else f"0 to {plan.seeds - 1}"
    over = "folds" if plan.seeds == 1 and any(e.fold for e in plan.experiments) else "seeds"
    parts = []
    if table.is_published:
        parts.append(
            f"Published: {table.place} of *{table.paper}*, measured on a {table.measured_on}; its "
            f"recordings are {table.recordings}."
        )
    parts += [
        f"Our results have separate lines: {plan.data.caption}" if parts else plan.data.caption,
        f"Seed{'' if plan.seeds == 1 else 's'} {seeds} of split and training; mean ± standard "
        f"deviation over the {over}.",
        _protocols(plan),
        f"{_parts(plan)}{_training(plan)}",
        _samples(run),
        f"Hardware: {'; '.join(sorted({result['machine'] for result in results})) or 'none yet'}.",
    ]
    versions = {pair for e, _ in run.results for pair in e.identity()["versions"].items()}
    if versions:
        parts.append(", ".join(f"{name} {version}" for name, version in sorted(versions)) + ".")
    if run.missing:
        total = run.missing + len(results)
        parts.append(
            f"**{run.missing} of {total} runs are missing** ({NOTHING} where all are, and in "
            "brackets the number of seeds where some are)."
        )
    return " ".join(part for part in parts if part)


def _protocols(plan: Plan) -> str:
    notes = [
        f"*{entry.name if i else _capital(entry.name)}* {entry.note}"
        for i, entry in enumerate(entry for entry in plan.protocols if entry.note)
    ]
    if not notes:
        return ""
    said = "; ".join(notes) + "."
    if plan.table.paper_protocol:
        return f"{said} The paper used *{plan.table.paper_protocol}*."
    is_unsaid = plan.table.is_published and sum(bool(p.note) for p in plan.table.protocols) > 1
    return f"{said} The paper does not say which it used." if is_unsaid else said


def _parts(plan: Plan) -> str:
    # How much is held out: fractions in one sentence if they are the same, else each protocol.
    fractions = {(entry.protocol.val, entry.protocol.test) for entry in plan.protocols}
    if len(fractions) == 1 and plan.protocols[0].protocol.test is not None:
        ((val, test),) = fractions
        assert val is not None
        assert test is not None
        shown = [f"{100 * part:.0f} %" for part in (1 - val - test, val, test)]
        unused = f", {shown[1]} unused (for validation)" if val else ""
        return f"{shown[0]} to train{unused}, {shown[2]} to test, once, "
    held_out = "; ".join(
        f"{entry.name}: {entry.protocol.describe()}"
        + (", pooled before they are scored" if entry.protocol.folds else "")
        for entry in plan.protocols
    )
    return f"Held out: {held_out}. Tested once, "


def _training(plan: Plan) -> str:
    networks = [e for e in map(plan.cell_experiment, plan.table.cells) if not e.is_estimator]
    if not networks:
        return "after the training (nothing was chosen by the test part)."
    recipes = dict.fromkeys((_optimizer(e), e.epochs, e.batch_size) for e in networks)
    learnt = dict.fromkeys(how for how, _, _ in recipes)
    if len(learnt) > 1:  # each model has its own
        told = " or ".join(f"{_epochs([n])} ({how}, batches of {b})" for how, n, b in recipes)
        return f"after {told}; nothing was chosen by the test part."
    sizes = " or ".join(map(str, sorted({b for _, _, b in recipes})))
    return (
        f"after {_epochs([n for _, n, _ in recipes])} ({next(iter(learnt))}, batches of {sizes}; "
        "nothing was chosen by the test part)."
    )


def _epochs(numbers: Sequence[int]) -> str:
    text = " or ".join(map(str, sorted(set(numbers))))
    return f"{text} epoch{'' if text == '1' else 's'}"


def _optimizer(experiment: Experiment) -> str:
    config, rate = experiment.model.get("optimizer"), None
    name = config if isinstance(config, str) else "Adam"
    if isinstance(config, dict) and "class_path" in config:
        name, rate = config["class_path"], (config.get("init_args") or {}).get("lr")
    return _last(name) + ("" if rate is None else f", learning rate {rate:g}")


def _last(class_path: str) -> str:
    return class_path.rpartition(".")[2]


def _samples(run: PlanRun) -> str:
    # The samples of the table, and those of models and protocols with other ones.
    plan, facts = run.plan, run.plan.facts
    noun = "frame" if 0 < facts.num_trials < facts.num_samples else "sample"
    of_table = _selected(plan.data, noun)
    selected = {(e.name, e.protocol_name): _selected(e.data, noun) for e in plan.experiments}
    sentences = []
    for text in dict.fromkeys([of_table, *selected.values()]):
        if text not in selected.values():
            continue
        counts = []
        for name in (protocol.name for protocol in plan.protocols):
            mine = [
                result
                for e, result in run.results
                if e.protocol_name == name and _selected(e.data, noun) == text
            ]
            if mine:
                train, test = (_range([r[key] for r in mine]) for key in ("num_train", "num_test"))
                where = name if name.startswith("by ") else f"({name})"
                counts.append(f"{train} to train and {test} to test {where}")
        if text == of_table:
            sentences.append("; ".join([f"{text}: {facts.num_samples:,} in all", *counts]))
        else:
            names = dict.fromkeys(name for (name, _), told in selected.items() if told == text)
            listed = "" if len(names) == len(plan.table.cells) else f" for {', '.join(names)}"
            told = f": {'; '.join(counts)}" if counts else ""
            sentences.append(f"{text}{listed}{told}")
    return f"{'. '.join(sentences)}.{_rest(plan.data.arguments.get('tare'))}"


def _selected(source: DataSource, noun: str) -> str:
    # Which samples a source has: by its arguments, or by those of the frames that it shows.
    given: dict[str, Any] = {}
    shown: DataSource | None = source
    while shown is not None:
        given = {**shown.arguments, **given}
        shown = shown.frames
    given |= source.selection
    stride, phases = given.get("stride") or 1, given.get("phases")
    every = f"Every {noun}" if stride == 1 else f"Every {_ordinal(stride)} {noun}"
    rate, drawn = given.get("rate"), given.get("samples_per_trial")
    if rate is not None:
        every += f" at {rate:g} Hz"
    if drawn is not None:
        every = f"{drawn} of each trial, drawn from {every[0].lower()}{every[1:]}"
    return every if phases is None else f"{every} of the phases {', '.join(phases)}"


def _ordinal(number: int) -> str:
    last = 0 if number // 10 % 10 == 1 else number % 10  # 11th
    suffixes = ("th", "st", "nd", "rd")
    return f"{number}{suffixes[last] if last < len(suffixes) else 'th'}"


def _rest(tare: float | str | None) -> str:
    if tare is None:
        return ""
    if tare == "baseline":  # one recording for all trials, or so a phase is called
        return " The mean of the baseline readings is subtracted."
    rest = f"in the phase {tare}" if isinstance(tare, str) else f"in its first {tare:g} s"
    return f" The mean of each trial's readings {rest} is subtracted."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def cost_note(plan: Plan) -> str:
    r"""Returns how the costs of a model were measured."""
    note = (
        "Means over all runs. Frames/s: training frames of all epochs divided by the seconds of "
        "the training loop, which include the transforms and other work on the machine."
    )
    if not plan.table.measure_memory:
        return note
    return (
        f"{note} Peak memory: growth, in a separate process, from before the model is built "
        "(recordings loaded, scaling fitted) to the highest point of training: parameters, "
        "gradients, the optimizer's state, activations and a batch."
    )
