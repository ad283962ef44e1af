r"""Models from the papers, and general-purpose models."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.nn.models.bmf_cnn import BMFCNN
from torch_geometric_tactile.nn.models.cnn_thread import CNNThread
from torch_geometric_tactile.nn.models.gcn_thread import GCNThread
from torch_geometric_tactile.nn.models.grasp_gcn import GraspGCN
from torch_geometric_tactile.nn.models.grasp_lstm import GraspLSTM
from torch_geometric_tactile.nn.models.hand_cnn import HandCNN
from torch_geometric_tactile.nn.models.ms_cnn import MSCNN
from torch_geometric_tactile.nn.models.mt_cnn import MTCNN
from torch_geometric_tactile.nn.models.mt_gcn import MTGCN
from torch_geometric_tactile.nn.models.pooled_mlp import PooledMLP
from torch_geometric_tactile.nn.models.posed_taxel_net import PosedTaxelNet
from torch_geometric_tactile.nn.models.segmented_thread import SegmentedThread
from torch_geometric_tactile.nn.models.small_cnn import SmallCNN
from torch_geometric_tactile.nn.models.tactile_fnn import TactileFNN
from torch_geometric_tactile.nn.models.tactile_gcn import TactileGCN
from torch_geometric_tactile.nn.models.tactile_model import TactileModel
from torch_geometric_tactile.nn.models.taxel_net import TaxelNet
from torch_geometric_tactile.nn.models.temporal_cnn import TemporalCNN
from torch_geometric_tactile.nn.models.temporal_taxel_net import TemporalTaxelNet
from torch_geometric_tactile.nn.models.thread import Thread
from torch_geometric_tactile.nn.models.touch_encoder import TouchEncoder

__all__ = [
    "BMFCNN",
    "MSCNN",
    "MTCNN",
    "MTGCN",
    "CNNThread",
    "GCNThread",
    "GraspGCN",
    "GraspLSTM",
    "HandCNN",
    "PooledMLP",
    "PosedTaxelNet",
    "SegmentedThread",
    "SmallCNN",
    "TactileFNN",
    "TactileGCN",
    "TactileModel",
    "TaxelNet",
    "TemporalCNN",
    "TemporalTaxelNet",
    "Thread",
    "TouchEncoder",
]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
