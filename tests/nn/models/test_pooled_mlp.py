import pytest
import torch
from small_models import samples

from torch_geometric_tactile.nn.models import PooledMLP


def test_pooled_mlp_by_hand():
    mlp = PooledMLP(2, 1, (4,), (2,))
    assert str(mlp) == "PooledMLP(2, 1, widths=(4,), pools=(2,))"
    with torch.no_grad():
        mlp.lins[0].weight.copy_(torch.tensor([[1.0, 0], [0, 1.0], [-1.0, 0], [0, -1.0]]))
        mlp.lins[0].bias.zero_()
        mlp.lin_out.weight.copy_(torch.tensor([[1.0, 10.0]]))
        mlp.lin_out.bias.fill_(0.5)
    # The larger of both, and ten times the larger of their negatives, if positive.
    x = torch.tensor([[2.0, 3.0], [-2.0, -3.0], [-4.0, 1.0]])
    assert torch.allclose(mlp(x), torch.tensor([[3.5], [30.5], [41.5]]))
    assert mlp(torch.zeros(0, 2)).shape == (0, 1)


def test_pooled_mlp_logits_are_not_cut():
    mlp = PooledMLP(2, 3, (2,), (1,))
    with torch.no_grad():
        mlp.lin_out.bias.copy_(torch.tensor([-9.0, 0.0, 9.0]))
    out = mlp(samples(50, 2))
    assert out.min() < 0 < out.max()


def test_pooled_mlp_bad_layers():
    with pytest.raises(ValueError, match=r"'pools' must divide 'widths' \(got 4 for 6\)"):
        PooledMLP(4, 2, (6,), (4,))
