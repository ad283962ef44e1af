r"""Mean and noise of readings at rest, when nothing touches the sensor."""

import warnings

import numpy as np

#: The number of blocks into which frames at rest are divided to distinguish movement from noise.
NUM_BLOCKS = 5


def movement_and_noise(tactile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns the movement and the noise of each signal. The noise is the standard deviation
    within blocks of frames, which excludes slow movement. The movement is the range of the block
    means, in units of the noise.

    Shapes:
        - **tactile:** readings :math:`(T, N, C)`
        - **output:** movement and noise :math:`(N, C)` each
    """
    blocks = np.array_split(tactile.astype(np.float64), NUM_BLOCKS)
    means = np.stack([mean_reading(block) for block in blocks])
    deviations = np.stack([_standard_deviation(block) for block in blocks])
    with warnings.catch_warnings():
        # Taxels without any reading give NaN, as intended.
        warnings.simplefilter("ignore", RuntimeWarning)
        # The limit by the median keeps the noise low if a touch makes one block noisy.
        noise = np.minimum(
            np.sqrt(np.nanmean(deviations**2, axis=0)), 2 * np.nanmedian(deviations, axis=0)
        )
        spread = np.nanmax(means, axis=0) - np.nanmin(means, axis=0)
    return distance_ratio(spread, trusted_noise(noise)), noise


def mean_reading(values: np.ndarray) -> np.ndarray:
    r"""Returns the mean reading over frames; NaN for a signal that is missing in all frames.

    Shapes:
        - **values:** :math:`(T, N, C)`
        - **output:** :math:`(N, C)`
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        mean: np.ndarray = np.nanmean(values, axis=0)
    return mean


def _standard_deviation(values: np.ndarray) -> np.ndarray:
    count = np.maximum((~np.isnan(values)).sum(axis=0) - 1, 1)
    square = np.nansum((values - mean_reading(values)) ** 2, axis=0)
    deviation: np.ndarray = np.sqrt(square / count)
    return deviation


def trusted_noise(noise: np.ndarray) -> np.ndarray:
    r"""Returns the noise of each signal, raised to at least the root mean square over the signals
    of its channel.

    Shapes:
        - **noise:** :math:`(N, C)`
        - **output:** :math:`(N, C)`
    """
    # Readings are whole numbers. A signal halfway between two of them shows no noise until it
    # drifts, so no signal is assumed to be quieter than its channel.
    channel_noise = np.sqrt(mean_reading(noise**2))
    return np.fmax(noise, channel_noise)


def distance_ratio(distance: np.ndarray, noise: np.ndarray) -> np.ndarray:
    r"""Returns distances in units of the noise. Without noise, a distance of zero is zero and any
    other distance is infinite.

    Shapes:
        - **distance:** :math:`(\ldots, N, C)`
        - **noise:** :math:`(N, C)`
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = distance / noise
    return np.where(distance == 0, 0.0, ratio)
