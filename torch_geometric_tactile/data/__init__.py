r"""Recordings as data: one topology, many samples."""

from torch_geometric_tactile.data import splits
from torch_geometric_tactile.data.apply_transform import StaticRule, apply_transform
from torch_geometric_tactile.data.frame_ring import FrameRing
from torch_geometric_tactile.data.frames import join_frames, split_frames
from torch_geometric_tactile.data.image_data import ImageData, StaticImages, image_of
from torch_geometric_tactile.data.protocol import Protocol, Split
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.data.splits import Fold
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset
from torch_geometric_tactile.data.trials import Trials
from torch_geometric_tactile.data.windows import Windows

__all__ = [
    "Fold",
    "FrameRing",
    "ImageData",
    "Protocol",
    "Recording",
    "Split",
    "StaticData",
    "StaticDataset",
    "StaticImages",
    "StaticRule",
    "Trials",
    "Windows",
    "apply_transform",
    "image_of",
    "join_frames",
    "split_frames",
    "splits",
]
