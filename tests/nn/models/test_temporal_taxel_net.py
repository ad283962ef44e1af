import copy

import pytest
import torch
from small_models import samples
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.nn import TemporalTaxelNet
from torch_geometric_tactile.sensors import biotac_sp, grid
from torch_geometric_tactile.testing import (
    assert_static_equals_batched,
    assert_streaming_equals_window,
)

EDGES = torch.tensor([[0, 1], [1, 0]])
# 20 taxels, pooled to 6 and to 2.
SMALL = grid(4, 5, pitch=0.004)
MODELS = {
    "electrodes": {"layout": biotac_sp(), "in_channels": 3},
    "pooled": {"max_taxels": 2, "widths": (4, 6), "depth": 2},
    "self": {"conv": "self", "filter_size": 1, "kernel_size": 2, "dilation": 3},
    "difference": {"conv": "difference", "dilation": 1, "num_blocks": 3, "in_channels": 1},
    "joints": {"num_joints": 2, "num_sectors": 6, "filter_size": 4, "kernel_size": 1},
}
FIELDS = {"electrodes": 9, "pooled": 9, "self": 10, "difference": 17, "joints": 4}


def small(name="pooled", **more):
    torch.manual_seed(0)
    arguments = {
        "in_channels": 2,
        "num_filters": 4,
        "filter_size": 3,
        "widths": (4,),
        "dilation": 1,
        "num_blocks": 2,
        "hidden_channels": 8,
        **MODELS[name],
        **more,
    }
    return TemporalTaxelNet(**{"layout": SMALL, "out_channels": 3, **arguments})


def given(model, batch_size, num_frames=12, seed=0, dtype=torch.float):
    """The inputs, as keywords."""
    size = (batch_size, model.num_nodes, model.in_channels * num_frames)
    found = {"x": samples(*size, seed=seed, dtype=dtype)}
    if model.num_joints:
        found["joint"] = samples(batch_size, model.num_joints, seed=1, dtype=dtype)
    return found


def trained(model):
    """After some steps, with statistics that are not those of the start, in evaluation mode."""
    optimizer = torch.optim.SGD(model.parameters(), 0.01)
    for seed in range(3):
        optimizer.zero_grad()
        model(**given(model, 16, seed=seed)).square().mean().backward()
        optimizer.step()
    return model.eval()


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


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize("name", [name for name in MODELS if name != "joints"])
def test_temporal_taxel_net_streaming_equals_window(name, dtype):
    model = trained(small(name)).to(dtype)
    num_frames = model.receptive_field + 6
    x = given(model, 3, num_frames, dtype=dtype)["x"]
    assert_streaming_equals_window(model, x, num_frames, EDGES)


def test_temporal_taxel_net_streaming_of_the_stock_layouts():
    for layout, channels in (("biotac", 3), ("allegro_uskin", 3), (grid(8, 8, 0.004), 1)):
        torch.manual_seed(0)
        model = TemporalTaxelNet(layout, 2, in_channels=channels, num_blocks=1).eval()
        num_frames = model.receptive_field + 1
        assert num_frames == 33
        x = samples(2, model.num_nodes, channels * num_frames)
        assert_streaming_equals_window(model, x, num_frames)


def test_temporal_taxel_net_long_stream_equals_any_long_window(model):
    frames = samples(2, model.num_nodes, 60, model.in_channels)
    joint = samples(2, 2)
    state = model.initial_state(2)
    for t in range(60):
        out, state = model.step(frames[:, :, t], EDGES, state, joint)
    for length in (model.receptive_field, model.receptive_field + 3, 60):
        window = model(join_frames(frames[:, :, 60 - length :]), EDGES, joint=joint)
        assert torch.allclose(window, out, atol=1e-5)
    if model.receptive_field > 4:
        short = model(join_frames(frames[:, :, -2:]), EDGES, joint=joint)
        assert not torch.allclose(short, out, atol=1e-4)


def test_temporal_taxel_net_per_frame(model):
    data = given(model, 4, 12)
    if model.num_joints:
        data["joint"] = samples(4, 12, 2)
    out = model(**data, per_frame=True)
    assert out.shape == (4, 12, 3)
    frames = split_frames(data["x"], 12)
    for t in (0, 1, 5, 11):
        more = {"joint": data["joint"][:, t]} if model.num_joints else {}
        expected = model(join_frames(frames[:, :, : t + 1]), **more)
        assert torch.allclose(out[:, t], expected, atol=1e-5)


@pytest.mark.parametrize("name", MODELS)
def test_temporal_taxel_net_receptive_field(name):
    model = trained(small(name)).double()
    assert model.receptive_field == FIELDS[name]
    data = given(model, 8, 25, dtype=torch.double)
    data["x"].requires_grad_()
    model(**data).square().sum().backward()
    grad = split_frames(data["x"].grad, 25).abs().amax(dim=(0, 1, 3))
    seen = grad.nonzero().view(-1)
    assert int(seen[0]) == 25 - model.receptive_field


