r"""Sensors: positions of taxels, edges between taxels, and kinematics of hands."""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.sensors.allegro import (
    allegro_uskin,
    allegro_uskin_240,
    allegro_uskin_368,
)
from torch_geometric_tactile.sensors.biotac import biotac, biotac_sp
from torch_geometric_tactile.sensors.flexitac import flexitac
from torch_geometric_tactile.sensors.icub import icub_fingertip, icub_hand
from torch_geometric_tactile.sensors.joints import Joint
from torch_geometric_tactile.sensors.kinematics import HandKinematics, LinkPose, PosedTaxels
from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.letter_array import letter_array
from torch_geometric_tactile.sensors.patches import expand_patches
from torch_geometric_tactile.sensors.paxini import (
    leap_paxini,
    paxini_15_pulp,
    paxini_15_tip,
    paxini_31,
    paxini_52,
)
from torch_geometric_tactile.sensors.planar_arrays import grid, hexagonal
from torch_geometric_tactile.sensors.sector_edges import SectorEdges, layout_sectors, sector_edges
from torch_geometric_tactile.sensors.select_taxels import select_taxels, thinned
from torch_geometric_tactile.sensors.stock import as_layout, stock_layout, stock_names, stock_path
from torch_geometric_tactile.sensors.taxel_descriptors import descriptor_names, taxel_descriptors
from torch_geometric_tactile.sensors.uskin import uskin_gripper, uspa44, uspa46

__all__ = [
    "HandKinematics",
    "Joint",
    "LinkPose",
    "PosedTaxels",
    "SectorEdges",
    "TaxelLayout",
    "allegro_uskin",
    "allegro_uskin_240",
    "allegro_uskin_368",
    "as_layout",
    "biotac",
    "biotac_sp",
    "descriptor_names",
    "expand_patches",
    "flexitac",
    "grid",
    "hexagonal",
    "icub_fingertip",
    "icub_hand",
    "layout_sectors",
    "leap_paxini",
    "letter_array",
    "paxini_15_pulp",
    "paxini_15_tip",
    "paxini_31",
    "paxini_52",
    "sector_edges",
    "select_taxels",
    "stock_layout",
    "stock_names",
    "stock_path",
    "taxel_descriptors",
    "thinned",
    "uskin_gripper",
    "uspa44",
    "uspa46",
]

__getattr__ = removed_names(__name__)
