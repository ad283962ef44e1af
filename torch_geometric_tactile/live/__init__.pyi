from .clock_map import ClockMap
from .health import Health, HealthMeter
from .source import Source, SourceEnded
from .stream import Stream
from .subscription import StreamEnded, StreamOverflow, Subscription
from .taxel_map import TaxelMap

__all__ = [
    "ClockMap",
    "Health",
    "HealthMeter",
    "Source",
    "SourceEnded",
    "Stream",
    "StreamEnded",
    "StreamOverflow",
    "Subscription",
    "TaxelMap",
]
