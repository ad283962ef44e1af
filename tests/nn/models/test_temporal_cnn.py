import pytest
import torch
from small_models import samples
from torch.nn.functional import batch_norm, conv1d

from torch_geometric_tactile.data import join_frames
from torch_geometric_tactile.nn import TemporalCNN
from torch_geometric_tactile.sensors import grid

EDGES = torch.tensor([[0, 1], [1, 0]])


def small(dtype=torch.float, **more):
    torch.manual_seed(0)
    more = {"in_channels": 3, "widths": (6, 6, 5), "kernel_sizes": (5, 3), **more}
    return TemporalCNN(4, 2, **more).to(dtype).eval()


def frames(num_samples=6, num_frames=9, dtype=torch.float):
    return samples(num_samples, 4, num_frames, 3, seed=1).to(dtype)


def with_statistics(model):
    """Statistics and weights of normalisations that are not those of the start."""
    draw = torch.Generator().manual_seed(2)
    with torch.no_grad():
        for name, value in model.state_dict().items():
            if value.dim() == 1:
                noise = torch.rand(value.shape, generator=draw, dtype=torch.double)
                value.add_((0.5 * noise).to(value) if "var" in name else noise.to(value) - 0.5)
    return model


def test_repr_and_number_of_parameters():
    model = TemporalCNN("biotac", 2, in_channels=3)
    assert str(model) == (
        "TemporalCNN(19, 2, in_channels=3, widths=(64, 64, 64), kernel_sizes=(7, 5))"
    )
    assert model.needs_edges is False

    def block(before, after):
        convs = 7 * before * after + 5 * after * after + 2 * 2 * after
        return convs + (before * after + 2 * after if before != after else 0)

    head = 2 * 64 * 2 + 2
    expected = block(3 * 19, 64) + block(64, 64) + block(64, 64) + head
    assert sum(weight.numel() for weight in model.parameters()) == expected


