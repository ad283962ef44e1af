r"""The caption of a table: data, protocols, training and hardware."""

from collections.abc import Sequence
from typing import Any

from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.plan import Plan, PlanRun
from torch_geometric_tactile.experiments.source import DataSource

NO_NUMBER = "\N{EN DASH}"  # shown in cells without a number
_NO_SELECTION = "The test part was not used for any selection."


def caption(run: PlanRun) -> str:
    r"""Returns the caption: data source, protocols, seeds, epochs, samples and hardware."""
    plan, results = run.plan, [result for _, result in run.results]
    table = plan.table
    seeds = "0" if plan.seeds == 1 else f"0 to {plan.seeds - 1}"
    averaged_over = (
        "folds"
        if plan.seeds == 1 and any(experiment.fold for experiment in plan.experiments)
        else "seeds"
    )
    sentences = []
    if table.is_published:
        sentences.append(
            f"Published: {table.place} of *{table.paper}*, measured on a {table.measured_on}; its "
            f"recordings are {table.recordings}."
        )
    sentences += [
        f"Our results are on separate lines: {plan.data.caption}"
        if sentences
        else plan.data.caption,
        f"Seed{'' if plan.seeds == 1 else 's'} {seeds} of split and training; mean ± standard "
        f"deviation over the {averaged_over}.",
        _protocols(plan),
        f"{_parts(plan)}{_training(plan)}",
        _samples(run),
        f"Hardware: {'; '.join(sorted({result['machine'] for result in results})) or 'none yet'}.",
    ]
    versions = {
        pair for experiment, _ in run.results for pair in experiment.identity()["versions"].items()
    }
    if versions:
        sentences.append(", ".join(f"{name} {version}" for name, version in sorted(versions)) + ".")
    if run.missing:
        num_runs = run.missing + len(results)
        sentences.append(
            f"**{run.missing} of {num_runs} runs are missing** ({NO_NUMBER} if all runs of a cell "
            "are missing; the number of seeds in brackets if some are)."
        )
    return " ".join(sentence for sentence in sentences if sentence)


def _protocols(plan: Plan) -> str:
    notes = [
        f"*{entry.name if i else _capitalize(entry.name)}* {entry.note}"
        for i, entry in enumerate(entry for entry in plan.protocols if entry.note)
    ]
    if not notes:
        return ""
    text = "; ".join(notes) + "."
    if plan.table.paper_protocol:
        return f"{text} The paper used *{plan.table.paper_protocol}*."
    is_unknown = plan.table.is_published and sum(bool(p.note) for p in plan.table.protocols) > 1
    return f"{text} The paper does not state which protocol it used." if is_unknown else text


def _parts(plan: Plan) -> str:
    # Returns one sentence on the split if all protocols have the same fractions, and otherwise a
    # list of the held-out parts.
    fractions = {(entry.protocol.val, entry.protocol.test) for entry in plan.protocols}
    if len(fractions) == 1 and plan.protocols[0].protocol.test is not None:
        ((val, test),) = fractions
        assert val is not None
        assert test is not None
        percents = [f"{100 * part:.0f} %" for part in (1 - val - test, val, test)]
        unused = f", {percents[1]} validation (unused)" if val else ""
        return f"Split: {percents[0]} training{unused}, {percents[2]} test. Tested once, "
    held_out = "; ".join(
        f"{entry.name}: {entry.protocol.describe()}"
        + (", pooled before scoring" if entry.protocol.folds else "")
        for entry in plan.protocols
    )
    return f"Held out: {held_out}. Tested once, "


def _training(plan: Plan) -> str:
    networks = [
        experiment
        for experiment in map(plan.cell_experiment, plan.table.cells)
        if not experiment.is_estimator
    ]
    if not networks:
        return f"after training. {_NO_SELECTION}"
    recipes = dict.fromkeys(
        (_optimizer(experiment), experiment.epochs, experiment.batch_size)
        for experiment in networks
    )
    optimizers = dict.fromkeys(optimizer for optimizer, _, _ in recipes)
    if len(optimizers) > 1:  # models with different optimizers
        alternatives = " or ".join(
            f"{_epochs_text([epochs])} ({optimizer}, batches of {batch_size})"
            for optimizer, epochs, batch_size in recipes
        )
        return f"after {alternatives}. {_NO_SELECTION}"
    sizes = " or ".join(map(str, sorted({batch_size for _, _, batch_size in recipes})))
    return (
        f"after {_epochs_text([epochs for _, epochs, _ in recipes])} ({next(iter(optimizers))}, "
        f"batches of {sizes}). {_NO_SELECTION}"
    )


