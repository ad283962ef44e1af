r"""``tactile fit``, whose arguments Lightning reads."""

from collections.abc import Sequence

HELP = "train a model from a configuration"


def run_raw(arguments: Sequence[str]) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (list of str): All arguments behind ``tactile fit``.
    """
    from torch_geometric_tactile.training import lightning_cli

    lightning_cli.main(["fit", *arguments])
    return 0
