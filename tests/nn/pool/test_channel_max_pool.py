import pytest
import torch

from torch_geometric_tactile.nn.pool import ChannelMaxPool


def test_channel_max_pool_by_hand():
    x = torch.tensor([[1.0, -4.0, -3.0, -2.0, 0.0, 5.0], [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]])
    assert torch.equal(ChannelMaxPool(2)(x), torch.tensor([[1.0, -2.0, 5.0], [6.0, 4.0, 2.0]]))
    assert torch.equal(ChannelMaxPool(3)(x), torch.tensor([[1.0, 5.0], [6.0, 3.0]]))
    assert torch.equal(ChannelMaxPool(1)(x), x)
    assert ChannelMaxPool(2)(x[None, None]).shape == (1, 1, 2, 3)


def test_channel_max_pool_gradient():
    x = torch.tensor([[1.0, 4.0, 3.0, 2.0]], requires_grad=True)
    ChannelMaxPool(2)(x).backward(torch.tensor([[5.0, 7.0]]))
    assert torch.equal(x.grad, torch.tensor([[0.0, 5.0, 7.0, 0.0]]))


def test_channel_max_pool_is_of_each_taxel():
    x, order = torch.rand(7, 6), torch.randperm(7)
    assert torch.equal(ChannelMaxPool(3)(x[order]), ChannelMaxPool(3)(x)[order])


def test_channel_max_pool_bad_channels():
    with pytest.raises(ValueError, match=r"'x' must have a multiple of 4 channels \(got 6\)"):
        ChannelMaxPool(4)(torch.zeros(5, 6))


@pytest.mark.parametrize("dim", [1, -3])
def test_channel_max_pool_of_another_dimension(dim):
    pool = ChannelMaxPool(2, dim)
    assert str(pool) == f"ChannelMaxPool(2, dim={dim})"
    x = torch.arange(24.0).view(1, 4, 3, 2)
    assert torch.equal(pool(x), x[:, 1::2])
    with pytest.raises(ValueError, match=r"'x' must have a multiple of 2 channels \(got 3\)"):
        pool(x[:, :3])
