r"""Imports and preparations that a recorder needs before its first frame."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._mcap_schemas import TOPICS, encode

if TYPE_CHECKING:
    from torch_geometric_tactile.live._posed_points import PosedPoints
    from torch_geometric_tactile.sensors import TaxelLayout

#: Seconds that a recording of limited length waits for frames that are still on their way.
LATE_SECONDS = 0.5


def preload_recorder(layout: "TaxelLayout | PathLike | None") -> "PosedPoints | None":
    r"""Imports the libraries of a recorder, so that no frame of a stream waits for them. Returns
    the object that poses the taxels of a layout, or :obj:`None` without a layout.
    """
    from torch_geometric_tactile.io import recording_mcap  # noqa: F401 - imports the libraries
    from torch_geometric_tactile.io._mcap_output import require_mcap

    require_mcap()
    for topic in TOPICS:  # encoding the first message of a topic is slow
        encode(topic, {})
    if layout is None:
        return None
    from torch_geometric_tactile.live._posed_points import PosedPoints

    return PosedPoints(layout)