def test_temporal_taxel_net_never_looks_ahead(model):
    data = given(model, 2, 12)
    if model.num_joints:
        data["joint"] = samples(2, 12, 2)
    out = model(**data, per_frame=True)
    frames = split_frames(data["x"], 12).clone()
    frames[:, :, 7:] += 5
    other = model(**{**data, "x": join_frames(frames)}, per_frame=True)
    assert torch.allclose(other[:, :7], out[:, :7], atol=1e-6)
    assert not torch.allclose(other[:, 7], out[:, 7], atol=1e-3)


def test_temporal_taxel_net_order_of_the_features_matters():
    model = trained(small("electrodes"))
    x = given(model, 3, 12)["x"]
    swapped = x.unflatten(-1, (12, 3)).transpose(-1, -2).flatten(-2)  # time outer
    assert not torch.allclose(model(swapped), model(x), atol=1e-3)
    frames = split_frames(x, 12)
    state = model.initial_state(3)
    for t in range(12):
        assert torch.equal(frames[:, :, t, 1], x[:, :, 12 + t])
        out, state = model.step(frames[:, :, t], None, state)
    assert torch.allclose(out, model(x), atol=1e-5)


def test_temporal_taxel_net_state_is_tensors(model):
    state = model.initial_state(3, dtype=torch.double)
    assert len(state) == 1 + len(model.blocks)
    assert all(len(part) == 3 and part.dtype == torch.double for part in state)
    frames = samples(5, model.num_nodes, model.in_channels)
    joint = samples(5, 2)
    whole, _ = model.step(frames, None, model.initial_state(5), joint)
    state, before = model.initial_state(5), copy.deepcopy(model.state_dict())
    _, state = model.step(frames, None, state, joint)
    kept = [part.clone() for part in state]
    one, _ = model.step(frames[1:2], None, tuple(part[1:2] for part in state), joint[1:2])
    all_of_them, _ = model.step(frames, None, state, joint)
    assert torch.allclose(one, all_of_them[1:2], atol=1e-6)
    assert all(torch.equal(a, b) for a, b in zip(kept, state, strict=True))  # not written to
    again, _ = model.step(frames, None, model.initial_state(5), joint)
    assert torch.equal(again, whole)
    assert all(torch.equal(value, before[key]) for key, value in model.state_dict().items())


def test_temporal_taxel_net_forms(model):
    if model.num_joints:
        data = given(model, 5)
        batch = Batch.from_data_list(
            [Data(x=x, joint=q[None]) for x, q in zip(data["x"], data["joint"], strict=True)]
        )
        expected = model(**data)
        assert torch.allclose(model(batch.x, joint=batch.joint), expected, atol=1e-5)
        assert torch.allclose(model(data["x"][0], joint=data["joint"][:1]), expected[:1], atol=1e-5)
        return
    for batch_size in (2, 9):
        assert_static_equals_batched(model, given(model, batch_size)["x"], EDGES)
    size = (0, model.num_nodes, model.in_channels * 5)
    assert model(torch.zeros(size)).shape == (0, 3)
    assert model(torch.zeros(size), per_frame=True).shape == (0, 5, 3)
    out, state = model.step(torch.zeros(*size[:2], model.in_channels), None, model.initial_state(0))
    assert out.shape == (0, 3)
    assert len(state[0]) == 0
    assert model(given(model, 3, 1)["x"]).shape == (3, 3)


def test_temporal_taxel_net_needs_no_edges(model):
    data = given(model, 9)
    assert torch.equal(model(edge_index=EDGES, **data), model(**data))
    assert model.modalities == (("joint",) if model.num_joints else ())


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


def test_temporal_taxel_net_missing_readings_are_not_hidden():
    model = trained(small("electrodes"))
    frames = samples(2, 24, 30, 3)
    frames[0, 3, 5] = torch.nan
    out = model(join_frames(frames), per_frame=True)
    assert out[1].isfinite().all()
    missing = out[0].isnan().all(dim=1)
    assert missing[5 : 5 + model.receptive_field].all()
    assert not missing[:5].any()
    assert not missing[5 + model.receptive_field :].any()  # forgotten
    state = model.initial_state(2)
    for t in range(30):
        step, state = model.step(frames[:, :, t], None, state)
        assert torch.equal(step.isnan(), out[:, t].isnan())


@pytest.mark.parametrize("name", MODELS)
def test_temporal_taxel_net_compile(name):
    torch.compiler.reset()
    model = trained(small(name))
    data = given(model, 9)
    compiled = torch.compile(model, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(**data), model(**data), atol=1e-5)
    step = torch.compile(model.step, fullgraph=True, backend="aot_eager")
    frame = data["x"][..., ::12][..., : model.in_channels]
    state = model.initial_state(9)
    expected = model.step(frame, None, state, data.get("joint"))
    found = step(frame, None, state, data.get("joint"))
    assert torch.allclose(found[0], expected[0], atol=1e-5)
    model.train()
    compiled.train()
    compiled(**data).square().sum().backward()
    assert model.head.lin.weight.grad.abs().max() > 0


