import pytest
import torch
from small_models import samples
from torch.nn.functional import avg_pool2d, max_pool2d

from torch_geometric_tactile.nn import SectorConv, TaxelPool
from torch_geometric_tactile.sensors import allegro_uskin, biotac_sp, grid, layout_sectors


def test_taxel_pool_repr():
    assert str(TaxelPool("biotac_sp", "patch", "mean")) == (
        "TaxelPool(24, 1, by='patch', aggr='mean')"
    )
    assert str(TaxelPool(grid(2, 2, 0.1), [0.2, 0.1])) == (
        "TaxelPool(4, 2, by=(0.2, 0.1), aggr='max')"
    )


@pytest.mark.parametrize(("aggr", "theirs"), [("max", max_pool2d), ("mean", avg_pool2d)])
@pytest.mark.parametrize("size", [(4, 6), (5, 7), (1, 3)])
def test_taxel_pool_on_a_grid_is_pooling(size, aggr, theirs):
    x = samples(3, size[0] * size[1], 2)
    image = x.transpose(1, 2).unflatten(2, size)
    more = {"count_include_pad": False} if aggr == "mean" else {}
    expected = theirs(image, 2, ceil_mode=True, **more).flatten(2).transpose(1, 2)
    out = TaxelPool(grid(*size, pitch=0.002), 0.004, aggr)(x)
    assert torch.allclose(out, expected, atol=1e-6)


@pytest.mark.parametrize("aggr", ["max", "mean"])
def test_taxel_pool_patches(aggr):
    layout, x = allegro_uskin(), samples(3, 384, 2)
    pool = TaxelPool(layout, "patch", aggr)
    parts = [x[:, layout.patch == layout.patch.unique()[i]] for i in range(22)]
    expected = torch.stack([p.amax(1) if aggr == "max" else p.mean(1) for p in parts], 1)
    assert torch.allclose(pool(x), expected, atol=1e-6)
    assert pool.coarse.num_taxels == pool.num_clusters == 22


@pytest.mark.parametrize("aggr", ["max", "mean"])
def test_taxel_pool_gradients(aggr):
    # Four and three taxels: the free place of the second counts for nothing.
    pool, x = TaxelPool(grid(1, 7, 0.001), 0.004, aggr), samples(7, 1).requires_grad_()
    pool(x).sum().backward()
    first, second = x.detach()[:4], x.detach()[4:]
    if aggr == "max":
        expected = torch.cat([(part == part.amax()).float() for part in (first, second)])
    else:
        expected = torch.tensor([0.25] * 4 + [1 / 3] * 3).view(7, 1)
    assert torch.allclose(x.grad, expected)


@pytest.mark.parametrize("aggr", ["max", "mean"])
def test_convolution_of_pooled_taxels(aggr):
    pool = TaxelPool("biotac_sp", 0.01, aggr)
    edges = layout_sectors(pool.coarse)
    conv = SectorConv(2, 3)
    for batch_size in (2, 9):
        x = samples(batch_size, 24, 2)
        assert conv(pool(x), *edges).shape == (batch_size, pool.num_clusters, 3)


def test_taxel_pool_on_the_meta_device():
    # The layout keeps its numbers where the weights have none.
    layout = biotac_sp()
    with torch.device("meta"):
        pool = TaxelPool(layout, 0.01)
    assert torch.equal(pool(samples(2, 24, 3)), TaxelPool(layout, 0.01)(samples(2, 24, 3)))


def test_taxel_pool_bad_input():
    with pytest.raises(ValueError, match=r"'aggr' must be 'max' or 'mean' \(got 'sum'\)"):
        TaxelPool("biotac_sp", "patch", "sum")
    with pytest.raises(ValueError, match=r"'by' must be 'patch', 'digit' or lengths"):
        TaxelPool("biotac_sp", "finger")
    pool = TaxelPool("biotac_sp", "patch")
    for size in ((23, 1), (2, 48, 1), (24,), (1, 2, 24, 1)):
        with pytest.raises(ValueError, match=r"'x' must have 24 taxels, like the layout \(got"):
            pool(torch.zeros(size))
