import copy

import pytest
import torch
from plain_models import GRID as SMALL
from plain_models import TAXEL_NETS as MODELS
from plain_models import given, trained
from plain_models import taxel_net as small
from small_models import samples

from torch_geometric_tactile.nn import SelfGCNConv, SmallCNN, TaxelNet
from torch_geometric_tactile.nn.models._taxel_levels import (
    ReadingNorm,
    TaxelNorm,
    layout_pools,
    pitch,
)
from torch_geometric_tactile.nn.models._taxels import taxel_mask
from torch_geometric_tactile.sensors import (
    TaxelLayout,
    allegro_uskin,
    biotac_sp,
    grid,
    taxel_descriptors,
)


def num_parameters(module):
    return sum(parameter.numel() for parameter in module.parameters())


def test_taxel_net_repr():
    assert str(small("pooled")) == (
        "TaxelNet(20, 3, in_channels=3, widths=(4, 6, 6), taxels=(20, 6, 2), head='all')"
    )
    assert str(small("direct")) == (
        "TaxelNet(20, 3, in_channels=3, widths=(4,), taxels=(20,), head='flat', num_joints=2)"
    )


def test_taxel_net_parameter_count():
    def sector(before, after, sectors=8):
        return (1 + sectors) * before * after + 2 * after  # with the normalisation

    def head(width, classes, hidden=64):
        return width * hidden + 2 * hidden + hidden * classes + classes

    blocks = sector(3, 32) + sector(32, 32)
    assert num_parameters(TaxelNet("biotac_sp", 2, direct_channels=0)) == (
        blocks + head(24 * 32 + 64, 2)
    )
    direct = 24 * 3 * 128 + 2 * 128  # where nothing is pooled
    assert num_parameters(TaxelNet("biotac_sp", 2)) == blocks + direct + head(24 * 32 + 192, 2)
    blocks = sector(3, 4) + sector(4, 6) + sector(6, 6) + 2 * sector(6, 6)
    assert num_parameters(small("pooled")) == blocks + head(2 * 6 + 12, 3)
    blocks = 2 * 3 * 4 + 8 + 2 * 4 * 4 + 8
    assert num_parameters(small("self")) == blocks + head(4, 3)
    assert num_parameters(small("difference")) == 2 * 3 * 4 + 8 + head(4, 3)
    blocks = sector(3, 4, 6) + sector(4, 4, 6) + 20 * 3 * 5 + 10
    assert num_parameters(small("direct")) == blocks + head(20 * 4 + 5 + 2, 3)


def test_taxel_net_reads_the_descriptors_of_scaled_readings():
    model = small("described").eval()
    descriptors = model.described
    x = given(model, 6)["x"]
    found = descriptors(model.norm(x))
    expected = taxel_descriptors(model.norm(x), biotac_sp())
    rows = descriptors.norm_out(descriptors.lin(descriptors.norm(expected.unsqueeze(1))[:, 0]))
    torch.testing.assert_close(found, rows.relu())
    assert found.shape == (len(x), 3)
    missing = x.clone()
    missing[:, 2] = torch.nan
    seen = torch.ones(len(x), 24, dtype=torch.bool)
    seen[:, 2] = False
    assert descriptors(x, seen).equal(descriptors(missing))  # a dropped taxel is a missing one
    assert not any("cells" in name for name in model.state_dict())  # of the layout, not weights


@pytest.mark.parametrize("difference", [False, True])
def test_taxel_net_blocks_are_of_the_chosen_operator(difference):
    model = TaxelNet(grid(2, 2, 0.01), 2, conv="difference" if difference else "self")
    found = [layer.difference for layer in model.modules() if isinstance(layer, SelfGCNConv)]
    assert found
    assert {*found} == {difference}


def test_taxel_net_levels_follow_from_the_layout():
    sizes = {
        "biotac_sp": (24,),
        grid(8, 8, 0.01): (64,),
        grid(28, 50, 0.005): (1400, 350, 91, 24),
    }
    for layout, expected in sizes.items():
        assert TaxelNet(layout, 2, in_channels=1).taxels == expected
    hand = TaxelNet(allegro_uskin(), 2)
    assert hand.taxels[0] == 384
    assert 22 <= hand.taxels[-1] <= 64
    assert hand.widths == (16, 32, 64)
    assert TaxelNet("biotac_sp", 2).widths == (32,)


def test_taxel_net_pools_once_more_before_the_head():
    model = small("pyramid")
    assert model.taxels == (20, 6, 2)
    assert [len(level.blocks) for level in model.levels] == [1, 1]
    assert model.lin.in_features == (2 + 2) * 4  # two taxels, their mean and their maximum
    small_sensor = TaxelNet("biotac_sp", 2, head_taxels=24)
    assert small_sensor.taxels == (24,)


