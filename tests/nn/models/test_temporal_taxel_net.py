import pytest
import torch
from small_models import samples
from temporal_nets import MODELS, given, small, trained

from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.nn import TemporalTaxelNet
from torch_geometric_tactile.sensors import grid

POOLS = ("last", "mean", "max", "mean_max")


@pytest.fixture(params=MODELS)
def model(request):
    return trained(small(request.param))


def num_parameters(module):
    return sum(parameter.numel() for parameter in module.parameters())


def test_temporal_taxel_net_repr():
    assert str(small("pooled")) == (
        "TemporalTaxelNet(20, 3, in_channels=2, widths=(4, 6, 6), taxels=(20, 6, 2), "
        "receptive_field=9)"
    )
    assert str(small("joints")).endswith("receptive_field=4, num_joints=2)")


def test_temporal_taxel_net_parameter_count():
    def sector(before, after, sectors=8):
        return (1 + sectors) * before * after + 2 * after  # with the normalisation

    def temporal(before, after, kernel):
        return kernel * before * after + 2 * after

    def head(width, classes, hidden):
        return width * hidden + 2 * hidden + hidden * classes + classes

    net = TemporalTaxelNet("biotac", 2, in_channels=3)
    assert num_parameters(net) == (
        temporal(3, 16, 16) + sector(16, 32) + 2 * temporal(32, 32, 3) + head(21 * 32, 2, 64)
    )
    blocks = sector(4, 4) + sector(4, 6) + sector(6, 6) + 2 * sector(6, 6)
    assert num_parameters(small("pooled")) == (
        temporal(2, 4, 3) + blocks + 2 * temporal(6, 6, 3) + head(4 * 6, 3, 8)
    )
    assert num_parameters(small("self")) == (
        temporal(2, 4, 1) + 2 * 4 * 4 + 8 + 2 * temporal(4, 4, 2) + head(22 * 4, 3, 8)
    )
    assert num_parameters(small("joints")) == (
        temporal(2, 4, 4) + sector(4, 4, 6) + 2 * temporal(4, 4, 1) + head(22 * 4 + 2, 3, 8)
    )


def test_temporal_taxel_net_by_hand():
    # One taxel, two frames: the filter sees both, the block the frame that is its own.
    model = TemporalTaxelNet(
        grid(1, 1, 0.001),
        1,
        num_filters=1,
        filter_size=2,
        widths=(1,),
        kernel_size=1,
        num_blocks=1,
        hidden_channels=1,
    ).eval()
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.fill_(1.0)
        model.filters.conv.weight[0] = 10.0
    eps = (1 + 1e-5) ** -0.5
    h = (10 * 2.0 + 3.0) * (1 + 1e-6) ** -0.5
    h = h * eps + 1  # filter
    h = h + h * eps + 1  # convolution of taxels, with a residual
    h = h + h * eps + 1  # block
    hidden = 3 * h * eps + 1  # itself, mean and maximum
    assert model(torch.tensor([[[2.0, 3.0]]])).item() == pytest.approx(hidden + 1, rel=1e-5)


def test_temporal_taxel_net_pool_by_hand():
    """One taxel, one filter of the present frame: the answers of pooling follow from the frames."""
    torch.manual_seed(0)
    x = torch.tensor([[[1.0, -2.0, 0.5, 3.0]]])
    more = {"layout": grid(1, 1, 0.004), "max_taxels": 64, "num_blocks": 1, "kernel_size": 1}
    nets = {p: small(pool=p, filter_size=1, in_channels=1, **more).eval() for p in POOLS}
    hidden = {}
    for pool, net in nets.items():
        net.load_state_dict(
            {
                key: value
                for key, value in nets["last"].state_dict().items()
                if not key.startswith("head.lin.")
            },
            strict=False,
        )
        net.head.register_forward_pre_hook(
            lambda _, given, pool=pool: hidden.__setitem__(pool, given[0])
        )
        net(x)
    nets["last"](x, per_frame=True)
    frames = hidden.pop("last")  # of all frames, by the second call
    assert frames.shape == (1, 1, 4, 4)
    assert hidden["mean"].allclose(frames.mean(dim=2))
    assert hidden["max"].allclose(frames.amax(dim=2))
    both = torch.cat([hidden["mean"], hidden["max"]], dim=-1)
    assert hidden["mean_max"].equal(both)


