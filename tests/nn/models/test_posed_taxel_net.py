import copy
from itertools import pairwise

import pytest
import torch
from plain_models import POSED_NETS as MODELS
from plain_models import given, trained
from plain_models import posed_net as small
from small_models import samples

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn import PosedTaxelNet
from torch_geometric_tactile.nn.models._taxels import taxel_mask
from torch_geometric_tactile.nn.models.posed_taxel_net import _select_strongest
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin, grid
from torch_geometric_tactile.transforms import TaxelForce, TaxelPose

N = 20


def touched(model, batch_size, number, levels=None, seed=0):
    """Inputs with so many touched taxels in each sample, and that many levels of pressure."""
    data = given(model, batch_size, seed)
    order = samples(batch_size, N, seed=seed + 7).argsort(dim=1)
    pressure = data["x"][..., -1].abs() + 0.01
    if levels is not None:
        pressure = (levels * pressure).ceil() / levels
    # Not touched is zero or, by drift, below it.
    idle = torch.where(order % 2 == 0, 0.0, -0.1)
    data["x"][..., -1] = torch.where(order < number, pressure, idle)
    return data


def renumbered(model, data, order):
    """The model and its inputs with the taxels in another order."""
    model = copy.deepcopy(model)
    if not model.posed:
        for name in ("open_pos", "open_normal", "open_tangent"):
            setattr(model, name, getattr(model, name)[order])
    return model, {key: value[:, order] for key, value in data.items()}


@pytest.fixture(params=MODELS)
def model(request):
    return trained(small(request.param))


def num_parameters(module):
    return sum(parameter.numel() for parameter in module.parameters())


def test_posed_taxel_net_repr():
    assert str(small("pressure")) == (
        "PosedTaxelNet(20, 3, in_channels=1, posed=True, num_strongest=6)"
    )


def test_posed_taxel_net_parameter_count():
    def layers(*sizes):
        return sum(a * b + 2 * b for a, b in pairwise(sizes))

    expected = layers(11, 48, 48, 96) + layers(2 * 96, 48) + 48 * 6 + 6
    assert num_parameters(PosedTaxelNet("allegro_uskin", 6)) == expected == 17_430
    assert num_parameters(small("posed")) == layers(11, 5, 7) + layers(14, 4) + 15
    assert num_parameters(small("other")) == layers(13, 5, 7) + layers(14, 4) + 15


def test_posed_taxel_net_modalities():
    assert small("posed").modalities == ("pos", "normal", "tangent")
    assert small("pressure").modalities == ("pos", "normal")
    assert small("open").modalities == ()


def test_posed_taxel_net_places_of_all_samples():
    model = trained(small())
    data = given(model, 5)
    shared = {key: value if key == "x" else value[0] for key, value in data.items()}
    spread = {
        key: value if key == "x" else value[:1].expand_as(value) for key, value in data.items()
    }
    assert torch.allclose(model(**shared), model(**spread), atol=1e-6)


def test_posed_taxel_net_sees_the_strongest_only():
    model = trained(small())
    data = given(model, 5)
    weak = data["x"][..., -1].argsort(dim=1)[:, : N - 6]
    expected = model(**data)
    for name, value in data.items():
        other = value.clone()
        rows = torch.arange(5).view(-1, 1)
        other[rows, weak] = other[rows, weak] + 1 if name != "x" else other[rows, weak] - 1
        assert torch.allclose(model(**{**data, name: other}), expected, atol=1e-5)


@pytest.mark.full
@pytest.mark.parametrize("mode", ["eval", "train"])
@pytest.mark.parametrize("levels", [None, 2, 0.1], ids=["distinct", "few", "one"])
@pytest.mark.parametrize("number", [0, 1, 5, 6, 7, N])
def test_posed_taxel_net_numbering_of_the_taxels_does_not_matter(model, number, levels, mode):
    # Taxels that are not touched tie, and so do touched ones if there are few levels.
    data = touched(model, 9, number, levels)
    model = copy.deepcopy(model).train(mode == "train")
    model.taxel_dropout = model.dropout.p = 0.0
    for seed in range(3):
        order = torch.randperm(N, generator=torch.Generator().manual_seed(seed))
        other, again = renumbered(model, data, order)
        expected = copy.deepcopy(model)(**data)
        assert torch.allclose(other(**again), expected, atol=1e-5)


@pytest.mark.parametrize("number", [0, 1, 5])
def test_posed_taxel_net_untouched_taxels_do_not_count(model, number):
    data = touched(model, 9, number)
    other = {key: value.clone() for key, value in data.items()}
    idle = data["x"][..., -1] <= 0
    for value in other.values():
        value[idle] = -value[idle].abs() - 1
    assert torch.equal(model(**other), model(**data))
    # Nor do they in training, where more rows than are touched would change the scales.
    outs, states = [], []
    for most in (6, N):
        model.num_strongest, norms = most, copy.deepcopy(model).train()
        norms.num_strongest, norms.taxel_dropout, norms.dropout.p = most, 0.0, 0.0
        outs.append(norms(**data))
        states.append(norms.state_dict())
    assert torch.allclose(*outs, atol=1e-5)
    for name, value in states[0].items():
        assert torch.allclose(value, states[1][name], atol=1e-5), name


def test_posed_taxel_net_nothing_touched(model):
    data = touched(model, 3, 0)
    rows = torch.zeros(3, model.lin.in_features)
    expected = model.lin_out(model.norm_hidden(model.lin(rows)).relu())
    assert torch.allclose(model(**data), expected)
    # Scales stay as they are without anything to measure.
    before = copy.deepcopy(model.state_dict())
    assert model.train()(**data).isfinite().all()
    for name, value in model.state_dict().items():
        if not name.startswith("norm_hidden"):
            assert torch.equal(value, before[name]), name


