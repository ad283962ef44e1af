r"""Statistical features of tactile time series."""

import numpy as np

from torch_geometric_tactile.baselines._readings import check_finite

#: Names of the features from :func:`statistical_features`, in order.
FEATURE_NAMES = (
    "maximum",
    "minimum",
    "peak",
    "mean",
    "variance",
    "standard_deviation",
    "absolute_mean",
    "root_mean_square",
    "crest_factor",
    "form_factor",
    "pulse_factor",
    "margin_factor",
)


def statistical_features(signal: np.ndarray) -> np.ndarray:
    r"""Returns the 12 statistical features of a signal from the "Tactile Grasp Stability
    Classification Based on Graph Convolutional Networks" paper, in the same order as in the paper
    (:obj:`FEATURE_NAMES`).

    With peak :math:`p = \max |x|`, root mean square :math:`r`, absolute mean :math:`a` and
    :math:`q = (\overline{\sqrt{|x|}})^2`, the last four features are :math:`p/r`, :math:`r/a`,
    :math:`p/a` and :math:`p/q`. The paper gives no formulas; these are the usual definitions. A
    ratio is zero if its denominator is zero.

    Args:
        signal (numpy.ndarray): Readings over time :math:`(..., T)`.

    Shapes:
        - **output:** features :math:`(..., 12)`

    Raises:
        ValueError: If there is no frame, or a reading is not finite.

    Examples:
        >>> statistical_features(np.array([3.0, -1.0])).round(3)[:8]
        array([ 3.   , -1.   ,  3.   ,  1.   ,  4.   ,  2.   ,  2.   ,  2.236])
    """
    signal = np.asarray(signal, dtype=np.float64)
    if signal.ndim == 0 or signal.shape[-1] == 0:
        raise ValueError(f"'signal' must hold at least one frame (got shape {signal.shape})")
    check_finite(signal, "signal")
    magnitude = np.abs(signal)
    peak = magnitude.max(-1)
    absolute_mean = magnitude.mean(-1)
    root_mean_square = np.sqrt(np.square(signal).mean(-1))
    square_mean_root = np.square(np.sqrt(magnitude).mean(-1))
    return np.stack(
        [
            signal.max(-1),
            signal.min(-1),
            peak,
            signal.mean(-1),
            signal.var(-1),
            signal.std(-1),
            absolute_mean,
            root_mean_square,
            _ratio(peak, root_mean_square),
            _ratio(root_mean_square, absolute_mean),
            _ratio(peak, absolute_mean),
            _ratio(peak, square_mean_root),
        ],
        axis=-1,
    )


def _ratio(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    zeros = np.zeros_like(numerator)
    return np.divide(numerator, denominator, out=zeros, where=denominator > 0)
