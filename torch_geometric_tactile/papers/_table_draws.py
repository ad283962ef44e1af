r"""The part of a table's page on draws of the test samples."""

from torch_geometric_tactile.experiments.run_plan import PlanRun

_PERCENT = 100.0**2  # of a variance of parts


def draws_note(run: PlanRun) -> str:
    r"""Returns what draws are, and how much they can vary, as sentences; empty for a table without
    any.
    """
    draws = run.plan.table.draws
    if draws is None:
        return ""
    sizes = sorted({result["num_test"] for _, result in run.results})
    published = [
        (cell.published["variance"], cell.published["accuracy"])
        for cell in run.plan.table.cells
        if {"variance", "accuracy"} <= cell.published.keys()
    ]
    text = (
        f"Accuracies of draws: {draws.count} draws of {100 * draws.part:.0f} % of the test "
        f"samples, without replacement, from the predictions of one trained network (seed "
        f"{draws.seed}): mean and variance in %² (squared points)."
    )
    if not sizes:
        return text
    total = sizes[-1]
    drawn, most = draws.num_drawn(total), _PERCENT * draws.variance(0.5, total)
    text += (
        f" Of {drawn:,} of {total:,} samples the variance is p(1 - p)/{drawn} · "
        f"{total - drawn}/{total - 1} on average: at most {most:.2f} %², if half of the answers "
        f"are right, and {_PERCENT * draws.variance(0.95, total):.2f} %² if 95 % are."
    )
    if not published:
        return text
    above = sum(
        variance > _PERCENT * draws.variance(accuracy / 100, total)
        for variance, accuracy in published
    )
    low, high = min(published)[0], max(published)[0]
    return (
        f"{text} The published variances are {low:g} to {high:g}: {above} of {len(published)} are "
        "above the average of draws from one network at the published accuracy, most of them "
        "several times. They must contain something else, which the paper does not name."
    )
