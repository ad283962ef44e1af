r"""Computes the fast pressure signal (PAC) of fluid-filled fingertips from slow forces."""

import numpy as np

_SAMPLES_PER_FRAME = 22
_RATE = 2200.0  # Hz: 22 samples per frame at 100 Hz
_REST = 2048.0  # counts
_FORCE_RATE_GAIN = 1.5  # counts per newton per second
_SLIDING_NOISE = 50.0  # counts, standard deviation at the reference speed and 1 N
_REFERENCE_SPEED = 0.02  # m/s
_MAX_RELATIVE_SPEED = 4.0  # in units of the reference speed; faster slides are no louder
_BAND = (80.0, 600.0)  # Hz
_NOISE = 3.0  # counts
_MAX_COUNT = 4095  # of 12 bits


def vibration(normal: np.ndarray, slide: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    r"""Returns the dynamic pressure of each fingertip in counts :math:`(T, F, 22)`: 22 values for
    each frame of three ticks. This is a model, not a simulation at 2200 Hz; its constants are
    plausible, not measured.

    The signal is the sum of three parts:

    * the rate of change of the normal force
    * noise from 80 to 600 Hz, whose amplitude is proportional to the sliding speed and to the
      square root of the force
    * the noise of the sensor

    Args:
        normal (numpy.ndarray): Normal forces in newtons at 300 Hz :math:`(3 T, F)`.
        slide (numpy.ndarray): Sliding speeds in metres per second at 300 Hz :math:`(3 T, F)`.
        rng (numpy.random.Generator): The random number generator.

    Raises:
        ValueError: If the shapes differ, or if the number of ticks is not divisible by three.

    Examples:
        >>> force, still = np.ones((300, 3)), np.zeros((300, 3))  # one second at 300 Hz
        >>> vibration(force, still, np.random.default_rng(0)).shape
        (100, 3, 22)
    """
    if normal.ndim != 2 or normal.shape != slide.shape or len(normal) % 3:
        raise ValueError(
            "'normal' and 'slide' must have the same shape (3 * T, num_fingers) (got "
            f"{normal.shape} and {slide.shape})"
        )
    num_frames, num_fingers = len(normal) // 3, normal.shape[1]
    force_rate = np.diff(normal, axis=0, prepend=normal[:1]) * 300.0
    relative_speed = (slide / _REFERENCE_SPEED).clip(0.0, _MAX_RELATIVE_SPEED)
    amplitude = _SLIDING_NOISE * relative_speed * np.sqrt(normal.clip(0.0))
    tick_times = (np.arange(len(normal)) + 1) / 300.0
    times = (np.arange(num_frames * _SAMPLES_PER_FRAME) + 1) / _RATE
    signal = np.empty((num_fingers, num_frames * _SAMPLES_PER_FRAME))
    for i in range(num_fingers):
        signal[i] = _REST + _FORCE_RATE_GAIN * np.interp(times, tick_times, force_rate[:, i])
        signal[i] += np.interp(times, tick_times, amplitude[:, i]) * _band_noise(len(times), rng)
    signal += _NOISE * rng.normal(size=signal.shape)
    counts = signal.round().clip(0, _MAX_COUNT).astype(np.uint16)
    return counts.reshape(num_fingers, num_frames, _SAMPLES_PER_FRAME).swapaxes(0, 1)


def _band_noise(size: int, rng: np.random.Generator) -> np.ndarray:
    spectrum = np.fft.rfft(rng.normal(size=size))
    frequency = np.fft.rfftfreq(size, 1 / _RATE)
    in_band = (frequency >= _BAND[0]) & (frequency <= _BAND[1])
    noise: np.ndarray = np.fft.irfft(spectrum * in_band, size)
    return noise / np.sqrt(max(in_band.mean(), 1e-9))  # scaled to a standard deviation of one
