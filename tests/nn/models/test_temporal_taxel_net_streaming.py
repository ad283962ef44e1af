import copy

import pytest
import torch
from small_models import samples
from temporal_nets import EDGES, FIELDS, MODELS, given, small, trained

from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.nn import TemporalTaxelNet
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.testing import assert_streaming_equals_window


@pytest.fixture(params=MODELS)
def model(request):
    return trained(small(request.param))


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


def test_temporal_taxel_net_state_is_tensors(model):
    state = model.initial_state(3, dtype=torch.double)
    first_layers = [layer for layer in (model.filters, model.mixer) if layer is not None]
    assert len(state) == len(first_layers) + len(model.blocks)
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


def test_temporal_taxel_net_bad_step():
    model = small()
    with pytest.raises(ValueError, match=r"'x' must have 2 channels \(got shape"):
        model.step(torch.zeros(3, 20, 4), None, model.initial_state(3))
    with pytest.raises(ValueError, match=r"'state' must be .* 3 tensors .*\(got 2\)"):
        model.step(torch.zeros(3, 20, 2), None, model.initial_state(3)[:2])
    with pytest.raises(ValueError, match=r"'x' and 'state' must have shape .*\(got \(3, 20, 2\)"):
        model.step(torch.zeros(3, 20, 2), None, model.initial_state(4))
