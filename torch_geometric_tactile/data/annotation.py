r"""A label of a span of time."""

from typing import NamedTuple


class Annotation(NamedTuple):
    r"""A span of a recording with a label, such as :obj:`"slip"`.

    Args:
        start (float): Start in seconds on the clock of the recording.
        end (float): End in seconds, not before the start.
        label (str): The label: 1 to 255 printable characters, without blanks at the ends.
            :obj:`"gap"` is reserved for spans without frames and never labels a frame.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.data import Recording
        >>> recording = Recording(
        ...     time=[0.0, 0.1, 0.2], tactile=np.zeros((3, 4, 3)), annotations=[(0.1, 0.2, "slip")]
        ... )
        >>> recording.annotations
        (Annotation(start=0.1, end=0.2, label='slip'),)
    """

    start: float
    end: float
    label: str
