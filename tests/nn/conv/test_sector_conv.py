import pytest
import torch
from small_models import samples
from torch_geometric.data import Batch, Data
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks

from torch_geometric_tactile.nn import SectorConv
from torch_geometric_tactile.nn.conv import sector_conv
from torch_geometric_tactile.sensors import biotac_sp, grid, layout_sectors, sector_edges

EDGES, SECTOR = layout_sectors(biotac_sp())
# The cell of a 3 x 3 kernel of each weight: rows along y, columns along x, itself first.
CELLS = [(1, 1), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0), (0, 1), (0, 2)]


def conv(in_channels=3, out_channels=5, dtype=torch.float, **kwargs):
    torch.manual_seed(0)
    layer = SectorConv(in_channels, out_channels, **kwargs).to(dtype)
    if layer.bias is not None:
        torch.nn.init.normal_(layer.bias)
    return layer


def one_by_one(layer, x, edge_index=EDGES, sector=SECTOR):
    """The formula, edge by edge."""
    out = x @ layer.weight[0]
    for source, target, s in zip(*edge_index.tolist(), sector.tolist(), strict=True):
        out[..., target, :] = out[..., target, :] + x[..., source, :] @ layer.weight[1 + s]
    return out if layer.bias is None else out + layer.bias


def grads(layer, x, *edges):
    x = x.clone().requires_grad_()
    out = layer(x, *edges)
    return out.detach(), *torch.autograd.grad(out.square().sum(), [x, *layer.parameters()])


@pytest.fixture
def count_fast(monkeypatch):
    calls, product = [], sector_conv._sector_product
    monkeypatch.setattr(
        sector_conv, "_sector_product", lambda *args: calls.append(1) or product(*args)
    )
    return calls


def test_sector_conv_by_hand():
    layer = SectorConv(1, 1, num_sectors=2)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor([1.0, 10.0, 100.0]).view(3, 1, 1))
        layer.bias.fill_(0.5)
    # 1 is in sector 0 of 0, and 0 in sector 1 of 1; 2 is alone.
    edge_index, sector = torch.tensor([[1, 0], [0, 1]]), torch.tensor([0, 1])
    x, expected = torch.tensor([[2.0], [3.0], [7.0]]), torch.tensor([[32.5], [203.5], [7.5]])
    for form in (x, x[None], x.expand(9, 3, 1)):
        assert torch.allclose(layer(form, edge_index, sector), expected)


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("size", [(5, 7), (2, 2), (1, 4), (3, 1)])
def test_sector_conv_on_a_grid_is_a_convolution(size, ratio, fast):
    layout = grid(*size, pitch=0.002)
    edges = sector_edges(layout.pos * torch.tensor([1.0, ratio, 1.0]), layout.axes())
    layer = conv(3, 4, torch.double, fast=fast)
    image = torch.nn.Conv2d(3, 4, 3, padding=1).double()
    with torch.no_grad():
        for weight, (row, col) in zip(layer.weight, CELLS, strict=True):
            image.weight[:, :, row, col] = weight.t()
        image.bias.copy_(layer.bias)
    x = samples(9, layout.num_taxels, 3, dtype=torch.double)
    expected = image(x.transpose(1, 2).unflatten(2, size)).flatten(2).transpose(1, 2)
    assert torch.allclose(layer(x, *edges), expected, atol=1e-12)


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("channels", [(3, 5), (5, 3)])
def test_sector_conv_equals_the_formula(channels, bias, fast):
    layer, x = conv(*channels, bias=bias, fast=fast), samples(9, 24, channels[0])
    expected = one_by_one(layer, x)
    assert torch.allclose(layer(x, EDGES, SECTOR), expected, atol=1e-5)
    assert torch.allclose(layer(x[:2], EDGES, SECTOR), expected[:2], atol=1e-5)
    assert torch.allclose(layer(x[3], EDGES, SECTOR), expected[3], atol=1e-5)


@pytest.mark.parametrize("block_bytes", [0, 1, 2**12, 2**19])
def test_sector_conv_gradients(block_bytes, monkeypatch):
    monkeypatch.setattr(sector_conv, "_BLOCK_BYTES", block_bytes)
    for name in ("_COPY_BYTES", "_NARROW_COPY_BYTES"):
        monkeypatch.setattr(sector_conv, name, 0 if block_bytes else 2**22)
    fast, slow = (conv(dtype=torch.double, fast=fast) for fast in (True, False))
    x = samples(9, 24, 3, dtype=torch.double)
    for ours, theirs in zip(
        grads(fast, x, EDGES, SECTOR), grads(slow, x, EDGES, SECTOR), strict=True
    ):
        assert theirs.abs().max() > 0
        assert torch.allclose(ours, theirs, rtol=1e-9)


def test_sector_conv_several_in_a_sector_add_up():
    edge_index, sector = torch.tensor([[1, 2, 0], [0, 0, 2]]), torch.tensor([3, 3, 0])
    x = samples(9, 4, 3)
    for fast in (True, False):
        layer = conv(fast=fast)
        expected = one_by_one(layer, x, edge_index, sector)
        assert torch.allclose(layer(x, edge_index, sector), expected, atol=1e-5)


