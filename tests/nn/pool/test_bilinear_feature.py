import pytest
import torch

from torch_geometric_tactile.nn import BilinearFeature

DTYPES = [torch.float, torch.double]


def maps(*size, dtype=torch.double):
    return torch.randn(size, generator=torch.Generator().manual_seed(0), dtype=dtype)


def test_value_by_hand():
    # Columns (2, 0, 0) and (1, 1, -4) of three rows: their products are 4, 2 and 18.
    x = torch.tensor([[2.0, 1.0], [0.0, 1.0], [0.0, -4.0]], dtype=torch.double)
    layer = BilinearFeature(eps=0.5)
    phi = torch.tensor([[4 / 3 + 0.5, 2 / 3], [2 / 3, 6.5]], dtype=torch.double)
    assert torch.allclose(layer.products(x), phi)
    root = (phi + 1e-8).sqrt()
    norm = (4 / 3 + 0.5 + 2 * 2 / 3 + 6.5 + 4e-8) ** 0.5
    assert torch.allclose(layer(x), root / norm)


def test_negative_products_keep_their_sign():
    out = BilinearFeature(eps=1.0)(torch.tensor([[3.0, -3.0]]))
    assert torch.allclose(
        out * out[0, 0].reciprocal(), torch.tensor([[1, -(0.9**0.5)], [-(0.9**0.5), 1]])
    )


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("size", [(5, 16, 28, 28), (2, 3, 4, 7), (7, 4), (1, 1)])
def test_products_are_symmetric_and_positive_semi_definite(size, dtype):
    phi = BilinearFeature().products(maps(*size, dtype=dtype))
    assert phi.dtype == dtype
    assert phi.shape == (*size[:-2], size[-1], size[-1])
    assert torch.allclose(phi, phi.mT, atol=1e-6)
    assert torch.linalg.eigvalsh(phi.double()).min() > 0


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("size", [(5, 16, 28, 28), (2, 3, 4, 7), (7, 4)])
def test_output_is_symmetric_and_each_map_has_norm_one(size, dtype):
    x = maps(*size, dtype=dtype)
    out = BilinearFeature()(x)
    assert torch.allclose(out, out.mT, atol=1e-6)
    norm = out.flatten(-2).norm(dim=-1)
    assert torch.allclose(norm, torch.ones_like(norm))
    # Its own norm, not that of all maps: the strength of another map makes no difference.
    if len(size) == 4:
        x[:, 1:] *= 7.0
        assert torch.allclose(BilinearFeature()(x)[:, 0], out[:, 0])


def test_order_of_the_rows_makes_no_difference_and_that_of_the_columns_carries_over():
    x, layer = maps(3, 5, 4), BilinearFeature()
    order = torch.tensor([2, 0, 3, 1])
    assert torch.allclose(layer(x.flip(1)), layer(x))
    assert torch.allclose(layer(x[..., order]), layer(x)[:, order][..., order])


@pytest.mark.parametrize("dtype", DTYPES)
def test_gradients_are_finite_where_maps_are_zero(dtype):
    x = torch.zeros(2, 3, 6, 5, dtype=dtype)
    x[1, 0, 2, 3] = 1e-12
    x[1, 1] = maps(6, 5, dtype=dtype).relu()
    x.requires_grad_()
    layer = BilinearFeature()
    out = layer(x)
    assert torch.allclose(out[0, 0], torch.eye(5, dtype=dtype) / 5**0.5)
    (grad,) = torch.autograd.grad((out * maps(*out.shape, dtype=dtype)).sum(), x)
    assert out.isfinite().all()
    assert grad.isfinite().all()
    assert grad[1, 1].abs().max() > 0


def test_gradients_are_those_of_the_formula():
    x = (maps(2, 4, 3).abs() + 0.1).requires_grad_()
    assert torch.autograd.gradcheck(BilinearFeature(eps=0.1), x)


@pytest.mark.parametrize("eps", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_eps_is_refused(eps):
    with pytest.raises(ValueError, match=r"'eps' must be positive and finite \(got "):
        BilinearFeature(eps)


@pytest.mark.parametrize("size", [(), (4,), (2, 0, 4), (2, 4, 0)])
def test_bad_maps_are_refused(size):
    with pytest.raises(ValueError, match=r"'x' must have rows and columns \(got shape "):
        BilinearFeature()(torch.zeros(size))
