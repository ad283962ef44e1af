import pytest
import torch
from small_models import samples

from torch_geometric_tactile.nn import CausalTemporalConv

SIZES = [(3, 1), (3, 4), (2, 3), (1, 5)]  # kernel and dilation


def conv(in_channels=3, out_channels=5, *sizes, dtype=torch.float, **more):
    torch.manual_seed(0)
    layer = CausalTemporalConv(in_channels, out_channels, *sizes, **more).to(dtype)
    if layer.bias is not None:
        torch.nn.init.normal_(layer.bias)
    return layer


def test_number_of_past_frames():
    assert conv(3, 5, 3, 4).num_past == 8


def test_causal_temporal_conv_by_hand():
    layer = conv(1, 1, 2, 2)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor([10.0, 1.0]).view(2, 1, 1))
        layer.bias.fill_(0.5)
    x = torch.tensor([1.0, 2.0, 3.0, 4.0]).view(4, 1)
    assert layer(x).view(-1).tolist() == [1.5, 2.5, 13.5, 24.5]


@pytest.mark.parametrize("sizes", SIZES)
def test_causal_temporal_conv_is_conv1d_behind_zeros(sizes):
    layer = conv(3, 5, *sizes, dtype=torch.double)
    theirs = torch.nn.Conv1d(3, 5, sizes[0], dilation=sizes[1]).double()
    with torch.no_grad():
        theirs.weight.copy_(layer.weight.permute(2, 1, 0))
        theirs.bias.copy_(layer.bias)
    x = samples(4, 7, 3, dtype=torch.double)
    padded = torch.nn.functional.pad(x.transpose(1, 2), (layer.num_past, 0))
    assert torch.allclose(layer(x), theirs(padded).transpose(1, 2), atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize("sizes", SIZES)
def test_causal_temporal_conv_step_by_step(sizes, dtype):
    layer = conv(3, 5, *sizes, dtype=dtype)
    x = samples(2, 4, 9, 3, dtype=dtype)
    out, state = layer(x), layer.initial_state(2, 4)
    assert state.dtype == dtype
    for t in range(9):
        step, state = layer.step(x[:, :, t], state)
        assert state.shape == (2, 4, layer.num_past, 3)
        assert torch.allclose(step, out[:, :, t], atol=1e-6)
    assert torch.equal(state, x[:, :, 9 - layer.num_past :])


def test_causal_temporal_conv_forms():
    layer, x = conv(3, 5, 3, 2), samples(2, 4, 9, 3)
    out = layer(x)
    assert torch.allclose(layer(x.transpose(0, 1)), out.transpose(0, 1), atol=1e-6)
    assert layer(x[:, :, :1]).shape == (2, 4, 1, 5)
    assert layer(x[:, :, :0]).shape == (2, 4, 0, 5)
    out, state = layer.step(x[:0, :, 0], layer.initial_state(0, 4))
    assert (out.shape, state.shape) == ((0, 4, 5), (0, 4, 4, 3))


@pytest.mark.full
def test_causal_temporal_conv_step_compile():
    torch.compiler.reset()
    layer, x = conv(3, 5, 3, 2), samples(4, 9, 3)
    step = torch.compile(layer.step, fullgraph=True, backend="aot_eager")
    state = samples(4, 4, 3, seed=1)
    for found, expected in zip(step(x[:, 0], state), layer.step(x[:, 0], state), strict=True):
        assert torch.allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("size", [(3,), (9, 2), ()])
def test_causal_temporal_conv_bad_features(size):
    with pytest.raises(ValueError, match=r"'x' must have shape \(\.\.\., num_frames, 3\) \(got"):
        conv()(torch.zeros(size))


@pytest.mark.parametrize(("x", "state"), [((4, 2), (4, 2, 3)), ((4, 3), (4, 3, 3)), ((), (2, 3))])
def test_causal_temporal_conv_bad_state(x, state):
    match = r"'x' and 'state' must have shape \(\.\.\., 3\) and \(\.\.\., 2, 3\) \(got"
    with pytest.raises(ValueError, match=match):
        conv().step(torch.zeros(x), torch.zeros(state))


@pytest.mark.parametrize("num_frames", [1, 5, 12])
def test_causal_temporal_conv_of_the_frames_that_are_needed(num_frames):
    first, second = conv(3, 5, 3, 2), conv(5, 4, 2, 4)
    x = samples(2, num_frames, 3)
    whole = second(first(x))
    needed = first(x, stride=4)
    assert torch.allclose(needed, first(x)[:, (num_frames - 1) % 4 :: 4], atol=1e-6)
    assert torch.allclose(second(needed, spacing=4)[:, -1], whole[:, -1], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"spacing": 3}, r"'spacing' must divide the dilation 4 \(got 3\)"),
        ({"spacing": 0}, r"'spacing' must divide the dilation 4 \(got 0\)"),
        ({"stride": 0}, r"'stride' must be at least 1 \(got 0\)"),
    ],
)
def test_causal_temporal_conv_bad_frames(arguments, match):
    with pytest.raises(ValueError, match=match):
        conv(3, 5, 3, 4)(torch.zeros(9, 3), **arguments)
