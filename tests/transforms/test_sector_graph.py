import pytest
import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn import SectorConv
from torch_geometric_tactile.sensors import biotac_sp, grid, layout_sectors
from torch_geometric_tactile.testing import assert_static_equals_batched
from torch_geometric_tactile.transforms import SectorGraph


def test_sector_graph_sets_the_edges_of_the_layout():
    data = SectorGraph("biotac_sp", 6, within="link")(Data(x=torch.zeros(24, 1)))
    expected = layout_sectors(biotac_sp(), 6, within="link")
    assert torch.equal(data.edge_index, expected.edge_index)
    assert torch.equal(data.edge_sector, expected.sector)


def test_sector_graph_feeds_sector_conv():
    x, transform, conv = torch.randn(3, 6, 2), SectorGraph(grid(2, 3, 0.002)), SectorConv(2, 4)
    data = transform(StaticData(x=x))
    out = conv(data.x, data.edge_index, data.edge_sector)
    before = Batch.from_data_list([Data(x=row) for row in x])
    after = Batch.from_data_list([transform(Data(x=row)) for row in x])
    for batch in (transform(before), after):
        found = conv(batch.x, batch.edge_index, batch.edge_sector)
        assert torch.allclose(found.view(3, 6, 4), out, atol=1e-6)
    assert_static_equals_batched(conv, x, data.edge_index, data.edge_sector)


def test_sector_graph_drops_the_numbers_of_other_edges():
    data = Data(x=torch.zeros(4, 1), edge_index=torch.tensor([[0], [2]]))
    data.edge_attr = torch.ones(1, 4)
    assert "edge_attr" not in SectorGraph(grid(2, 2, 0.002))(data)


def test_sector_graph_bad_input():
    with pytest.raises(ValueError, match=r"4 taxels"):
        SectorGraph(grid(2, 2, 0.002))(Data(x=torch.zeros(5, 1)))
    with pytest.raises(ValueError, match=r"'num_sectors' must be at least 1 \(got 0\)"):
        SectorGraph("biotac_sp", 0)
