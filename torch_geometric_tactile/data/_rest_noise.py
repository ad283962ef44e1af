r"""Mean and noise of readings at rest."""

import warnings

import numpy as np

#: The parts in which frames at rest are cut to tell movement from noise.
NUM_BLOCKS = 5


def movement_and_noise(tactile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns of each signal the range of the means of the parts in units of the noise, and the
    noise: the standard deviation within the parts, without slow movement.

    Shapes:
        - **tactile:** readings :math:`(T, N, C)`
        - **output:** :math:`(N, C)` each
    """
    parts = np.array_split(tactile.astype(np.float64), NUM_BLOCKS)
    means = np.stack([mean_reading(part) for part in parts])
    deviations = np.stack([_deviation(part) for part in parts])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of taxels that are missing throughout
        # A touch in one part makes this part loud, not the others.
        noise = np.minimum(
            np.sqrt(np.nanmean(deviations**2, axis=0)), 2 * np.nanmedian(deviations, axis=0)
        )
        spread = np.nanmax(means, axis=0) - np.nanmin(means, axis=0)
    return distance_ratio(spread, trusted_noise(noise)), noise


def mean_reading(values: np.ndarray) -> np.ndarray:
    r"""Returns the mean reading of some frames, NaN where there is none in any.

    Shapes:
        - **values:** :math:`(T, N, C)`
        - **output:** :math:`(N, C)`
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        mean: np.ndarray = np.nanmean(values, axis=0)
    return mean


def _deviation(values: np.ndarray) -> np.ndarray:
    count = np.maximum((~np.isnan(values)).sum(axis=0) - 1, 1)
    square = np.nansum((values - mean_reading(values)) ** 2, axis=0)
    deviation: np.ndarray = np.sqrt(square / count)
    return deviation


def trusted_noise(noise: np.ndarray) -> np.ndarray:
    r"""Returns the noise of each signal, at least that of the signals of its channel together.

    Shapes:
        - **noise:** :math:`(N, C)`
        - **output:** :math:`(N, C)`
    """
    # Readings are whole numbers: a quiet signal may be one that just does not tip over. So none is
    # taken to be quieter than the signals of its channel together.
    usual = np.sqrt(mean_reading(noise**2))
    return np.fmax(noise, usual)


def distance_ratio(distance: np.ndarray, noise: np.ndarray) -> np.ndarray:
    r"""Returns distances in units of the noise; zero stays zero without noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = distance / noise
    return np.where(distance == 0, 0.0, ratio)