def test_sector_conv_fast_only_where_nothing_watches(count_fast):
    x = samples(9, 24, 3)
    conv()(x, EDGES, SECTOR)
    assert len(count_fast) == 1
    seen, hooked, own = [], conv(), conv()
    hooked.register_propagate_forward_hook(lambda *args: seen.append(1))

    class Doubled(SectorConv):
        def message(self, x_j):
            return 2 * x_j

    doubled = Doubled(3, 5)
    own.message = lambda x_j: 2 * x_j
    for layer in (hooked, doubled, own, conv(fast=False)):
        assert layer(x, EDGES, SECTOR).shape == (9, 24, 5)
    conv()(x.requires_grad_()[0], EDGES, SECTOR)
    assert len(count_fast) == len(seen) == 1
    assert not torch.allclose(doubled(x, EDGES, SECTOR), conv()(x, EDGES, SECTOR), atol=1e-2)


def test_sector_conv_fast_for_few_samples_of_few_taxels(count_fast, monkeypatch):
    layer, x = conv(), samples(9, 24, 3)
    expected = layer(x, EDGES, SECTOR)
    for size in (1, 7):
        assert torch.allclose(layer(x[:size], EDGES, SECTOR), expected[:size], atol=1e-6)
    assert len(count_fast) == 3
    monkeypatch.setattr(sector_conv, "_NARROW_COPY_BYTES", 0)  # as if there were many taxels
    assert torch.allclose(layer(x[:7], EDGES, SECTOR), expected[:7], atol=1e-6)
    assert len(count_fast) == 3
    layer(x, EDGES, SECTOR)
    assert len(count_fast) == 4


def test_sector_conv_explainer_masks():
    layer, x = conv(), samples(9, 24, 3)
    expected = layer(x, EDGES[:, :4], SECTOR[:4])
    mask = torch.full((len(SECTOR),), -50.0)
    mask[:4] = 50.0
    set_masks(layer, mask, EDGES)
    assert torch.allclose(layer(x, EDGES, SECTOR), expected, atol=1e-5)
    clear_masks(layer)
    assert torch.allclose(layer(x, EDGES, SECTOR), one_by_one(layer, x), atol=1e-5)


def test_sector_conv_autocast():
    layer, x = conv(), samples(9, 24, 3)
    with torch.autocast("cpu", torch.bfloat16):
        out = layer(x, EDGES, SECTOR)
    assert torch.equal(out, layer(x, EDGES, SECTOR))  # full precision


def test_sector_conv_bad_flow():
    with pytest.raises(ValueError, match=r"'flow' must be left out.*\(got 'target_to_source'\)"):
        SectorConv(3, 5, flow="target_to_source")


@pytest.mark.parametrize("batch_size", [2, 9])
def test_sector_conv_bad_input(batch_size):
    layer, x = conv(), samples(batch_size, 24, 3)
    bad = [
        ((x, EDGES, SECTOR[:-1]), r"'edge_sector' must have shape \(\d+,\), one sector per edge"),
        ((x, EDGES, SECTOR.float()), r"'edge_sector' must hold integers \(got torch.float32\)"),
        ((x, EDGES, SECTOR + 1), r"'edge_sector' must hold sectors from 0 to 7 \(got 1 to 8\)"),
        ((x, EDGES, SECTOR - 1), r"'edge_sector' must hold sectors from 0 to 7 \(got -1 to 6\)"),
    ]
    for arguments, match in bad:
        with pytest.raises(ValueError, match=match):
            layer(*arguments)


def test_sector_conv_batch_of_sensors():
    parts = [Data(x=samples(24, 3), edge_index=EDGES, edge_sector=SECTOR)]
    edges = layout_sectors(grid(2, 3, 0.002))
    parts.append(Data(x=samples(6, 3), edge_index=edges.edge_index, edge_sector=edges.sector))
    batch, layer = Batch.from_data_list(parts), conv()
    expected = torch.cat([layer(p.x, p.edge_index, p.edge_sector) for p in parts])
    out = layer(batch.x, batch.edge_index, batch.edge_sector)
    assert torch.allclose(out, expected, atol=1e-6)


def test_sector_conv_refuses_what_it_cannot_do():
    with pytest.raises(ValueError, match=r"'decomposed_layers' must be 1, since .* \(got 2\)"):
        SectorConv(2, 4, decomposed_layers=2)
    assert SectorConv(2, 4, decomposed_layers=1).decomposed_layers == 1


def test_sectors_are_looked_at_once_where_that_waits(monkeypatch):
    class OnGPU(torch.Tensor):
        @property
        def is_cpu(self):
            return False

    looks, aminmax = [], torch.aminmax
    monkeypatch.setattr(torch, "aminmax", lambda x: looks.append(1) or aminmax(x))
    check, sector = sector_conv._SectorCheck(), SECTOR.clone().as_subclass(OnGPU)
    for _ in range(3):
        check(EDGES, sector, 8)
    assert len(looks) == 1
    with pytest.raises(ValueError, match="must hold sectors from 0 to 3"):
        check(EDGES, sector, 4)
    check(EDGES, sector, 8)
    sector[0] = 8  # a write is noticed
    with pytest.raises(ValueError, match=r"must hold sectors from 0 to 7 \(got 0 to 8\)"):
        check(EDGES, sector, 8)


def test_sectors_on_a_processor_are_looked_at_each_time():
    check, array = sector_conv._SectorCheck(), SECTOR.numpy().copy()
    sector = torch.from_numpy(array)
    check(EDGES, sector, 8)
    array[0] = 8  # PyTorch counts no such write
    with pytest.raises(ValueError, match="must hold sectors from 0 to 7"):
        check(EDGES, sector, 8)