@pytest.mark.parametrize("mixed_channels", [0, 5])
@pytest.mark.parametrize("pool", POOLS[1:])
def test_temporal_taxel_net_pool_uses_every_frame(pool, mixed_channels):
    """Also frames that are further back than the receptive field, which the last frame forgets."""
    model = trained(small(pool=pool, mixed_channels=mixed_channels))
    x = given(model, 6, 40)["x"].requires_grad_()
    model(x).square().sum().backward()
    changes = split_frames(x.grad, 40).abs().amax(dim=(0, 1, 3))
    if pool == "max":  # the largest of few windows are in some frames
        assert changes[: 40 - model.receptive_field].any()
    else:
        assert changes.gt(0).all()


def test_temporal_taxel_net_pool_skips_no_reading_with_a_dilation():
    model = trained(small(pool="mean", filter_size=4, dilation=4))
    x = given(model, 3, 23)["x"].requires_grad_()
    model(x).square().sum().backward()
    assert split_frames(x.grad, 23).abs().amax(dim=(0, 1, 3)).gt(0).all()


def test_temporal_taxel_net_pool_is_for_windows():
    model = small(pool="mean")
    assert not model.can_step
    assert small().can_step
    with pytest.raises(ValueError, match=r"'pool' must be 'last' for 'step'.*\(got mean\)"):
        model.step(torch.zeros(1, 20, 2), None, ())
    with pytest.raises(ValueError, match=r"'pool' must be 'last' for 'initial_state'"):
        model.initial_state(1)
    with pytest.raises(ValueError, match=r"'pool' must be 'last' for 'per_frame'"):
        model(given(model, 2)["x"], per_frame=True)


def test_temporal_taxel_net_mixes_all_taxels_before_time():
    """A pattern that moves over the taxels is seen by one channel."""
    model = small("mixed")
    assert model.mixer.conv.in_channels == 6 * 4  # taxels of the last level times their width
    assert [block.conv.in_channels for block in model.blocks] == [5, 5]
    assert model.head.lin.in_features == 5
    assert small("mixed", pool="mean_max").head.lin.in_features == 10
    assert "pool='mean', mixed_channels=5" in str(small("mixed", pool="mean"))


def test_temporal_taxel_net_of_no_windows():
    model = trained(small())
    size = (0, model.num_nodes, model.in_channels * 5)
    assert model(torch.zeros(size), per_frame=True).shape == (0, 5, 3)
    out, state = model.step(torch.zeros(*size[:2], model.in_channels), None, model.initial_state(0))
    assert out.shape == (0, 3)
    assert len(state[0]) == 0
    assert model(given(model, 3, 1)["x"]).shape == (3, 3)


@pytest.mark.parametrize("per_frame", [False, True])
@pytest.mark.parametrize("name", MODELS)
def test_temporal_taxel_net_gradients(name, per_frame):
    found = []
    for fast in (True, False):
        model = small(name, fast=fast, dropout=0.0, taxel_dropout=0.0).double()
        data = given(model, 9, dtype=torch.double)
        if per_frame and model.num_joints:
            data["joint"] = samples(9, 12, 2, dtype=torch.double)
        out = model(**data, per_frame=per_frame)  # with the statistics of the batch
        found.append(torch.autograd.grad(out.square().sum(), list(model.parameters())))
    for ours, theirs in zip(*found, strict=True):
        assert torch.allclose(ours, theirs, rtol=1e-6, atol=1e-9)
    assert all(grad.abs().max() > 0 for grad in found[0])


