r"""``tactile predict``, whose arguments Lightning reads."""

from collections.abc import Sequence

HELP = "write what a checkpoint predicts to a CSV file"


def run_raw(arguments: Sequence[str]) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (list of str): All arguments behind ``tactile predict``.
    """
    from torch_geometric_tactile.training import lightning_cli

    lightning_cli.main(["predict", *arguments])
    return 0
