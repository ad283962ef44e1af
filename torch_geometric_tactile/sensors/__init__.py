r"""What a sensor is: the places of its taxels and how they are joined."""

from torch_geometric_tactile.sensors.biotac import biotac, biotac_sp
from torch_geometric_tactile.sensors.grid import grid
from torch_geometric_tactile.sensors.layout import TaxelLayout

__all__ = ["TaxelLayout", "biotac", "biotac_sp", "grid"]
