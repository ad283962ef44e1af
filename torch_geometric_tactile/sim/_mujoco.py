r"""The door to MuJoCo."""

from typing import Any


def import_mujoco() -> Any:
    r"""Returns the module, or raises an :obj:`ImportError` that names the extra."""
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(
            "the simulated hand needs MuJoCo: pip install 'torch-geometric-tactile[sim]'"
        ) from error
    return mujoco
