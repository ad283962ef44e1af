from .callback import Callback
from .health import Health
from .judge import Judge, Judgement
from .onnx_judge import OnnxModel
from .open_source import open_source
from .recorder import Recorder
from .replay_server import ReplayServer
from .replay_source import ReplaySource
from .rest import Drift, Rest
from .serial_source import SerialSource
from .session import LiveSession
from .simulated_source import SimulatedSource
from .source import Source, SourceEnded
from .status import Status
from .stream import Stream
from .subscription import StreamEnded, StreamOverflow, Subscription
from .taxel_map import TaxelMap
from .viewer import Viewer
from .xela_source import XelaSource

__all__ = [
    "Callback",
    "Drift",
    "Health",
    "Judge",
    "Judgement",
    "LiveSession",
    "OnnxModel",
    "Recorder",
    "ReplayServer",
    "ReplaySource",
    "Rest",
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
    "Viewer",
    "XelaSource",
    "open_source",
]
