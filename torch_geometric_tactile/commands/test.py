r"""``tactile test``, whose arguments Lightning reads."""

from collections.abc import Sequence

HELP = "measure a checkpoint on the test part, also by recording session"


def run_raw(arguments: Sequence[str]) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (list of str): All arguments behind ``tactile test``.
    """
    from torch_geometric_tactile.training import lightning_cli

    lightning_cli.main(["test", *arguments])
    return 0