@pytest.mark.full
@pytest.mark.parametrize("name", MODELS)
def test_temporal_taxel_net_step_compile(name):
    torch.compiler.reset()
    model = trained(small(name))
    data = given(model, 9)
    step = torch.compile(model.step, fullgraph=True, backend="aot_eager")
    frame = data["x"][..., ::12][..., : model.in_channels]
    state = model.initial_state(9)
    expected = model.step(frame, None, state, data.get("joint"))
    found = step(frame, None, state, data.get("joint"))
    assert torch.allclose(found[0], expected[0], atol=1e-5)


def test_temporal_taxel_net_overfits_what_only_motion_tells():
    torch.manual_seed(0)
    model = small("pooled", max_taxels=64, dropout=0.0, taxel_dropout=0.0)
    y = torch.arange(20) % 2
    steps = torch.where(y.bool(), 1, -1).view(-1, 1) * torch.arange(12)
    taxel = (steps + torch.arange(20).view(-1, 1)) % 20  # one taxel pressed, going up or down
    x = torch.nn.functional.one_hot(taxel, 20).float().transpose(1, 2)
    x = torch.cat([x, torch.zeros_like(x)], dim=2)
    optimizer = torch.optim.Adam(model.parameters(), 0.02)
    for _ in range(60):
        optimizer.zero_grad()
        torch.nn.functional.cross_entropy(model(x), y).backward()
        optimizer.step()
    assert torch.equal(model(x).argmax(1), y)


def test_temporal_taxel_net_scale_of_the_readings_does_not_matter():
    scale, offset = torch.tensor([1.0, 1000.0]), torch.tensor([0.0, 30_000.0])
    frames, found = samples(16, 20, 12, 2, dtype=torch.double), []
    for factor, shift in ((1.0, 0.0), (scale, offset)):
        model = small("pooled", dropout=0.0, taxel_dropout=0.0).double()
        x = join_frames(frames * factor + shift)
        found += [model(x), model.eval()(x)]
    assert torch.allclose(found[0], found[2], atol=1e-3)
    assert torch.allclose(found[1], found[3], atol=1e-3)


def test_temporal_taxel_net_taxel_dropout_is_of_whole_windows():
    model = small("pooled", taxel_dropout=0.5, dropout=0.0)
    model.norm = torch.nn.Identity()
    data = given(model, 16)
    data["x"].requires_grad_()
    model(**data, per_frame=True).square().sum().backward()
    seen = split_frames(data["x"].grad, 12).abs().sum(dim=3) > 0
    part = seen.double().mean(dim=2)
    assert 0.3 < float((part == 0).double().mean()) < 0.7
    assert not ((part > 0) & (part < 0.5)).any()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"conv": "gcn"}, r"'conv' must be one of \('sector', 'self', .*\(got 'gcn'\)"),
        ({"pool": "sum"}, r"'pool' must be one of \('last', 'mean', .*\(got 'sum'\)"),
    ],
)
def test_temporal_taxel_net_bad_argument(arguments, match):
    with pytest.raises(ValueError, match=match):
        small(**arguments)


@pytest.mark.parametrize(
    ("sizes", "match"),
    [
        (((20, 3), (5, 20, 0), ()), r"the same number of frames, .* for each of 2 channels"),
        (((21, 4), (5, 19, 4)), r"20 taxels in each sample"),
    ],
)
def test_temporal_taxel_net_bad_sizes(sizes, match):
    for size in sizes:
        with pytest.raises(ValueError, match=rf"'x' must have {match} \(got"):
            small()(torch.zeros(size))


def test_temporal_taxel_net_bad_joints():
    model = small("joints")
    with pytest.raises(ValueError, match=r"'joint' must be given"):
        model(torch.zeros(2, 20, 4))
    with pytest.raises(ValueError, match=r"'joint' must have shape \(4, 2\)"):
        model(torch.zeros(2, 20, 4), joint=torch.zeros(2, 2), per_frame=True)
