"""The encoder of touch for policies: plain tensors with time before the taxels."""

import copy
import pickle

import numpy as np
import pytest
import torch
from small_models import LAYOUT, samples

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import TemporalTaxelNet, TouchEncoder
from torch_geometric_tactile.sensors import grid

NUM_TAXELS = LAYOUT.num_taxels
MAKERS = {
    "small": lambda: TouchEncoder(LAYOUT, 5, in_channels=3),
    "joints": lambda: TouchEncoder(LAYOUT, 5, in_channels=3, num_joints=2),
    "slow": lambda: TouchEncoder(LAYOUT, 5, in_channels=3, filter_size=1, num_blocks=2),
    "pooled": lambda: TouchEncoder(grid(12, 12, 0.002), 5, in_channels=3),
}
every_encoder = pytest.mark.parametrize("name", MAKERS)


def trained(name, dtype=torch.float):
    """An encoder whose running statistics are those of a batch, in evaluation."""
    torch.manual_seed(0)
    encoder = MAKERS[name]()
    inputs = encoder_inputs(encoder, 6, 12)
    encoder(inputs[0] * 2 + 1, *inputs[1:])
    return encoder.to(dtype).eval()


def encoder_inputs(encoder, batch_size, num_frames, dtype=torch.float):
    touch = samples(batch_size, num_frames, encoder.num_taxels, 3, seed=1).to(dtype)
    if not encoder.num_joints:
        return [touch]
    return [touch, samples(batch_size, num_frames, encoder.num_joints, seed=2).to(dtype)]


def streamed(encoder, touch, joint=None):
    """The features after all frames, taken one by one."""
    state = encoder.initial_state(len(touch), dtype=touch.dtype)
    for t in range(touch.size(1)):
        angles = () if joint is None else (joint[:, t],)
        out, state = encoder.step(touch[:, t], state, *angles)
    return out


@every_encoder
def test_features_are_those_of_the_network_on_joined_frames(name):
    encoder = trained(name)
    touch, *joint = encoder_inputs(encoder, 4, 9)
    windows = join_frames(touch.transpose(1, 2))
    angles = {"joint": joint[0][:, -1]} if joint else {}
    assert isinstance(encoder.net, TemporalTaxelNet)
    torch.testing.assert_close(encoder(touch, *joint), encoder.net(windows, **angles))
    if joint:
        torch.testing.assert_close(encoder(touch, joint[0][:, -1]), encoder(touch, *joint))


@every_encoder
@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_streaming_equals_window(name, missing, dtype):
    encoder = trained(name, dtype)
    touch, *joint = encoder_inputs(encoder, 3, encoder.receptive_field + 5, dtype)
    if missing:
        touch[0, -2:, 1] = torch.nan
        touch[1, 3] = torch.nan
    out = streamed(encoder, touch, *joint)
    torch.testing.assert_close(out, encoder(touch, *joint), atol=1e-5, rtol=1e-5)
    length = encoder.receptive_field
    window = encoder(touch[:, -length:], *[j[:, -length:] for j in joint])
    torch.testing.assert_close(out, window, atol=1e-5, rtol=1e-5)


@every_encoder
def test_features_depend_on_the_receptive_field_alone(name):
    encoder = trained(name)
    touch, *joint = encoder_inputs(encoder, 2, encoder.receptive_field + 1)
    out = encoder(touch, *joint)
    older, oldest = touch.clone(), touch.clone()
    older[:, 0] += 5
    oldest[:, 1] += 5
    assert torch.equal(encoder(older, *joint), out)
    assert not torch.allclose(encoder(oldest, *joint), out, atol=1e-4)


def test_missing_readings_count_as_rest():
    encoder = trained("small")
    (touch,) = encoder_inputs(encoder, 2, 8)
    touch[:, 2, 3] = 0
    missing = touch.clone()
    missing[:, 2, 3] = torch.nan
    assert torch.equal(encoder(missing), encoder(touch))
    assert missing.isnan().any()  # the caller's readings stay


def test_taxels_are_dropped_in_training_only():
    (touch,) = encoder_inputs(MAKERS["small"](), 64, 8)
    encoder = TouchEncoder(LAYOUT, 5, in_channels=3, taxel_dropout=0.5)
    assert not torch.allclose(encoder(touch), encoder(touch))
    encoder.eval()
    assert torch.equal(encoder(touch), encoder(touch))


def test_gradients_reach_readings_and_weights():
    encoder = trained("joints").double()
    touch, joint = encoder_inputs(encoder, 2, encoder.receptive_field, torch.double)
    encoder(touch.requires_grad_(), joint).square().sum().backward()
    assert (touch.grad.abs().sum(dim=(0, 2, 3)) > 0).all()  # each frame
    assert all(value.grad.abs().sum() > 0 for value in encoder.parameters())


@every_encoder
def test_copies_and_states_give_the_same(name, tmp_path):
    encoder = trained(name)
    inputs = encoder_inputs(encoder, 2, 7)
    torch.save(encoder.state_dict(), tmp_path / "weights.pt")
    other = MAKERS[name]().eval()
    other.load_state_dict(torch.load(tmp_path / "weights.pt", weights_only=True))
    for again in (other, copy.deepcopy(encoder), pickle.loads(pickle.dumps(encoder))):
        assert torch.equal(again(*inputs), encoder(*inputs))
    other.reset_parameters()
    assert not torch.allclose(other(*inputs), encoder(*inputs))


@pytest.mark.parametrize(
    "shape", [(2, 8, 4, 3), (2, 8, NUM_TAXELS * 3), (8, NUM_TAXELS, 3), (2, 8, NUM_TAXELS, 2)]
)
def test_other_shapes_are_refused(shape):
    message = rf"'touch' must have shape \(batch_size, num_frames, {NUM_TAXELS}, 3\) \(got "
    with pytest.raises(ValueError, match=message):
        MAKERS["small"]()(torch.zeros(shape))


@pytest.mark.full
@every_encoder
def test_compiled_and_exported_encoders_give_the_same(name):
    encoder = trained(name)
    inputs = encoder_inputs(encoder, 3, 8)
    compiled = torch.compile(encoder, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(*inputs), encoder(*inputs))
    shapes = [{0: torch.export.Dim("batch")} for _ in inputs]
    exported = torch.export.export(encoder, tuple(inputs), dynamic_shapes=shapes).module()
    for batch_size in (3, 7):
        others = encoder_inputs(encoder, batch_size, 8)
        others[0][0, -1, 0] = torch.nan
        torch.testing.assert_close(exported(*others), encoder(*others))


@pytest.mark.full
@every_encoder
def test_onnx_gives_the_same(name, tmp_path):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    import onnxruntime

    encoder = trained(name)
    inputs = encoder_inputs(encoder, 3, 8)
    shapes = [{0: torch.export.Dim("batch")} for _ in inputs]
    program = torch.onnx.export(
        encoder, tuple(inputs), dynamo=True, dynamic_shapes=shapes, opset_version=18
    )
    program.save(tmp_path / "encoder.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "encoder.onnx")
    others = encoder_inputs(encoder, 5, 8)
    others[0][0, -1, 0] = torch.nan
    names = [value.name for value in session.get_inputs()]
    (out,) = session.run(None, {n: value.numpy() for n, value in zip(names, others, strict=True)})
    np.testing.assert_allclose(out, encoder(*others).detach().numpy(), atol=1e-5)
