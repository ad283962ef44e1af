r"""What a table of ours is made of."""

from collections.abc import Sequence

from torch_geometric_tactile.experiments.plan import TableRun
from torch_geometric_tactile.training.config import expand_template

NOTHING = "\N{EN DASH}"


def caption(run: TableRun) -> str:
    r"""Returns what a table is made of: source, split, seeds, epochs, frames and hardware.

    Args:
        run (TableRun): What :func:`run_table` returned.
    """
    table, settings, results = run.table, run.settings, [result for _, result in run.results]
    config = expand_template(table.template)[table.cells[0].experiment]
    arguments = config["data"]["dataset"]["init_args"]
    train, val, test = (f"{100 * part:.0f} %" for part in arguments["fractions"])
    epochs = settings.epochs or config["trainer"]["max_epochs"]
    seeds = "0" if settings.seeds == 1 else f"0 to {settings.seeds - 1}"
    optimizer = config["model"]["optimizer"]
    adam, rate = optimizer["class_path"].rpartition(".")[2], optimizer["init_args"]["lr"]
    parts = [
        f"Published: {table.place} of *{table.paper}*, measured on a real hand; its recordings are "
        "private.",
        f"Beside it, a line apart: {run.recordings.describe()}",
        f"Seed{'' if settings.seeds == 1 else 's'} {seeds} of split and training; mean ± standard "
        "deviation over the seeds.",
        "*By trial* holds out whole trials of each object; *by frame* holds out random frames, "
        "whose neighbours in time were trained on, and so tells whether a trial was seen before. "
        "The paper does not say which it used.",
        f"{train} to train, {val} unused (for validation), {test} to test, once, after {epochs} "
        f"epoch{'' if epochs == 1 else 's'} ({adam}, learning rate {rate:g}, batches of "
        f"{config['data']['batch_size']}; nothing was chosen by the test part).",
        _frames(run),
        f"Hardware: {'; '.join(sorted({result['machine'] for result in results})) or 'none yet'}.",
    ]
    versions = {tuple(e.identity()["versions"].items()) for e, _ in run.results}
    parts += [", ".join(f"{name} {version}" for name, version in sorted(v)) + "." for v in versions]
    if run.missing:
        total = run.missing + len(results)
        parts.append(
            f"**{run.missing} of {total} runs are missing** ({NOTHING} where all are, the number "
            "of seeds in brackets where some are)."
        )
    return " ".join(parts)


def _frames(run: TableRun) -> str:
    settings = run.settings
    every = "Every frame" if settings.stride == 1 else f"Every {settings.stride}th frame"
    phases = "" if settings.phases is None else f" of the phases {', '.join(settings.phases)}"
    counts = []
    for split in settings.split_by:
        mine = [result for e, result in run.results if e.split_by == split]
        if mine:
            train, test = (_range([r[key] for r in mine]) for key in ("num_train", "num_test"))
            counts.append(f"{train} to train and {test} to test by {split}")
    return (
        f"{every}{phases}: {run.recordings.num_frames:,} in all"
        + "".join(f"; {text}" for text in counts)
        + "."
    )


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def cost_note() -> str:
    r"""Returns how the costs of a model were measured."""
    return (
        "Means over all runs. Frames/s: training frames of all epochs by the seconds of the "
        "training loop, with the transforms and whatever else the machine was doing. Peak memory: "
        "growth, in a process of its own, from before the model is built (recordings loaded, "
        "scaling fitted) to the highest point of training: parameters, gradients, the optimizer's "
        "state, activations and a batch."
    )
