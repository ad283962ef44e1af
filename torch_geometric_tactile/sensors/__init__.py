r"""What a sensor is: the places of its taxels, how they are joined and how a hand moves them."""

from torch_geometric_tactile.sensors.allegro import allegro_uskin, allegro_uskin_240
from torch_geometric_tactile.sensors.biotac import biotac, biotac_sp
from torch_geometric_tactile.sensors.grid import grid
from torch_geometric_tactile.sensors.kinematics import HandKinematics, Joint, LinkPose, PosedTaxels
from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.patches import expand_patches
from torch_geometric_tactile.sensors.stock import stock_layout, stock_path

__all__ = [
    "HandKinematics",
    "Joint",
    "LinkPose",
    "PosedTaxels",
    "TaxelLayout",
    "allegro_uskin",
    "allegro_uskin_240",
    "biotac",
    "biotac_sp",
    "expand_patches",
    "grid",
    "stock_layout",
    "stock_path",
]
