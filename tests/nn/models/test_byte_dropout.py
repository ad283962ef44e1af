import pytest
import torch

from torch_geometric_tactile.nn.models._taxel_levels import ByteDropout


@pytest.mark.parametrize("p", [0.1, 0.3, 0.5, 0.9])
def test_byte_dropout_drops_as_many_and_keeps_the_mean(p):
    torch.manual_seed(0)
    out = ByteDropout(p)(torch.ones(1000, 999))
    assert float((out == 0).float().mean()) == pytest.approx(p, abs=0.003)
    assert float(out.mean()) == pytest.approx(1.0, rel=0.01)
    assert len(out.unique()) == 2
    # Each of the eight draws of a number, and neighbours, are independent.
    zero = (out.view(-1)[: 999_000 // 8 * 8].view(-1, 8) == 0).double()
    assert zero.mean(dim=0).sub(p).abs().max() < 0.006
    assert torch.corrcoef(zero.t()).fill_diagonal_(0).abs().max() < 0.012


def test_byte_dropout_is_of_the_seed():
    x, drop = torch.randn(3, 5), ByteDropout(0.5)
    torch.manual_seed(1)
    first, second = drop(x), drop(x)
    torch.manual_seed(1)
    assert torch.equal(drop(x), first)
    assert not torch.equal(first, second)


def test_byte_dropout_gradient_is_the_mask():
    x = torch.randn(40, 7, dtype=torch.float64, requires_grad=True)
    out = ByteDropout(0.25)(x)
    (grad,) = torch.autograd.grad(out.sum(), x)
    assert torch.allclose(out, x * grad)
    assert set(grad.unique().tolist()) == {0.0, 256 / 192}


def test_byte_dropout_leaves_evaluation_alone():
    x = torch.randn(4, 3)
    assert torch.equal(ByteDropout(0.5).eval()(x), x)
    assert torch.equal(ByteDropout(0.0)(x), x)
    assert ByteDropout(0.5)(torch.zeros(0, 3)).shape == (0, 3)
    assert str(ByteDropout(0.5)) == "ByteDropout(p=0.5, inplace=False)"
