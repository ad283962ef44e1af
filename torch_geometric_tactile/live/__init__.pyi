from .clock_map import ClockMap
from .health import Health, HealthMeter
from .judge import Judge, Judgement
from .onnx_judge import OnnxModel
from .rest import Drift, Rest, RestFrames
from .source import Source, SourceEnded
from .stream import Stream
from .subscription import StreamEnded, StreamOverflow, Subscription
from .taxel_map import TaxelMap

__all__ = [
    "ClockMap",
    "Drift",
    "Health",
    "HealthMeter",
    "Judge",
    "Judgement",
    "OnnxModel",
    "Rest",
    "RestFrames",
    "Source",
    "SourceEnded",
    "Stream",
    "StreamEnded",
    "StreamOverflow",
    "Subscription",
    "TaxelMap",
]