def _epochs_text(numbers: Sequence[int]) -> str:
    text = " or ".join(map(str, sorted(set(numbers))))
    return f"{text} epoch{'' if text == '1' else 's'}"


def _optimizer(experiment: Experiment) -> str:
    config, rate = experiment.model.get("optimizer"), None
    name = config if isinstance(config, str) else "Adam"
    if isinstance(config, dict) and "class_path" in config:
        name, rate = config["class_path"], (config.get("init_args") or {}).get("lr")
    return _class_name(name) + ("" if rate is None else f", learning rate {rate:g}")


def _class_name(class_path: str) -> str:
    return class_path.rpartition(".")[2]


def _samples(run: PlanRun) -> str:
    # Describes the samples of the table, then the samples of models and protocols that use
    # different samples.
    plan, facts = run.plan, run.plan.facts
    noun = "frame" if 0 < facts.num_trials < facts.num_samples else "sample"
    table_selection = _selection_text(plan.data, noun)
    selected = {
        (experiment.name, experiment.protocol_name): _selection_text(experiment.data, noun)
        for experiment in plan.experiments
    }
    sentences = []
    for text in dict.fromkeys([table_selection, *selected.values()]):
        if text not in selected.values():
            continue
        counts = []
        for name in (protocol.name for protocol in plan.protocols):
            results = [
                result
                for experiment, result in run.results
                if experiment.protocol_name == name
                and _selection_text(experiment.data, noun) == text
            ]
            if results:
                train, test = (
                    _format_range([r[key] for r in results]) for key in ("num_train", "num_test")
                )
                protocol_label = name if name.startswith("by ") else f"({name})"
                counts.append(f"{train} to train and {test} to test {protocol_label}")
        if text == table_selection:
            sentences.append("; ".join([f"{text}: {facts.num_samples:,} in all", *counts]))
        else:
            names = dict.fromkeys(
                name for (name, _), selection in selected.items() if selection == text
            )
            models = "" if len(names) == len(plan.table.cells) else f" for {', '.join(names)}"
            counts_text = f": {'; '.join(counts)}" if counts else ""
            sentences.append(f"{text}{models}{counts_text}")
    return f"{'. '.join(sentences)}.{_tare_sentence(plan.data.arguments.get('tare'))}"


def _selection_text(source: DataSource, noun: str) -> str:
    # Describes which samples are selected by the arguments of a source and of the frames that it is
    # cut from.
    settings: dict[str, Any] = {}
    layer: DataSource | None = source
    while layer is not None:
        settings = {**layer.arguments, **settings}  # outer arguments take precedence
        layer = layer.frames
    settings |= source.selection
    stride, phases = settings.get("stride") or 1, settings.get("phases")
    text = f"Every {noun}" if stride == 1 else f"Every {_ordinal(stride)} {noun}"
    rate, num_drawn = settings.get("rate"), settings.get("samples_per_trial")
    if rate is not None:
        text += f" at {rate:g} Hz"
    if num_drawn is not None:
        text = f"{num_drawn} of each trial, drawn from {text[0].lower()}{text[1:]}"
    return text if phases is None else f"{text} of the phases {', '.join(phases)}"


def _ordinal(number: int) -> str:
    last = 0 if number // 10 % 10 == 1 else number % 10  # 11th, 12th, 13th
    suffixes = ("th", "st", "nd", "rd")
    return f"{number}{suffixes[last] if last < len(suffixes) else 'th'}"


def _tare_sentence(tare: float | str | None) -> str:
    if tare is None:
        return ""
    if tare == "baseline":  # the name of a phase, or of one recording for all trials
        return " The mean of the baseline readings is subtracted."
    where = f"in the phase {tare}" if isinstance(tare, str) else f"in its first {tare:g} s"
    return f" The mean of each trial's readings {where} is subtracted."


def _capitalize(text: str) -> str:
    return text[:1].upper() + text[1:]


def _format_range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def cost_note(plan: Plan) -> str:
    r"""Returns an explanation of the cost columns."""
    note = (
        "Means over all runs. Frames/s: training frames of all epochs divided by the duration of "
        "the training loop, which includes the transforms and other work on the machine."
    )
    if not plan.table.measure_memory:
        return note
    return (
        f"{note} Peak memory: increase from before the model is created (with recordings loaded "
        "and scaling fitted) to the maximum during training, measured in a separate process. It "
        "includes parameters, gradients, the optimizer's state, activations and a batch."
    )