def test_strongest_equals_come_by_their_place():
    pressure = torch.tensor([[2.0, 1.0, 1.0, 3.0, 1.0, 0.0, -1.0]])
    pos = torch.zeros(1, 7, 3)
    pos[0, :, 1] = torch.tensor([0.0, 5.0, 7.0, 0.0, 6.0, 9.0, 9.0])

    def chosen(most):
        return _select_strongest(pressure, pos, most)[0].nonzero().view(-1).tolist()

    assert [chosen(most) for most in (1, 2, 3, 4)] == [[3], [0, 3], [0, 2, 3], [0, 2, 3, 4]]
    assert chosen(5) == chosen(7) == chosen(99) == [0, 1, 2, 3, 4]
    pos[0, :, 1] = 0.0  # at one place: all that fit, or none
    assert chosen(4) == [0, 3]
    assert chosen(5) == [0, 1, 2, 3, 4]
    pos[0, 1, 0] = 1.0  # the first axis before the second
    assert chosen(3) == [0, 1, 3]


@pytest.mark.parametrize("channel", [0, -1])
def test_posed_taxel_net_missing_reading_has_no_answer(model, channel):
    data = touched(model, 3, 9)
    weakest = data["x"][1, :, -1].argmin()
    data["x"][1, weakest, channel] = torch.nan
    assert model(**data).isnan().all(dim=1).tolist() == [False, True, False]


def test_posed_taxel_net_force_is_that_of_taxel_force():
    model, data = small(num_strongest=N), given(small(), 5)
    features = model._features(
        data["x"], {key: data[key] for key in model.places}, torch.arange(N).expand(5, N)
    )
    assert torch.equal(features[..., :3], data["pos"])
    force = TaxelForce()(StaticData(**data)).x
    assert torch.allclose(features[..., 6:9], force, atol=1e-6)
    assert torch.allclose(features[..., 9], force.norm(dim=-1), atol=1e-5)
    assert torch.equal(features[..., 10], data["x"][..., -1])
    # A single channel presses along the normal.
    one = small("pressure", num_strongest=N)
    features = one._features(
        data["x"][..., -1:],
        {"pos": data["pos"], "normal": data["normal"]},
        torch.arange(N).expand(5, N),
    )
    assert torch.allclose(features[..., 6:9], -data["x"][..., -1:] * data["normal"])


def test_posed_taxel_net_open_hand_is_the_posed_hand_at_zero():
    layout, x = allegro_uskin(), samples(4, 384, 3)
    posed = PosedTaxelNet(layout, 2).eval()
    fixed = PosedTaxelNet(layout, 2, posed=False).eval()
    fixed.load_state_dict(posed.state_dict())
    data = TaxelPose(layout, HandKinematics.allegro(), tangent=True)(
        StaticData(x=x, joint=torch.zeros(4, 16))
    )
    expected = posed(x, pos=data.pos, normal=data.normal, tangent=data.tangent)
    assert torch.allclose(fixed(x), expected, atol=1e-5)


def test_posed_taxel_net_taxel_dropout():
    model = small(num_strongest=N, taxel_dropout=0.5, dropout=0.0)
    data = given(model, 16)
    assert not torch.equal(model(**data), model(**data))
    model.eval()
    assert torch.equal(model(**data), model(**data))
    # Where almost all are dropped, one sample still sees something.
    lonely = small(taxel_dropout=0.999, dropout=0.0)
    assert lonely(**data).isfinite().all()
    assert taxel_mask(data["x"], 0.999).any(dim=1).all()


@pytest.mark.parametrize("name", MODELS)
def test_posed_taxel_net_gradient_of_no_touch(name):
    # Nothing touched: no infinite gradient of the size of a force.
    model = small(name, taxel_dropout=0.0, dropout=0.0)
    data = given(model, 9)
    data["x"] = torch.zeros(9, N, model.in_channels, requires_grad=True)
    model(**data).sum().backward()
    assert data["x"].grad.isfinite().all()


def test_posed_taxel_net_few_taxels():
    model = PosedTaxelNet(grid(1, 2, 0.01), 2, in_channels=1, posed=False)
    assert model(samples(5, 2, 1)).shape == (5, 2)


def test_posed_taxel_net_open_hand_of_unknown_links():
    numbers = {"link": torch.tensor([0, 1]), "link_names": ("palm_link", "other")}
    layout = TaxelLayout("two", grid(1, 2, 0.01).pos, **numbers)
    with pytest.raises(ValueError, match=r"'posed' must be True .* Allegro .*the link 'other'\)"):
        PosedTaxelNet(layout, 2, posed=False)
    assert PosedTaxelNet(layout, 2).posed


def test_posed_taxel_net_bad_input():
    model = small().eval()
    data = given(model, 5)
    bad = [
        ({"x": data["x"][..., :2]}, r"'x' must have 3 channels \(got shape \(5, 20, 2\)\)"),
        ({"x": data["x"][:, :19]}, r"'x' must have 20 taxels in each sample \(got shape"),
        ({"pos": None}, r"'pos' must be given if 'posed' is True .*: add TaxelPose\(\)"),
        ({"normal": data["normal"][:4]}, r"'normal' must have 5 samples of 20 taxels.*\(4, 20, 3"),
        (
            {"pos": data["pos"][..., :2]},
            r"'pos' must have 5 samples .*shape \(3,\) for each taxel",
        ),
        ({"tangent": data["normal"]}, r"'tangent' must have 5 samples .*shape \(2, 3\) for each"),
    ]
    for arguments, match in bad:
        with pytest.raises(ValueError, match=match):
            model(**{**data, **arguments})
