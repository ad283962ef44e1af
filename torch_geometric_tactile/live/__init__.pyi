from .clock_map import ClockMap
from .health import Health, HealthMeter
from .recorder import Recorder
from .replay_server import ReplayServer
from .source import Source, SourceEnded
from .stream import Stream
from .subscription import StreamEnded, StreamOverflow, Subscription
from .taxel_map import TaxelMap

__all__ = [
    "ClockMap",
    "Health",
    "HealthMeter",
    "Recorder",
    "ReplayServer",
    "Source",
    "SourceEnded",
    "Stream",
    "StreamEnded",
    "StreamOverflow",
    "Subscription",
    "TaxelMap",
]
