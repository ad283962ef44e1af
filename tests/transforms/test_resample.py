import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData, join_frames, split_frames
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import Resample
from torch_geometric_tactile.transforms.resample import _resampling_matrix

LENGTHS = [2, 3, 7, 12, 13, 40, 41, 61, 100]


def ragged(dtype=torch.double, num_samples=6, num_frames=30):
    draw = torch.Generator().manual_seed(0)
    frames = torch.randn(num_samples, 4, num_frames, 3, generator=draw, dtype=dtype)
    valid = torch.tensor([30, 12, 1, 9, 12, 5])[:num_samples]
    frames[torch.arange(num_frames) >= valid.unsqueeze(1)[:, None].expand(-1, 4, -1)] = torch.nan
    return StaticData(x=join_frames(frames), num_frames=num_frames, valid_frames=valid)


def signal(values, num):
    """One signal, resampled."""
    values = torch.as_tensor(values).view(1, -1)
    return Resample(num)(Data(x=values, num_frames=values.size(1))).x.view(-1)


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_static_batched_and_one_by_one_are_one(dtype):
    for num in (5, 9, 30):
        assert_transform_static_equals_batched(Resample(num), ragged(dtype), atol=0)


def test_windows_become_regular():
    data = ragged()
    out = Resample(9)(data)
    assert out.x.shape == (6, 4, 27)
    assert out.num_frames == 9
    assert "valid_frames" not in out
    assert out.x.isfinite().all()
    stacked = Data(x=data.x, num_frames=30, valid_frames=data.valid_frames)
    assert Resample(9)(stacked).x.equal(out.x)


def test_padding_is_never_read():
    data = ragged()
    expected = Resample(9)(data).x
    data.x = data.x.nan_to_num(nan=1e9)
    assert Resample(9)(data).x.equal(expected)


