import copy

import pytest
import torch
from plain_models import GRID, encoder, given
from small_models import samples

from torch_geometric_tactile.nn import TaxelEncoder
from torch_geometric_tactile.nn.models._taxel_kernels import KernelConv, Neighbourhood, places
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, grid, select_taxels


def num_parameters(module):
    return sum(parameter.numel() for parameter in module.parameters())


def test_taxel_encoder_repr():
    assert str(encoder("whole")) == (
        "TaxelEncoder(20, 3, in_channels=3, taxels=(20, 20), embedding_channels=5)"
    )
    assert str(encoder("joined")) == (
        "TaxelEncoder(20, 3, in_channels=3, taxels=(20, 6), embedding_channels=5)"
    )


def test_taxel_encoder_parameter_count():
    width, size, classes = 6, 5, 3
    kernel = 3 * 32 + 32 + 32 * width + width
    lift = (3 + 9) * width + width
    first = kernel + 2 * width + width * width + width
    block = kernel + 2 * width + 2 * (2 * width * width) + 2 * width + width
    attention = (width + 9) * 8 + 8
    head = attention + 12 * width * size + size + 2 * size + size * classes + classes
    expected = lift + first + block + head
    assert num_parameters(encoder("whole")) == expected
    assert num_parameters(encoder("joined")) == expected  # whatever the layout


