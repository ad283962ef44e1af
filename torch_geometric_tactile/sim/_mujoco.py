r"""Imports the optional dependency MuJoCo."""

from typing import Any


def import_mujoco() -> Any:
    r"""Returns the module :obj:`mujoco`.

    Raises:
        ImportError: If MuJoCo is missing. The message contains the command that installs it.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(
            "the simulated hand needs MuJoCo: pip install 'torch-geometric-tactile[sim]'"
        ) from error
    return mujoco