def test_fingers_are_not_mixed_with_frames():
    """Each finger's signal is what it is alone; channel outer, time inner."""
    frames = torch.randn(1, 2, 20, 3, dtype=torch.double)
    out = Resample(7)(StaticData(x=join_frames(frames), num_frames=20)).x
    for finger in range(3):
        alone = signal(frames[0, 1, :, finger], 7)
        assert split_frames(out, 7)[0, 1, :, finger].allclose(alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("num", [2, 3, 12, 60])
def test_constants_ramps_and_ends_are_kept(length, num):
    for dtype, atol in ((torch.float, 1e-4), (torch.double, 1e-11)):
        constant = torch.full((length,), 1234.567, dtype=dtype)
        assert signal(constant, num).equal(constant[:1].expand(num))
        ramp = torch.arange(length, dtype=dtype) * 3 - 7
        expected = torch.linspace(-7, float(ramp[-1]), num, dtype=dtype)
        assert signal(ramp, num).allclose(expected, rtol=0, atol=atol)
        values = torch.randn(length, dtype=dtype, generator=torch.Generator().manual_seed(length))
        out = signal(values, num)
        assert (out[0], out[-1]) == (values[0], values[-1])


def test_one_frame_is_repeated_and_as_many_are_left_alone():
    assert signal([3.5], 4).tolist() == [3.5] * 4
    values = torch.randn(60)
    assert signal(values, 60).equal(values)


@pytest.mark.parametrize("length", [241, 177, 300])
def test_fast_signals_do_not_come_back_as_slow_ones(length):
    step = (length - 1) / 59
    frames, new = torch.arange(length, dtype=torch.double), torch.arange(60, dtype=torch.double)
    inner = slice(12, -12)
    for part, most in ((1.25, 0.002), (1.7, 0.001), (2.6, 0.001)):  # of half the new rate
        fast = torch.sin(torch.pi * part * frames / step)
        assert signal(fast, 60)[inner].abs().max() < most
        picked = torch.sin(torch.pi * part * new)
        assert picked[inner].abs().max() > 0.9  # what picking frames would give
    for part in (0.1, 0.5, 0.8):
        slow = signal(torch.sin(torch.pi * part * frames / step), 60)
        assert slow[inner].allclose(torch.sin(torch.pi * part * new)[inner], rtol=0, atol=0.003)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_whole_ratios_are_those_of_scipy(factor):
    scipy_signal = pytest.importorskip("scipy.signal")
    values = torch.randn(factor * 59 + 1, dtype=torch.double)
    expected = scipy_signal.resample_poly(values.numpy(), 1, factor)
    found = signal(values, 60)
    inner = slice(10, -10)  # scipy has zeros beyond the ends
    assert found[inner].allclose(torch.from_numpy(expected)[inner], rtol=0, atol=1e-13)
    assert not found.allclose(torch.from_numpy(expected), rtol=0, atol=1e-3)


def test_more_frames_are_straight_lines():
    assert signal([0.0, 4.0, 2.0], 5).tolist() == [0.0, 2.0, 4.0, 3.0, 2.0]
    values = torch.randn(20)
    out = signal(values, 57)
    assert values.min() <= out.min() < out.max() <= values.max()


def test_a_step_rings_by_a_few_percent():
    step = (torch.arange(300) >= 100).double()
    out = signal(step, 60)
    assert -0.06 < out.min() < 0
    assert 1 < out.max() < 1.06


def test_missing_readings_stay_and_do_not_spread():
    frames = torch.randn(1, 3, 100, 2)
    frames[0, 0] = torch.nan  # a dead electrode
    frames[0, 1, 40:60, 1] = torch.nan  # a gap
    frames[0, 2, 50, 0] = torch.nan  # one frame
    whole = frames.clone()
    whole[0, 1, 39:61, 1] = torch.linspace(0, 1, 22) * (frames[0, 1, 60, 1] - frames[0, 1, 39, 1])
    whole[0, 1, 39:61, 1] += frames[0, 1, 39, 1]
    out, other = (
        split_frames(Resample(12)(StaticData(x=join_frames(x), num_frames=100)).x, 12)
        for x in (frames, whole)
    )
    missing = out.isnan()
    assert missing[0, 0].all()
    assert missing[0, 1, :, 1].nonzero().view(-1).tolist() == [5, 6]  # of frames 45 and 54
    assert not missing[0, 1, :, 0].any()
    assert not missing[0, 2].any()  # new frames are nearest to 45 and 54
    kept = ~missing[0, 1]
    assert out[0, 1][kept].allclose(other[0, 1][kept], atol=1e-5)


def test_gaps_at_the_ends_stay():
    values = torch.arange(10.0)
    values[:2], values[-3:] = torch.nan, torch.nan
    assert signal(values, 4).isnan().tolist() == [True, False, False, True]
    missing = signal(values, 19).isnan().nonzero().view(-1)
    assert missing.tolist() == [0, 1, 2, *range(13, 19)]


def test_a_gap_after_the_first_frame_is_a_straight_line():
    values = torch.arange(9.0)
    values[1:3] = torch.nan
    out = signal(values, 5)
    assert out.isnan().tolist() == [False, True, False, False, False]
    assert out[[0, 2, 3, 4]].tolist() == pytest.approx([0.0, 4.0, 6.0, 8.0], abs=1e-4)


def test_single_taxels():
    single = Resample(3)(StaticData(x=torch.rand(2, 1, 5), num_frames=5))  # one taxel
    assert single.x.shape == (2, 1, 3)


def test_gradients_pass():
    x = torch.randn(2, 3, 20, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda x: Resample(4)(StaticData(x=x, num_frames=10)).x, (x,), fast_mode=True
    )


@pytest.mark.parametrize("length", [41, 100])
def test_weights_are_those_of_time_turned_round(length):
    weight = _resampling_matrix(length, 12)
    assert weight.allclose(weight.flip(0, 1), rtol=0, atol=1e-12)


@pytest.mark.parametrize("num", [1, 0, 2.5, True, None, 100_001])
def test_bad_numbers_of_frames(num):
    with pytest.raises(ValueError, match=r"'num' must be an integer between 2 and 100000 \(got "):
        Resample(num)


def test_bad_samples():
    x = torch.zeros(2, 3, 10)
    with pytest.raises(ValueError, match=r"Resample needs 'num_frames' \(got none\): .*Windows"):
        Resample()(StaticData(x=x))
    with pytest.raises(ValueError, match=r"'x' must have shape .*3 frames of each.*2, 3, 10\)"):
        Resample()(StaticData(x=x, num_frames=3))
    for frames in (0, -1, 2.5, torch.tensor([5, 2])):
        with pytest.raises(ValueError, match="'num_frames' must be one integer, at least 1"):
            Resample()(Data(x=x[0], num_frames=frames))
    for valid in (0, 6):
        padded = StaticData(x=x, num_frames=5, valid_frames=torch.tensor([valid, 3]))
        with pytest.raises(ValueError, match=rf"'valid_frames' must be between 1 and 5, .*{valid}"):
            Resample()(padded)
    with pytest.raises(ValueError, match=r"'valid_frames' must have 1 numbers, .* \(got 2\)"):
        Resample()(Data(x=x[0], num_frames=5, valid_frames=torch.tensor([3, 3])))
