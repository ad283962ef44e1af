import pytest
import torch

from torch_geometric_tactile.nn.conv import SectorConv
from torch_geometric_tactile.nn.conv.sector_conv import _SectorImage
from torch_geometric_tactile.sensors import biotac_sp, grid, layout_sectors


def _image(edge_index, sector, num_nodes):
    return _SectorImage.from_edges(*edge_index, sector, num_nodes)


@pytest.mark.parametrize("size", [(3, 3), (4, 7), (1, 5), (2, 3), (6, 3)])
@pytest.mark.parametrize("num_sectors", [4, 8])
def test_sector_image_of_a_grid(size, num_sectors):
    edge_index, sector = layout_sectors(grid(*size, pitch=0.004), num_sectors)
    image = _image(edge_index, sector, size[0] * size[1])
    assert (image.rows, image.cols) == size


def test_sector_image_of_columns():
    # The nodes of a column one after the other: the image lies on its side.
    edge_index, sector = layout_sectors(grid(4, 7, pitch=0.004), 8)
    by_column = torch.arange(28).view(4, 7).t().reshape(-1).argsort()
    image = _image(by_column[edge_index], sector, 28)
    assert (image.rows, image.cols) == (7, 4)


def test_sector_image_of_other_layouts():
    assert _image(*layout_sectors(biotac_sp(), 8), 24) is None
    assert _image(torch.zeros(2, 0, dtype=torch.long), torch.zeros(0, dtype=torch.long), 9) is None
    edge_index, sector = layout_sectors(grid(4, 4, pitch=0.004), 8)
    assert _image(edge_index[:, 1:], sector[1:], 16) is None  # an edge is missing
    twice = torch.cat([edge_index, edge_index[:, :1]], dim=1)
    assert _image(twice, torch.cat([sector, sector[:1]]), 16) is None
    other = sector.clone()
    other[0] = (other[0] + 1) % 8  # two directions in a sector
    assert _image(edge_index, other, 16) is None
    # A ring: what leaves a row on the right comes in on the left.
    ring = torch.stack([(torch.arange(12) + 1) % 12, torch.arange(12)])
    assert _image(ring[:, :11], torch.zeros(11, dtype=torch.long), 12).cols == 12
    assert _image(ring, torch.zeros(12, dtype=torch.long), 12) is None


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("change", ["none", "no_corners", "one_more"])
def test_sector_image_equals_messages(dtype, change):
    torch.manual_seed(0)
    edge_index, sector = layout_sectors(grid(5, 6, pitch=0.004), 8)
    if change == "no_corners":
        kept = sector % 2 == 0
        edge_index, sector = edge_index[:, kept], sector[kept]
    if change == "one_more":
        edge_index = torch.cat([edge_index, torch.tensor([[0], [29]])], dim=1)
        sector = torch.cat([sector, torch.tensor([3])])
    conv = SectorConv(3, 4).to(dtype)
    conv.bias.data.normal_()
    x = torch.randn(9, 30, 3, dtype=dtype)
    out, grads = [], []
    for fast in (True, False):
        conv.fast = fast
        leaf = x.clone().requires_grad_()
        out.append(conv(leaf, edge_index, sector))
        grads.append(torch.autograd.grad(out[-1].sin().sum(), [leaf, *conv.parameters()]))
    table = conv._edge_cache.get(edge_index, sector, 30, 8)
    assert (table.image is None) == (change == "one_more")
    assert torch.allclose(*out, atol=1e-5)
    for one, other in zip(*grads, strict=True):
        assert torch.allclose(one, other, atol=1e-4)
