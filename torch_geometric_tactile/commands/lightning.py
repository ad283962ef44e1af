r"""The verbs whose arguments Lightning reads."""

from collections.abc import Callable, Sequence


def lightning_verb(name: str) -> Callable[[Sequence[str]], int]:
    r"""Returns the function that runs a verb with all arguments behind it, and returns the exit
    status.

    Args:
        name (str): The verb.
    """

    def run_raw(arguments: Sequence[str]) -> int:
        from torch_geometric_tactile.training import lightning_cli

        lightning_cli.main([name, *arguments])
        return 0

    return run_raw