@pytest.mark.parametrize("name", MODELS)
def test_temporal_taxel_net_export(name):
    model = trained(small(name))
    data = given(model, 3)
    shapes = {key: {0: torch.export.Dim("batch")} for key in data}
    exported = torch.export.export(model, (), data, dynamic_shapes=shapes).module()
    for size in (3, 20):
        data = given(model, size)
        with torch.no_grad():
            assert torch.allclose(exported(**data), model(**data), atol=1e-5)


class Step(torch.nn.Module):
    """A step with the state as single tensors, to export."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, frame, *state):
        out, state = self.model.step(frame, None, state)
        return (out, *state)


def test_temporal_taxel_net_export_of_a_step():
    model = trained(small("pooled"))
    frame, state = samples(3, 20, 2), model.initial_state(3)
    exported = torch.export.export(Step(model), (frame, *state)).module()
    with torch.no_grad():
        for seed in range(4):
            frame = samples(3, 20, 2, seed=seed)
            expected, after = model.step(frame, None, state)
            out, *state = exported(frame, *state)
            assert torch.allclose(out, expected, atol=1e-5)
            assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(state, after, strict=True))


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


def test_temporal_taxel_net_of_a_single_window_in_training():
    for name in MODELS:
        model = small(name).train()
        model(**given(model, 16))
        out = model(**given(model, 1, 1))
        assert out.shape == (1, 3)
        assert out.isfinite().all()


def test_temporal_taxel_net_seed_and_reset(model):
    before, outs = copy.deepcopy(model.state_dict()), []
    for _ in range(2):
        torch.manual_seed(3)
        model.reset_parameters()
        outs.append(model(**given(model, 9)))
    assert torch.equal(*outs)
    for name, value in model.state_dict().items():
        if name.endswith("weight") and "norm" not in name:
            assert not torch.equal(value, before[name]), name


def test_temporal_taxel_net_hub(tmp_path):
    pytest.importorskip("huggingface_hub")
    model = trained(small("joints"))
    model.save_pretrained(tmp_path)
    again = TemporalTaxelNet.from_pretrained(tmp_path)
    data = given(model, 9)
    assert str(again) == str(model)
    assert torch.equal(again(**data), model(**data))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"layout": 24}, r"'layout' must be a layout, .* neighbours .*\(got the number of taxels"),
        *(
            ({name: 0}, rf"'{name}' must be at least 1 \(got 0\)")
            for name in (
                "out_channels",
                "in_channels",
                "num_filters",
                "filter_size",
                "depth",
                "num_sectors",
                "kernel_size",
                "dilation",
                "num_blocks",
                "hidden_channels",
                "max_taxels",
            )
        ),
        ({"taxel_dropout": 1.0}, r"'taxel_dropout' must be at least 0 and below 1 \(got 1.0\)"),
        ({"num_joints": -1}, r"'num_joints' must not be negative \(got -1\)"),
        ({"conv": "gcn"}, r"'conv' must be one of \('sector', 'self', .*\(got 'gcn'\)"),
        ({"widths": ()}, r"'widths' must be at least one width of at least 1 \(got \(\)\)"),
    ],
)
def test_temporal_taxel_net_bad_argument(arguments, match):
    with pytest.raises(ValueError, match=match):
        small(**arguments)


@pytest.mark.parametrize("size", [(20, 3), (5, 20, 0), ()])
def test_temporal_taxel_net_bad_frames(size):
    match = r"'x' must have the frames of 2 channels side by side, at least one of each \(got"
    with pytest.raises(ValueError, match=match):
        small()(torch.zeros(size))


@pytest.mark.parametrize("size", [(21, 4), (5, 19, 4)])
def test_temporal_taxel_net_bad_taxels(size):
    with pytest.raises(ValueError, match=r"'x' must have 20 taxels in each sample \(got shape"):
        small()(torch.zeros(size))


def test_temporal_taxel_net_bad_step():
    model = small()
    with pytest.raises(ValueError, match=r"'x' must have 2 channels \(got shape"):
        model.step(torch.zeros(3, 20, 4), None, model.initial_state(3))
    with pytest.raises(ValueError, match=r"'state' must be .* 3 tensors .*\(got 2\)"):
        model.step(torch.zeros(3, 20, 2), None, model.initial_state(3)[:2])
    with pytest.raises(ValueError, match=r"'x' and 'state' must have shape .*\(got \(3, 20, 2\)"):
        model.step(torch.zeros(3, 20, 2), None, model.initial_state(4))


def test_temporal_taxel_net_bad_joints():
    model = small("joints")
    with pytest.raises(ValueError, match=r"'joint' must be given"):
        model(torch.zeros(2, 20, 4))
    with pytest.raises(ValueError, match=r"'joint' must have shape \(4, 2\)"):
        model(torch.zeros(2, 20, 4), joint=torch.zeros(2, 2), per_frame=True)
