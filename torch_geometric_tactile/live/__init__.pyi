from .callback import Callback
from .clock_map import ClockMap
from .health import Health, HealthMeter
from .judge import Judge, Judgement
from .onnx_judge import OnnxModel
from .open_source import open_source
from .outage import Outage
from .recorder import Recorder
from .replay_server import ReplayServer
from .replay_source import ReplaySource
from .rest import Drift, Rest, RestFrames
from .serial_port import SerialPort, list_ports
from .serial_source import SerialSource
from .session import LiveSession
from .simulated_source import SimulatedSource
from .source import Source, SourceEnded
from .status import Status
from .stream import Stream
from .subscription import StreamEnded, StreamOverflow, Subscription
from .taxel_map import TaxelMap, TaxelOrder
from .viewer import Viewer
from .xela_source import XelaSource

__all__ = [
    "Callback",
    "ClockMap",
    "Drift",
    "Health",
    "HealthMeter",
    "Judge",
    "Judgement",
    "LiveSession",
    "OnnxModel",
    "Outage",
    "Recorder",
    "ReplayServer",
    "ReplaySource",
    "Rest",
    "RestFrames",
    "SerialPort",
    "SerialSource",
    "SimulatedSource",
    "Source",
    "SourceEnded",
    "Status",
    "Stream",
    "StreamEnded",
    "StreamOverflow",
    "Subscription",
    "TaxelMap",
    "TaxelOrder",
    "Viewer",
    "XelaSource",
    "list_ports",
    "open_source",
]
