r"""Selection of a part of a table."""

from collections.abc import Sequence
from dataclasses import replace

from torch_geometric_tactile.experiments.plan import PlanRun


def selected_part(run: PlanRun, only: Sequence[str] | None) -> PlanRun:
    r"""Returns the part of a table with the selected experiments, and with all experiments that
    already have results.

    Args:
        run (PlanRun): The run of the full table.
        only (sequence of str, optional): Patterns for the names of experiments. By default, all
            experiments are selected.
    """
    if only is None:
        return run
    plan, table = run.plan, run.plan.table
    names = {cell.experiment for cell in table.select(only)} | {
        experiment.name for experiment, _ in run.results
    }
    orderings = tuple(
        replace(ordering, pairs=pairs)
        for ordering in table.orderings
        if (pairs := tuple(pair for pair in ordering.pairs if names >= {*pair}))
    )
    cells = tuple(cell for cell in table.cells if cell.experiment in names)
    experiments = tuple(experiment for experiment in plan.experiments if experiment.name in names)
    return run._replace(
        plan=replace(
            plan,
            table=replace(table, cells=cells, orderings=orderings),
            experiments=experiments,
        ),
        missing=len(experiments) - len(run.results),
    )