def test_value_by_hand():
    # The kernel of ones sums up three frames, outside of which are zeros; the input is added.
    model = TemporalCNN(1, 1, widths=(1,), kernel_sizes=(3,)).eval()
    with torch.no_grad():
        for weight in model.parameters():
            weight.fill_(1.0)
        model.blocks[0].norms[0].bias.zero_()
        model.blocks[0].norms[0].eps = 0.0
    # Sums 3, -1, -1 and -3; with the readings 4, 1, -5 and -2; after ReLU 4, 1, 0 and 0.
    x = torch.tensor([[[1.0, 2.0, -4.0, 1.0]]])
    assert model(x).tolist() == [[5 / 4 + 4 + 1]]  # mean, maximum and bias


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_is_a_plain_residual_network_on_signals(dtype):
    """Channel by channel in each taxel, with a linear map where widths differ."""
    model, x = with_statistics(small(dtype)), frames(dtype=dtype)
    state = model.state_dict()

    def norm(h, name):
        mean, var, weight, bias = (
            state[f"{name}.{key}"] for key in ("running_mean", "running_var", "weight", "bias")
        )
        return batch_norm(h, mean, var, weight, bias)

    h = torch.stack([x[:, :, t].flatten(1) for t in range(9)], dim=2)
    for i, widens in enumerate((True, False, True)):  # from 12 to 6, 6 and 5
        name = f"blocks.{i}"
        out = conv1d(h, state[f"{name}.convs.0.weight"], padding=2)
        out = norm(out, f"{name}.norms.0").relu()
        out = conv1d(out, state[f"{name}.convs.1.weight"], padding=1)
        out = norm(out, f"{name}.norms.1")
        if widens:
            h = norm(conv1d(h, state[f"{name}.shortcut.0.weight"]), f"{name}.shortcut.1")
        h = (out + h).relu()
    pooled = torch.cat([h.mean(dim=2), h.max(dim=2).values], dim=1)
    expected = pooled @ state["lin_out.weight"].t() + state["lin_out.bias"]
    tolerance = 1e-5 if dtype == torch.float else 1e-12
    torch.testing.assert_close(model(join_frames(x)), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize("num_frames", [1, 2, 9, 30])
def test_forms_of_windows_of_any_length_agree(dtype, num_frames):
    model, x = with_statistics(small(dtype)), join_frames(frames(5, num_frames, dtype))
    out = model(x)
    assert out.shape == (5, 2)
    assert out.dtype == dtype
    tolerance = {"rtol": 0, "atol": 1e-5 if dtype == torch.float else 1e-12}
    torch.testing.assert_close(model(x.flatten(0, 1), EDGES), out, **tolerance)  # a PyG batch
    torch.testing.assert_close(torch.cat([model(row) for row in x]), out, **tolerance)
    assert model(x[:0]).shape == (0, 2)


def test_the_whole_window_counts_in_its_order():
    """Every frame has a gradient, the first as large as the last, and time has a direction."""
    model = with_statistics(small(torch.double))
    x = frames(20, 30, torch.double).requires_grad_()
    model(join_frames(x)).square().sum().backward()
    size = x.grad.abs().mean(dim=(0, 1, 3))
    assert (size > 0).all()
    assert 1 / 3 < size[:10].mean() / size[-10:].mean() < 3
    with torch.no_grad():
        turned = model(join_frames(x.flip(2)))
        assert not turned.allclose(model(join_frames(x)), atol=1e-3)


def test_the_answer_of_a_motif_does_not_depend_on_its_place():
    # Away from the ends of the window, where zeros stand beside it.
    model, motif = with_statistics(small(torch.double)), 9 * frames(3, 5, torch.double)
    outs = []
    for place in (20, 33):
        x = torch.zeros(3, 4, 60, 3, dtype=torch.double)
        x[:, :, place : place + 5] = motif
        outs.append(model(join_frames(x)))
    torch.testing.assert_close(*outs, rtol=0, atol=1e-12)
    silence = model(torch.zeros(1, 4, 180, dtype=torch.double))
    assert (outs[0] - silence).abs().max() > 0.01


def test_one_taxel_and_one_frame():
    assert TemporalCNN(1, 2, widths=(3,)).eval()(torch.zeros(3, 1, 1)).shape == (3, 2)
    assert TemporalCNN(1, 2, in_channels=3)(torch.zeros(3, 1, 3)).shape == (3, 2)  # in training


def test_dropout_is_of_training_alone():
    model, x = small(dropout=0.5), join_frames(frames())
    assert model(x).equal(model(x))
    model.train()
    assert not model(x).equal(model(x))
    sure = small(dropout=0.0).train()
    assert sure(x).equal(sure(x))


def test_reset_parameters_draws_what_a_new_model_has():
    first = small().state_dict()
    model = with_statistics(small())
    assert not any(model.state_dict()[name].equal(first[name]) for name in first if "bias" in name)
    torch.manual_seed(0)
    model.reset_parameters()
    assert all(value.equal(first[name]) for name, value in model.state_dict().items())


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"kernel_sizes": ()}, r"'kernel_sizes' must be odd numbers of frames \(got \(\)"),
        ({"kernel_sizes": (3, 4)}, r"'kernel_sizes' must be odd numbers of frames \(got \(3, 4\)"),
        ({"kernel_sizes": (-1,)}, r"'kernel_sizes' must be odd numbers of frames \(got \(-1,\)"),
        ({"kernel_sizes": (3.0,)}, r"'kernel_sizes' must be odd numbers of frames \(got \(3.0,\)"),
        ({"dropout": 2.0}, "dropout probability has to be between 0 and 1"),
    ],
)
def test_bad_arguments(arguments, match):
    with pytest.raises(ValueError, match=match):
        TemporalCNN(grid(2, 2, 0.01), 2, **arguments)


def test_bad_windows():
    model = small()
    for size in ((6, 4, 20), (6, 4, 0), ()):
        with pytest.raises(
            ValueError, match=r"same number of frames, .* each of 3 channels .*got s"
        ):
            model(torch.zeros(size))
    for size in ((6, 5, 21), (7, 21)):
        with pytest.raises(ValueError, match=r"'x' must have 4 taxels in each sample .*got shape"):
            model(torch.zeros(size))
    for size in ((2, 6, 4, 21), (21,)):
        with pytest.raises(ValueError, match=r"'x' must have 21 features \(got shape"):
            model(torch.zeros(size))
