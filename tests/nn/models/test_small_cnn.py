import pytest
import torch
from small_models import samples

from torch_geometric_tactile.nn import SmallCNN
from torch_geometric_tactile.sensors import TaxelLayout, grid

GRID = grid(4, 5, pitch=0.01)


def small(layout=GRID, **more):
    torch.manual_seed(0)
    return SmallCNN(layout, 3, in_channels=2, widths=(4, 6), hidden_channels=5, **more).eval()


def test_repr_and_number_of_parameters():
    model = small()
    assert str(model) == "SmallCNN(20, 3, in_channels=2, widths=(4, 6), size=(4, 5))"
    conv = 9 * 2 * 4 + 2 * 4 + 9 * 4 * 6 + 2 * 6
    head = 1 * 2 * 6 * 5 + 2 * 5 + 5 * 3 + 3
    assert sum(weight.numel() for weight in model.parameters()) == conv + head


def test_value_by_hand():
    # The kernel of ones sums up the neighbourhood; the map has one column of two taxels.
    layout = grid(2, 1, pitch=0.01)
    model = SmallCNN(layout, 1, in_channels=1, widths=(1,), hidden_channels=1).eval()
    with torch.no_grad():
        for weight in model.parameters():
            weight.fill_(1.0)
        for norm in (model.norms[0], model.norm1):
            norm.bias.zero_()
            norm.eps = 0.0
    x = torch.tensor([[[1.0], [2.0]], [[-4.0], [1.0]]])
    assert model(x).view(-1).tolist() == [3.0 + 1.0, 0.0 + 1.0]


def test_taxels_are_where_the_map_has_them():
    order = torch.randperm(20, generator=torch.Generator().manual_seed(0))
    turned = TaxelLayout("turned", GRID.pos[order], image_map=GRID.image_map[order])
    x = samples(3, 20, 2)
    assert torch.allclose(small(turned)(x[:, order]), small()(x), atol=1e-6)


@pytest.mark.parametrize("rows", [1, 2, 3, 7])
@pytest.mark.parametrize("cols", [1, 5])
def test_maps_of_any_size_are_halved(rows, cols):
    assert small(grid(rows, cols, 0.01))(torch.zeros(2, rows * cols, 2)).shape == (2, 3)


def test_eight_widths_are_the_most():
    assert SmallCNN(GRID, 2, widths=[1] * 8)(torch.zeros(2, 20, 3)).shape == (2, 2)
    with pytest.raises(ValueError, match="'widths' must be 1 to 8 positive numbers"):
        SmallCNN(GRID, 2, widths=[1] * 9)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: small()(torch.zeros(2, 19, 2)), "'x' must have 20 taxels and 2 channels"),
        (lambda: small()(torch.zeros(2, 20, 1)), r"got shape \(2, 20, 1\)"),
        (lambda: small()(torch.zeros(2, 40, 2)), r"got shape \(2, 40, 2\)"),
        (lambda: small()(torch.zeros(20)), r"got shape \(20,\)"),
    ],
)
def test_bad_input_is_refused(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_maps_stay_in_channels_last_format_with_weights_of_any(tmp_path):
    torch.manual_seed(0)
    model = SmallCNN(grid(8, 8, pitch=0.01), 3, in_channels=1).eval()
    plain = {name: value.contiguous() for name, value in model.state_dict().items()}
    torch.save(plain, tmp_path / "a.pt")
    other = SmallCNN(grid(8, 8, pitch=0.01), 3, in_channels=1).eval()
    other.load_state_dict(torch.load(tmp_path / "a.pt", weights_only=True))
    formats = []
    other.norms[1].register_forward_hook(lambda norm, given, out: formats.append(out))
    x = torch.randn(4, 64, 1)
    assert other(x).allclose(model(x), atol=1e-6)
    assert formats[0].is_contiguous(memory_format=torch.channels_last)
