import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import GraspLSTM
from torch_geometric_tactile.sensors import grid


def small(dtype=torch.float, **more):
    torch.manual_seed(0)
    more = {"hidden_channels": 5, "num_fingers": 3, **more}
    return GraspLSTM(4, 2, **more).to(dtype).eval()


def frames(num_samples=6, num_frames=7, dtype=torch.float):
    draw = torch.Generator().manual_seed(1)
    return torch.randn(num_samples, 4, num_frames, 3, generator=draw, dtype=dtype)


def num_parameters(model):
    return sum(weight.numel() for weight in model.parameters())


def test_repr():
    assert str(GraspLSTM()) == "GraspLSTM(19, 2, num_fingers=3, hidden_channels=128)"
    assert str(GraspLSTM(24, 4, finger=1, hidden_channels=8, num_layers=2)) == (
        "GraspLSTM(24, 4, num_fingers=3, finger=1, hidden_channels=8, num_layers=2)"
    )
    assert GraspLSTM.needs_edges is False


def test_parameter_counts():
    # Four gates, each of inputs, cells and two biases; then the classes.
    head = 128 * 2 + 2
    for finger, width in ((None, 57), (0, 19), (1, 19), (2, 19)):
        model = GraspLSTM("biotac", 2, finger=finger)
        assert num_parameters(model) == 4 * 128 * (width + 128 + 2) + head
    deep = GraspLSTM(19, num_layers=2)
    assert num_parameters(deep) == 4 * 128 * (57 + 128 + 2) + 4 * 128 * (128 + 128 + 2) + head


def test_one_cell_by_hand():
    """Of one electrode, finger and cell: two frames through the gates."""
    model = GraspLSTM(1, 1, num_fingers=1, hidden_channels=1)
    with torch.no_grad():
        for weight in model.parameters():
            weight.fill_(1.0)
    hidden, cell = 0.0, 0.0
    for reading in (0.5, -1.0):
        gate = reading + hidden + 2  # the same of all four
        sigmoid = 1 / (1 + np.exp(-gate))
        cell = sigmoid * cell + sigmoid * np.tanh(gate)
        hidden = sigmoid * np.tanh(cell)
    out = model(torch.tensor([[[0.5, -1.0]]]))
    assert out.item() == pytest.approx(hidden + 1, abs=1e-6)


@pytest.mark.parametrize("finger", [None, 0, 1, 2])
@pytest.mark.parametrize("num_layers", [1, 2])
def test_is_the_lstm_of_torch_on_frames(finger, num_layers):
    """In each frame electrode by electrode, in each finger by finger."""
    model = small(torch.double, finger=finger, num_layers=num_layers)
    width = 12 if finger is None else 4
    lstm = torch.nn.LSTM(width, 5, num_layers, batch_first=True).double()
    lstm.load_state_dict(model.lstm.state_dict())
    x = frames(dtype=torch.double)
    chosen = x if finger is None else x[..., [finger]]
    rows = torch.stack([chosen[:, :, t].flatten(1) for t in range(7)], dim=1)
    expected = model.lin(lstm(rows)[0][:, -1])
    assert model(join_frames(x)).allclose(expected, rtol=0, atol=1e-12)


def test_draws_weights_as_torch_does():
    torch.manual_seed(0)
    ours = GraspLSTM(4, hidden_channels=400)
    bound = 400**-0.5
    for weight in ours.lstm.parameters():
        assert weight.abs().max() <= bound
        assert weight.std().item() == pytest.approx(bound / 3**0.5, rel=0.1)
    before = [weight.clone() for weight in ours.parameters()]
    ours.reset_parameters()
    assert all(not a.equal(b) for a, b in zip(before, ours.parameters(), strict=True))


def test_order_of_fingers_and_frames():
    """Gradients of one finger's model are in its columns; those of the first frame are smaller."""
    x = frames(dtype=torch.double).requires_grad_()
    small(torch.double, finger=1)(join_frames(x)).square().sum().backward()
    assert x.grad[..., [0, 2]].eq(0).all()
    assert x.grad[..., 1].ne(0).all()
    size = x.grad[..., 1].abs().mean(dim=(0, 1))
    assert size[-1] > 5 * size[0]
    swapped = frames(num_frames=3).transpose(2, 3)  # time outer, fingers inner
    model = small()
    assert not model(join_frames(swapped)).allclose(model(join_frames(frames(num_frames=3))))


def test_last_frame_counts_and_later_ones_are_unknown():
    model, x = small(), frames()
    shorter = model(join_frames(x[:, :, :-1]))
    assert not model(join_frames(x)).allclose(shorter)
    turned = x.flip(2)
    assert not model(join_frames(x)).allclose(model(join_frames(turned)), atol=1e-3)


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_one_frame(dtype):
    x = join_frames(frames(dtype=dtype))
    assert small(dtype, finger=1)(x[:, :, :3]).shape == (6, 2)  # one frame
    assert GraspLSTM(1, hidden_channels=2)(torch.zeros(3, 1, 6)).shape == (3, 2)


@pytest.mark.parametrize("finger", [-1, 3])
def test_bad_finger(finger):
    with pytest.raises(ValueError, match=rf"'finger' must be between 0 and 2 \(got {finger}\)"):
        GraspLSTM(grid(2, 2, 0.01), finger=finger)


def test_bad_windows():
    model = small()
    for size in ((6, 4, 20), (6, 4, 0), ()):
        with pytest.raises(ValueError, match=r"same number of frames for each of 3 fingers \(got"):
            model(torch.zeros(size))
    for size in ((6, 5, 21), (7, 21)):
        with pytest.raises(ValueError, match=r"'x' must have 4 taxels in each sample .*got shape"):
            model(torch.zeros(size))
    with pytest.raises(ValueError, match=r"'x' must have 21 fingers x frames .*got shape"):
        model(torch.zeros(2, 6, 4, 21))
