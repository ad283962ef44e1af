r"""A graph of the nearest taxels in each direction."""

from typing import Literal

import torch
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, as_layout, layout_sectors
from torch_geometric_tactile.transforms._attributes import EDGES, check_num_taxels
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

# Attributes of previous edges, which are deleted.
_EDGE_ATTRIBUTES = ("edge_attr", "edge_weight", "edge_type", "edge_is_within")


@functional_transform("sector_graph")
class SectorGraph(TactileTransform):
    r"""Connects each taxel to its nearest neighbour in each sector of its tangent plane (functional
    name: :obj:`sector_graph`). :class:`~torch_geometric_tactile.nn.conv.SectorConv` uses this
    graph. See :func:`~torch_geometric_tactile.sensors.sector_edges` for the directions.

    The edges do not depend on the pose of a hand, since positions and axes are in the frames of the
    links.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of this
            package, or a layout file.
        num_sectors (int): Number of sectors.
        radius (float, optional): Largest distance of a neighbour in metres. The default is three
            times the distance between neighbouring taxels.
        within (str): Whether neighbours must be on the same :obj:`"patch"` or the same
            :obj:`"link"`.

    Shapes:
        - **output:** :obj:`edge_index` :math:`(2, |\mathcal{E}|)` from the neighbour to the taxel,
          and its sector :obj:`edge_sector` :math:`(|\mathcal{E}|,)`

    Raises:
        ValueError: If :obj:`num_sectors` is below one, :obj:`radius` is not positive,
            :obj:`within` is unknown, or a sample has the wrong number of taxels.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> data = Data(x=torch.zeros(4, 1))
        >>> SectorGraph(grid(2, 2, pitch=0.002))(data).edge_sector
        tensor([0, 1, 2, 2, 3, 4, 0, 6, 7, 4, 5, 6])
    """

    reads = ()
    writes = (*EDGES, "edge_sector", "edge_type", "edge_is_within")
    per_frame = True

    def __init__(
        self,
        layout: TaxelLayout | PathLike,
        num_sectors: int = 8,
        radius: float | None = None,
        within: Literal["patch", "link"] = "patch",
    ) -> None:
        self.layout = as_layout(layout)
        self.num_sectors = num_sectors
        self.radius = radius
        self.within = within
        # Computed once, since the edges do not depend on the samples.
        self._edges = layout_sectors(self.layout, num_sectors, radius, within)

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`edge_index` and :obj:`edge_sector`; deletes attributes of previous edges."""
        num_taxels = self.layout.num_taxels
        check_num_taxels(data, num_taxels, f"layout '{self.layout.name}'")
        for key in _EDGE_ATTRIBUTES:
            if key in data:
                del data[key]
        edge_index, sector = self._edges
        num_samples = data.num_graphs if isinstance(data, Batch) else 1
        start = num_taxels * torch.arange(num_samples).view(-1, 1, 1)
        edges = (edge_index + start).transpose(0, 1).flatten(1)
        reference = data.x if getattr(data, "x", None) is not None else edges
        data.edge_index = edges.to(reference.device)
        data.edge_sector = sector.repeat(num_samples).to(reference.device)
        return data
