r"""``tactile validate``, whose arguments Lightning reads."""

from collections.abc import Sequence

HELP = "measure a checkpoint on the validation part"


def run_raw(arguments: Sequence[str]) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (list of str): All arguments behind ``tactile validate``.
    """
    from torch_geometric_tactile.training import lightning_cli

    lightning_cli.main(["validate", *arguments])
    return 0