def test_taxel_net_on_a_grid_computes_the_features_of_a_cnn():
    """With the weights of a convolutional network, and its poolings."""
    layout = grid(8, 8, 0.004)
    cnn = SmallCNN(layout, 3, in_channels=2, widths=(4, 6)).eval()
    sizes = {"widths": (4, 6), "max_taxels": 32, "head_taxels": 8, "depth": 1}
    net = TaxelNet(layout, 3, in_channels=2, direct_channels=0, **sizes).eval()
    assert net.taxels == (64, 16, 4)
    for level, conv, norm in zip(net.levels, cnn.convs, cnn.norms, strict=True):
        (block,) = level.blocks
        on = layout if level.pool is None else level.pool.coarse
        middle = int((on.pos - on.pos.mean(dim=0)).norm(dim=1).argmin())
        weight = torch.zeros(9, *conv.weight.shape[1::-1])
        cells = (on.pos[:, :2] / (on.pos[1] - on.pos[0]).norm()).round().int()
        source, target = level.edge_index
        for edge in (target == middle).nonzero().view(-1).tolist():
            across, up = (cells[source[edge]] - cells[middle]).tolist()
            place = conv.weight[:, :, 1 + up, 1 + across]
            weight[1 + level.sector[edge]] = place.t().detach()
        weight[0] = conv.weight[:, :, 1, 1].t().detach()
        block.conv.weight.data.copy_(weight.view_as(block.conv.weight))
        block.norm.load_state_dict(norm.state_dict())
    x = samples(5, 64, 2)
    h = cnn.image(x)
    for conv, norm in zip(cnn.convs, cnn.norms, strict=True):
        h = torch.nn.functional.max_pool2d(norm(conv(h)).relu(), 2)
    features = x
    for level in net.levels:
        features = level(features)
    for pool in net.head_pools:
        features = pool(features)
    expected = h.flatten(2).transpose(1, 2)
    assert features.allclose(expected, atol=1e-5)


def test_taxel_net_pools_two_by_two_whatever_the_pitch():
    stretched = grid(6, 6, pitch=0.002)
    layout = TaxelLayout("wide", stretched.pos * torch.tensor([1.0, 2.0, 1.0]))
    assert pitch(layout) == pytest.approx((0.002, 0.004))
    (pool,) = layout_pools(layout, 9)
    assert pool.num_clusters == 9
    lone = TaxelLayout(
        "lone", stretched.pos, patch=torch.arange(36), patch_names=tuple(map(str, range(36)))
    )
    assert layout_pools(lone, 9) == []  # patches of a single taxel


def test_taxel_net_by_hand():
    # One taxel, whose weights of itself alone count.
    model = TaxelNet(
        grid(1, 1, 0.001), 1, in_channels=1, widths=(1,), head="mean", direct_channels=0
    )
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.fill_(1.0)
    model.eval()
    eps = (1 + 1e-5) ** -0.5
    h = 3.0 * (1 + 1e-6) ** -0.5
    for _ in range(2):  # blocks, both with a residual
        h = max(0.0, h + (h * eps + 1))
    hidden = max(0.0, h * eps + 1)
    out = model(torch.tensor([[[3.0]]]))
    assert out.item() == pytest.approx(64 * hidden + 1, rel=1e-5)


@pytest.mark.parametrize("name", MODELS)
def test_taxel_net_gradients(name):
    found = []
    for fast in (True, False):
        model = small(name, fast=fast, dropout=0.0).double()
        data = {key: value.double() for key, value in given(model, 9).items()}
        out = model(**data)  # with the statistics of the batch
        found.append(torch.autograd.grad(out.square().sum(), list(model.parameters())))
    for ours, theirs in zip(*found, strict=True):
        assert torch.allclose(ours, theirs, rtol=1e-6, atol=1e-9)
    assert all(grad.abs().max() > 0 for grad in found[0])


def test_taxel_net_numbering_of_the_taxels_does_not_matter():
    order = torch.randperm(20, generator=torch.Generator().manual_seed(0))
    renumbered = TaxelLayout("renumbered", SMALL.pos[order], SMALL.normal[order])
    model = trained(small("pooled", head="max"))
    other = small("pooled", head="max", layout=renumbered).eval()
    other.load_state_dict(model.state_dict())
    x = given(model, 9)["x"]
    assert torch.allclose(other(x[:, order]), model(x), atol=1e-5)


def test_taxel_net_scale_of_the_readings_does_not_matter():
    # Raw counts of two channels, trained on a single batch.
    scale, offset = torch.tensor([1.0, 50.0, 1000.0]), torch.tensor([0.0, 300.0, 30_000.0])
    found = []
    for factor, shift in ((1.0, 0.0), (scale, offset)):
        model, x = (
            small("pooled", dropout=0.0, taxel_dropout=0.0).double(),
            samples(16, 20, 3, dtype=torch.double),
        )
        found += [model(x * factor + shift), model.eval()(x * factor + shift)]
    assert torch.allclose(found[0], found[2], atol=1e-3)
    # A single batch has set the scale by which evaluation goes.
    assert torch.allclose(found[1], found[3], atol=1e-3)


