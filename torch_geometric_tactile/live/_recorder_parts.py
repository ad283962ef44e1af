r"""All that a recorder needs before its first frame."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._mcap_schemas import TOPICS, encode

if TYPE_CHECKING:
    from torch_geometric_tactile.live._posed_points import PosedPoints
    from torch_geometric_tactile.sensors import TaxelLayout

#: How long after the end of its seconds a recording waits for frames that are on the way.
LATE_SECONDS = 0.5


def load_recorder(layout: "TaxelLayout | PathLike | None") -> "PosedPoints | None":
    r"""Loads all that a recorder needs, and returns the taxels of its layout in space. No frame of
    a stream then waits for a library."""
    from torch_geometric_tactile.io import recording_mcap  # noqa: F401 - as the libraries
    from torch_geometric_tactile.io._mcap_output import require_mcap

    require_mcap()
    for topic in TOPICS:  # the first message of each topic takes long
        encode(topic, {})
    if layout is None:
        return None
    from torch_geometric_tactile.live._posed_points import PosedPoints

    return PosedPoints(layout)