def test_kernel_conv_by_hand():
    layout = TaxelLayout("row", torch.tensor([[0.0, 0.0], [0.01, 0.0], [0.1, 0.0]]))
    near = Neighbourhood(layout, layout)  # whose pitches are 1, 1 and 9 cm
    one, far = 1 - (1 / 2.2) ** 2, 1 - (10 / 9 / 2.2) ** 2
    window = torch.tensor([[1.0, one, 0.0], [one, 1.0, 0.0], [far, one, 1.0]])
    torch.testing.assert_close(near.share, window / window.sum(dim=1, keepdim=True))
    assert near.index.tolist() == [0, 1, 3, 4, 6, 7, 8]
    expected = torch.tensor([0.0, 1.0, -1.0, 0.0, -10 / 9, -1.0, 0.0])
    torch.testing.assert_close(near.offset[:, 0], expected, rtol=1e-5, atol=1e-5)
    conv, x = KernelConv(2), samples(4, 3, 2)
    weight = conv.place(near.offset) * near.share.flatten()[near.index].unsqueeze(1)
    found = torch.zeros(4, 3, 2)
    for pair, value in zip(near.index.tolist(), weight, strict=True):
        found[:, pair // 3] += value * x[:, pair % 3]
    torch.testing.assert_close(conv(x, near), found)
    seen = torch.tensor([[True, True, False]]).expand(4, 3)
    part = near.share[2, :2].sum()
    kept = x * seen.unsqueeze(-1)
    torch.testing.assert_close(conv(kept, near, seen)[:, 2], conv(kept, near)[:, 2] / part)


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_a_grid_has_twelve_neighbours_wherever_it_lies(dtype):
    layout = grid(7, 7, pitch=0.003)
    near = Neighbourhood(layout, layout)
    middle = near.index // 49 == 24
    assert int(middle.sum()) == 13  # with itself
    offsets = near.offset[middle].to(dtype).norm(dim=1).sort().values
    expected = torch.tensor([0.0] + 4 * [1.0] + 4 * [2**0.5] + 4 * [2.0], dtype=dtype)
    torch.testing.assert_close(offsets, expected, rtol=1e-4, atol=1e-4)


def test_kernel_is_kept_until_a_weight_changes():
    layout, conv, x = grid(3, 3, 0.01), KernelConv(2), samples(4, 9, 2)
    near, other = Neighbourhood(layout, layout), Neighbourhood(grid(3, 3, 0.01), layout)
    calls = []
    conv.place.register_forward_hook(lambda *_: calls.append(1))
    for _ in range(2):  # a hook sees each call
        with torch.no_grad():
            conv(x, near)
    assert len(calls) == 2
    conv.place._forward_hooks.clear()
    with torch.no_grad():
        first = conv.kernel(near)
        assert conv.kernel(near) is first
        assert conv.kernel(other) is not first
        first = conv.kernel(near)
        conv.place[0].weight.data += 1.0  # which counts as no write
        changed = conv.kernel(near)
        assert not changed.equal(first)
    torch.testing.assert_close(conv.kernel(near).detach(), changed)
    assert conv.kernel(near).requires_grad
    conv, near = conv.double(), near.double()
    with torch.inference_mode():
        conv(x.double(), near)
    conv(x.double().requires_grad_(), near).sum().backward()  # after a validation
    assert copy.deepcopy(conv)._kept._entry is None


def test_links_are_no_neighbours():
    layout = allegro_uskin()
    near = Neighbourhood(layout, layout)
    target, source = near.index // 384, near.index % 384
    assert layout.link[target].equal(layout.link[source])


def test_places_tell_links_apart():
    layout = allegro_uskin()
    found = places(layout, layout)
    assert found.shape == (384, 9)
    assert found[:, :3].abs().max() == 1.0
    of_links = torch.stack([found[layout.link == i][0, 3:] for i in layout.link.unique()])
    distance = torch.cdist(of_links, of_links).fill_diagonal_(9.0)
    assert distance.min() > 0.1
    assert places(GRID, GRID)[:, 3:].eq(0).all()  # of one link
    whole = places(GRID, GRID)
    assert places(select_taxels(GRID, [3, 5]), GRID).equal(whole[[3, 5]])


def test_encoder_leaves_out_missing_taxels():
    model = encoder("joined").eval()
    x = given(model, 4)["x"]
    x[:, 3] = torch.nan
    x[1, 7, 1] = torch.nan
    found = model.embed(x)
    assert found.isfinite().all()
    other = x.clone()
    other[1, 7, 0] = 99.0  # of a taxel that lacks another channel
    assert model.embed(other).equal(found)
    other[1, 8, 0] = 99.0
    assert not model.embed(other)[1].equal(found[1])
    assert model.embed(torch.full_like(x, torch.nan)).isfinite().all()


@pytest.mark.parametrize("name", ["whole", "joined"])
def test_encoder_does_not_depend_on_the_numbering(name):
    model = encoder(name).eval()
    order = torch.randperm(20, generator=torch.Generator().manual_seed(1))
    x = given(model, 4)["x"]
    other = model.on_layout(select_taxels(GRID, order))
    torch.testing.assert_close(other.embed(x[:, order]), model.embed(x), rtol=1e-4, atol=1e-4)


def test_encoder_runs_on_other_layouts():
    model = encoder("whole").fit_scale(samples(30, 20, 3) + 5).eval()
    kept = torch.arange(20)[torch.arange(20) % 4 != 0]
    for layout in (select_taxels(GRID, kept), grid(3, 3, 0.01), allegro_uskin()):
        other = model.on_layout(layout)
        assert other.num_nodes == layout.num_taxels
        assert other.embed(samples(2, layout.num_taxels, 3)).shape == (2, 5)
        torch.testing.assert_close(other.center[0], model.center.mean(dim=0))
        assert other.scale.equal(model.scale)


def test_encoder_does_not_depend_on_the_unit_of_places():
    model = encoder("whole").eval()
    x = given(model, 3)["x"]
    larger = model.on_layout(grid(4, 5, pitch=0.4))
    torch.testing.assert_close(larger.embed(x), model.embed(x), rtol=1e-4, atol=1e-4)


def test_fit_scale_by_hand():
    model = encoder("whole")
    x = torch.zeros(100, 20, 3)
    x[:, :, 0] = 7.0
    x[:50, :, 1], x[50:, :, 1] = 1.0, 3.0
    x[0, 0, 1] = 1e6  # a glitch, which changes nothing
    x[:, 5, 2] = torch.nan
    model.fit_scale(x)
    assert model.center[:, 0].eq(7.0).all()
    assert model.scale[0] == 1.0  # a constant keeps its unit
    assert 1.0 <= float(model.scale[1]) <= 2.0
    assert model.center[5, 2] == 0.0
    assert model.center.isfinite().all()
    assert "center" in model.state_dict()


def test_fit_scale_keeps_the_scale_of_what_is_rarely_touched():
    x = torch.zeros(1000, 20, 3)
    x[0, 3] = 5.0
    assert encoder("whole").fit_scale(x).scale.gt(0).all()
    assert encoder("whole").fit_scale(x).scale.ne(1).all()


def test_encoder_of_one_taxel():
    model = TaxelEncoder(TaxelLayout("one", torch.zeros(1, 3)), 2, in_channels=1)
    assert model(torch.ones(3, 1, 1)).shape == (3, 2)
    assert model(torch.ones(0, 1, 1)).shape == (0, 2)


def test_encoder_bad():
    with pytest.raises(ValueError, match=r"'x' must have 3 channels \(got shape \(2, 20, 1\)\)"):
        encoder().embed(torch.zeros(2, 20, 1))
    with pytest.raises(ValueError, match="'x' must have 20 taxels"):
        encoder().fit_scale(torch.zeros(2, 19, 3))