def test_reading_norm_averages_batches():
    norm, parts = ReadingNorm(2), [samples(5, 4, 2, seed=i) * (1 + i) + 9 for i in range(3)]
    for part in parts:
        out = norm(part)
        assert torch.allclose(out.mean(dim=(0, 1)), torch.zeros(2), atol=1e-5)
        assert torch.allclose(out.std(dim=(0, 1), correction=0), torch.ones(2), atol=1e-4)
    mean = torch.stack([part.mean(dim=(0, 1)) for part in parts]).mean(dim=0)
    assert torch.allclose(norm.running_mean, mean, atol=1e-5)
    expected = (parts[0] - mean) * norm.running_var.rsqrt()
    assert torch.allclose(norm.eval()(parts[0]), expected, atol=1e-4)


def test_taxel_norm():
    norm, x = TaxelNorm(2), samples(5, 4, 2)
    out = norm(x)
    assert torch.allclose(out.mean(dim=(0, 1)), torch.zeros(2), atol=1e-6)
    assert torch.allclose(out.std(dim=(0, 1), correction=0), torch.ones(2), atol=1e-4)
    theirs = torch.nn.BatchNorm1d(2)
    assert torch.allclose(out, theirs(x.flatten(0, 1)).view_as(x), atol=1e-6)
    assert torch.equal(norm.running_var, theirs.running_var)
    before = norm.running_mean.clone()
    one = norm(x[:1, 0])  # a single row: as in evaluation
    assert torch.equal(norm.running_mean, before)
    assert torch.allclose(one, norm.eval()(x[:1, 0]))


@pytest.mark.parametrize("norm", [ReadingNorm, TaxelNorm])
def test_norms_measure_the_rows_that_are_kept(norm):
    kept, x = torch.arange(20).view(5, 4, 1) % 3 == 0, samples(5, 4, 2)
    some, alone = norm(2), norm(2)
    x[~kept.squeeze(-1)] = 1e6
    for scale in (1.0, 2.0):
        expected = alone(scale * x[kept.squeeze(-1)].unsqueeze(1))
        out = some(scale * x, kept)
        assert torch.allclose(out[kept.squeeze(-1)], expected.squeeze(1), atol=1e-5)
    for name, value in alone.state_dict().items():
        assert torch.allclose(some.state_dict()[name], value, atol=1e-5), name
    before = copy.deepcopy(some.state_dict())
    for number in (0, 1):  # nothing to measure: as in evaluation
        out = some(x, torch.arange(20).view(5, 4, 1) < number)
        assert torch.allclose(out, copy.deepcopy(some).eval()(x), rtol=1e-4)
        assert all(torch.equal(value, before[name]) for name, value in some.state_dict().items())


def test_taxel_net_state_is_weights_and_statistics():
    assert {name.split(".")[-1] for name in small().state_dict()} == {
        "weight",
        "bias",
        "running_mean",
        "running_var",
        "num_batches_tracked",
    }


def test_taxel_net_on_the_meta_device():
    with torch.device("meta"):
        model = TaxelNet(SMALL, 3, max_taxels=2)
    assert model.lin.weight.is_meta
    assert model.levels[0].edge_index.max() == 19


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"conv": "gcn"}, r"'conv' must be one of \('sector', 'self', .*\(got 'gcn'\)"),
        ({"head": "sum"}, r"'head' must be one of \('flat', 'mean', .*\(got 'sum'\)"),
    ],
)
def test_taxel_net_bad_argument(arguments, match):
    with pytest.raises(ValueError, match=match):
        small(**arguments)


@pytest.mark.parametrize(
    ("size", "match"),
    [
        ((5, 20, 2), r"'x' must have 3 features \(got shape"),
        ((5, 19, 3), r"'x' must have 20 taxels in each sample \(got shape"),
        ((2, 20, 3), r"'joint' must be given"),
    ],
)
def test_taxel_net_bad_input(size, match):
    with pytest.raises(ValueError, match=match):
        small("direct")(torch.zeros(size))


@pytest.mark.parametrize("name", ["pooled", "direct"])
def test_taxel_net_taxel_dropout(name):
    model = small(name, taxel_dropout=0.5, dropout=0.0)
    data = given(model, 16)
    assert not torch.equal(model(**data), model(**data))
    model.eval()
    assert torch.equal(model(**data), model(**data))
    whole = small(name, taxel_dropout=0.0, dropout=0.0)
    assert torch.equal(whole(**data), whole(**data))


@pytest.mark.parametrize("name", ["pooled", "direct"])
def test_taxel_net_does_not_see_dropped_taxels(name):
    """No gradient reaches their readings, in the convolutions or in the direct way."""
    model = small(name, taxel_dropout=0.5, dropout=0.0)
    model.norm = torch.nn.Identity()
    if model.direct is not None:
        model.norm_readings = torch.nn.Identity()
    data = given(model, 16)
    data["x"].requires_grad_()
    torch.manual_seed(0)
    model(**data).square().sum().backward()
    torch.manual_seed(0)
    seen = taxel_mask(data["x"], 0.5)
    found = data["x"].grad.abs().sum(dim=-1)
    assert float(found[~seen].abs().max()) == 0
    assert float((found[seen] > 0).double().mean()) > 0.9
