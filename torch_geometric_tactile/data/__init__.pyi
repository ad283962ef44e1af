from . import splits
from .annotation import Annotation
from .apply_transform import apply_transform
from .contact_rule import NO_CONTACT, ContactRule
from .frame_info import FrameInfo
from .frame_rate import Rate, measure_rate
from .frame_ring import FrameRing
from .frames import join_frames, split_frames
from .live_frame import LiveFrame
from .protocol import Protocol, Split
from .recording import UNITS, Recording
from .splits import Fold
from .static_data import StaticData
from .static_dataset import StaticDataset
from .trials import Trials
from .windows import Windows

__all__ = [
    "NO_CONTACT",
    "UNITS",
    "Annotation",
    "ContactRule",
    "Fold",
    "FrameInfo",
    "FrameRing",
    "LiveFrame",
    "Protocol",
    "Rate",
    "Recording",
    "Split",
    "StaticData",
    "StaticDataset",
    "Trials",
    "Windows",
    "apply_transform",
    "join_frames",
    "measure_rate",
    "split_frames",
    "splits",
]
