r"""Message passing layers and encoders of edge features."""

from torch_geometric_tactile.nn.conv.causal_temporal_conv import CausalTemporalConv
from torch_geometric_tactile.nn.conv.edge_feature_encoder import EdgeFeatureEncoder
from torch_geometric_tactile.nn.conv.edge_message_encoder import (
    EdgeAttentionEncoder,
    EdgeMessageEncoder,
    EdgePatchEncoder,
)
from torch_geometric_tactile.nn.conv.sector_conv import SectorConv
from torch_geometric_tactile.nn.conv.segmented_gcn_conv import SegmentedGCNConv
from torch_geometric_tactile.nn.conv.self_gcn_conv import SelfGCNConv
from torch_geometric_tactile.nn.conv.static_gat_conv import StaticGATConv
from torch_geometric_tactile.nn.conv.static_gatv2_conv import StaticGATv2Conv
from torch_geometric_tactile.nn.conv.static_gcn_conv import StaticGCNConv

__all__ = [
    "CausalTemporalConv",
    "EdgeAttentionEncoder",
    "EdgeFeatureEncoder",
    "EdgeMessageEncoder",
    "EdgePatchEncoder",
    "SectorConv",
    "SegmentedGCNConv",
    "SelfGCNConv",
    "StaticGATConv",
    "StaticGATv2Conv",
    "StaticGCNConv",
]
