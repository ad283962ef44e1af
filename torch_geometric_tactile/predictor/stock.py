r"""Trained predictors that are shipped with the package."""

from importlib.resources import files
from pathlib import Path

from torch_geometric_tactile._typing import PathLike

_SUFFIX = ".predictor"


def stock_predictors() -> list[str]:
    r"""Returns the names of the trained predictors of the package. :meth:`Predictor.load
    <torch_geometric_tactile.Predictor.load>`, the commands and
    :class:`~torch_geometric_tactile.live.Judge` accept these names in place of a file.
    ``docs/pretrained.md`` describes their data, scores and limits.

    Examples:
        >>> stock_predictors()
        ['biotac_sp_slip', 'pressure_mat_side', 'simulated_hand_shape']
    """
    return sorted(file.stem for file in _folder().glob(f"*{_SUFFIX}"))


def predictor_path(name: PathLike) -> Path:
    r"""Returns the path of an existing file, or of a predictor of the package.

    Args:
        name (str or PathLike): The path of a file, or a name of :func:`stock_predictors`. An
            existing file has precedence over a name.

    Raises:
        FileNotFoundError: If there is neither a file nor a predictor of this name. The message
            lists the available names.

    Examples:
        >>> predictor_path("biotac_sp_slip").name
        'biotac_sp_slip.predictor'
    """
    path = Path(name)
    if path.is_file():
        return path
    if isinstance(name, str) and name in stock_predictors():
        return _folder() / f"{name}{_SUFFIX}"
    raise FileNotFoundError(
        f"there is no predictor or checkpoint '{name}': give the path of a file from "
        f"Predictor.save, 'tactile predict --save' or 'tactile fit', or one of "
        f"{stock_predictors()}"
    )


def _folder() -> Path:
    return Path(str(files(__package__) / "pretrained"))
