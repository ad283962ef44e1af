r"""The fast pressure signal (PAC) of fluid-filled fingertips, made from slow forces."""

import numpy as np

_SAMPLES = 22  # a frame of 100 Hz: 2200 Hz
_RATE = 2200.0
_REST = 2048.0  # counts
_PER_RATE = 1.5  # counts per newton and second
_SLIDING = 50.0  # counts (standard deviation) at the speed below and 1 N
_SPEED = 0.02  # m/s
_FASTEST = 4.0  # times that speed, from which on it gets no louder
_BAND = (80.0, 600.0)  # Hz
_NOISE = 3.0  # counts
_COUNTS = 4095


def vibration(normal: np.ndarray, slide: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    r"""Returns the dynamic pressure of each fingertip in counts :math:`(T, F, 22)`, 22 values for
    each frame of three ticks. A model, not a simulation at 2200 Hz: its numbers are plausible, not
    measured.

    It is the rate of the normal force, plus noise from 80 to 600 Hz as loud as the object slides
    there (and with the square root of the force), plus the noise of the sensor.

    Args:
        normal (numpy.ndarray): Normal forces in newtons at 300 Hz :math:`(3 T, F)`.
        slide (numpy.ndarray): Speeds of sliding in metres per second, likewise.
        rng (numpy.random.Generator): Draws both noises.

    Raises:
        ValueError: If shapes differ or are no whole frames.

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
    num_frames, fingers = len(normal) // 3, normal.shape[1]
    rate = np.diff(normal, axis=0, prepend=normal[:1]) * 300.0
    loud = _SLIDING * (slide / _SPEED).clip(0.0, _FASTEST) * np.sqrt(normal.clip(0.0))
    ticks = (np.arange(len(normal)) + 1) / 300.0
    times = (np.arange(num_frames * _SAMPLES) + 1) / _RATE
    out = np.empty((fingers, num_frames * _SAMPLES))
    for i in range(fingers):
        out[i] = _REST + _PER_RATE * np.interp(times, ticks, rate[:, i])
        out[i] += np.interp(times, ticks, loud[:, i]) * _band_noise(len(times), rng)
    out += _NOISE * rng.normal(size=out.shape)
    counts = out.round().clip(0, _COUNTS).astype(np.uint16)
    return counts.reshape(fingers, num_frames, _SAMPLES).swapaxes(0, 1)


def _band_noise(size: int, rng: np.random.Generator) -> np.ndarray:
    spectrum = np.fft.rfft(rng.normal(size=size))
    frequency = np.fft.rfftfreq(size, 1 / _RATE)
    inside = (frequency >= _BAND[0]) & (frequency <= _BAND[1])
    noise: np.ndarray = np.fft.irfft(spectrum * inside, size)
    return noise / np.sqrt(max(inside.mean(), 1e-9))
