"""What transforms do on windows of frames, (N, C * T): channel outer, time inner."""

import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData, join_frames, split_frames
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import (
    FillMissing,
    Normalize,
    RandomGain,
    RandomMirror,
    RandomNoise,
    RandomOffset,
    RandomShift,
    RandomTimeShift,
    SelectChannels,
    SessionZScore,
    ZScore,
)

PAD = grid(2, 3, 0.01)
T = 5


def frames(num_samples=8, dtype=torch.double):
    draw = torch.Generator().manual_seed(0)
    return torch.rand(num_samples, 6, T, 3, generator=draw, dtype=dtype) + 1


def windows(values=None, **more):
    return StaticData(x=join_frames(frames() if values is None else values), num_frames=T, **more)


def seeded(transform, data):
    torch.manual_seed(0)
    return split_frames(transform(data).x, T)


def test_signals_are_scaled_by_hand():
    x = torch.tensor(
        [[[1.0, 3.0, 0.0, 0.0]], [[5.0, 7.0, 10.0, torch.nan]]]
    )  # 2 channels, 2 frames
    scaler = ZScore(per="signal").fit(StaticData(x=x, num_frames=2))
    assert scaler.center.tolist() == [[[4.0, pytest.approx(10 / 3)]]]
    assert scaler.scale.tolist() == [[[pytest.approx(5**0.5), pytest.approx((200 / 9) ** 0.5)]]]
    out = scaler(Data(x=x[0], num_frames=2)).x
    assert out[0, :2].tolist() == pytest.approx([-3 / 5**0.5, -1 / 5**0.5])
    assert out[0, 2] == out[0, 3]


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_signals_have_mean_zero_and_deviation_one_over_all_frames(dtype):
    values = 3000 + frames(dtype=dtype) * torch.tensor([1, 10, 100], dtype=dtype)
    values[:, 2, 3] = torch.nan
    values[:, 4, :, 1] = 7.0  # never changes
    data = windows(values)
    scaler = ZScore(per="signal").fit(data)
    out = split_frames(scaler(data).x, T)
    mean, scale = out.nanmean(dim=(0, 2)), (out - out.nanmean(dim=(0, 2), keepdim=True)[:, :, :1])
    assert mean.abs().max() < 1e-4
    deviation = scale.square().nanmean(dim=(0, 2)).sqrt()
    expected = torch.ones(6, 3, dtype=dtype)
    expected[4, 1] = 0
    assert deviation.allclose(expected, atol=1e-4)
    # Frames differ, unlike with a scale of each: their order in time is still there.
    each = split_frames(ZScore().fit(data)(data).x, T)
    each, out = (part.nan_to_num().mean(dim=0).abs().max() for part in (each, out))
    assert each < 1e-3 < 0.1 < out


@pytest.mark.parametrize(
    "make",
    [
        lambda: ZScore(per="signal"),
        lambda: ZScore(per="signal", scale_per="channel"),
        lambda: Normalize(per="signal"),
        lambda: SessionZScore(per="signal"),
    ],
    ids=["signal", "channel scale", "normalize", "session"],
)
def test_state_and_other_lengths_of_signals(make):
    data = windows(session=torch.arange(8) // 4)
    scaler = make().fit(data)
    again = make()
    again.load_state_dict(scaler.state_dict())
    assert again(data).x.equal(scaler(data).x)
    first = scaler(data)
    shorter = StaticData(
        x=join_frames(frames()[:, :, 1:4]), num_frames=3, session=torch.arange(8) // 4
    )
    expected = split_frames(first.x, T)[:, :, 1:4]
    assert split_frames(scaler(shorter).x, 3).allclose(expected, atol=1e-12)
    assert scaler(data).x.equal(first.x)  # what was kept for other lengths is not taken


def test_padding_is_left_out_of_the_fit():
    values = frames()
    values[:, :, 3:] = torch.nan
    padded = windows(values, valid_frames=torch.full((8,), 3))
    scaler = ZScore(per="signal").fit(padded)
    short = StaticData(x=join_frames(values[:, :, :3]), num_frames=3)
    expected = ZScore(per="signal").fit(short).center
    assert scaler.center.allclose(expected, rtol=0, atol=1e-12)


def test_scale_of_channels_and_centre_of_signals():
    scaler = ZScore(per="signal", scale_per="channel").fit(windows())
    assert str(scaler) == "ZScore(per='signal', scale_per='channel')"
    assert scaler.center.shape == scaler.scale.shape == (1, 6, 3)
    assert (scaler.scale == scaler.scale[:, :1]).all()


def test_signals_are_fitted_on_the_samples_that_are_given():
    values = frames()
    first = ZScore(per="signal").fit(windows(values[:4]))
    assert not first.center.allclose(ZScore(per="signal").fit(windows(values)).center)
    listed = ZScore(per="signal").fit(windows(values).to_data_list())
    assert listed.center.equal(ZScore(per="signal").fit(windows(values)).center)


def test_signals_bad():
    scaler = ZScore(per="signal")
    with pytest.raises(ValueError, match=r"ZScore needs 'num_frames' \(got none\): .*Windows"):
        scaler.fit(StaticData(x=windows().x))
    scaler.fit(windows())
    with pytest.raises(ValueError, match=r"ZScore needs 'num_frames' \(got none\): .*Windows"):
        scaler(StaticData(x=windows().x))
    with pytest.raises(ValueError, match=r"'x' must have 6 taxels and 9 features, .*6, 15\)"):
        scaler(StaticData(x=windows().x, num_frames=3))
    with pytest.raises(ValueError, match=r"'attr' must be 'x' with per='signal' \(got 'joint'\)"):
        ZScore(attr="joint", per="signal")
    for per, scale_per in (("signal", "taxel"), ("taxel", "signal"), ("channel", "signal")):
        with pytest.raises(
            ValueError, match=r"'scale_per' must be 'channel', 'all' or the same as 'per'"
        ):
            ZScore(per=per, scale_per=scale_per)


def test_channels_are_selected_with_all_their_frames():
    data = windows()
    out = SelectChannels([2, 0])(data)
    assert split_frames(out.x, T).equal(frames()[..., [2, 0]])
    columns = SelectChannels([2, 0])(StaticData(x=data.x))  # of no windows, the numbers of a taxel
    assert columns.x.equal(data.x[..., [2, 0]])
    with pytest.raises(ValueError, match=r"must have channel 3 \(got 3 channels, numbered"):
        SelectChannels([3])(data)


def test_gains_and_offsets_stay_over_time():
    for transform, drawn in (
        (RandomGain(0.5), lambda out: out / frames()),
        (RandomOffset(0.5, [0, 0, 0, 1, 1, 1]), lambda out: out - frames()),
    ):
        change = drawn(seeded(transform, windows()))
        assert change.allclose(change[:, :, :1].expand_as(change), atol=1e-6)
        assert change[:, 0, 0].std() > 0.1  # samples and channels have their own
        assert not change[:, :, :, 0].allclose(change[:, :, :, 1])
        batch = seeded(transform, windows().to_batch()).view(8, 6, T, 3)
        assert batch.equal(seeded(transform, windows()))
        static = StaticData(x=frames()[:, :, 0])
        assert not transform(static).x.isnan().any()


def test_noise_is_of_each_frame():
    noise = seeded(RandomNoise(1.0), windows()) - frames()
    assert noise.diff(dim=2).abs().min() > 0


def test_mirror_turns_a_channel_round_in_all_frames():
    out = seeded(RandomMirror(PAD, p=1.0, negate=1), windows())
    mirrored = frames().view(8, 2, 3, T, 3).flip(2).view(8, 6, T, 3)
    assert out.equal(mirrored * torch.tensor([1.0, -1.0, 1.0]))
    with pytest.raises(
        ValueError, match=r"'negate' must be below the number of channels, 3 \(got 3\)"
    ):
        RandomMirror(PAD, negate=3)(windows())


def test_image_shift_moves_all_frames():
    out = seeded(RandomShift(PAD, 0, 0), windows())
    assert out.equal(frames())


def test_time_shift_knows_the_frames_of_windows():
    data = windows()
    found = seeded(RandomTimeShift(2), data)
    assert found.equal(seeded(RandomTimeShift(2, num_frames=T), data))
    moved = 0
    for i in range(8):
        steps = [
            step
            for step in range(-2, 3)
            if found[i].equal(frames()[i][:, (torch.arange(T) - step).clamp(0, T - 1)])
        ]
        assert len(steps) == 1
        moved += steps[0] != 0
    assert moved > 2
    with pytest.raises(ValueError, match=r"'num_frames' must be 5, as in the win.* \(got 3\)"):
        RandomTimeShift(1, num_frames=3)(data)
    data.valid_frames = torch.full((8,), 4)
    with pytest.raises(ValueError, match=r"RandomTimeShift needs windows of one length .*Resam"):
        RandomTimeShift()(data)


def test_padding_makes_no_taxel_missing():
    values = frames(3)
    values[0, :, 2:] = torch.nan
    values[1, 4, 1, 2] = torch.nan
    data = windows(values, valid_frames=torch.tensor([2, 5, 5]))
    out = FillMissing()(data)
    assert out.x.isfinite().all()
    assert out.missing.nonzero().tolist() == [[1, 4]]
    assert_transform_static_equals_batched(FillMissing(), data, atol=0)
    whole = FillMissing()(windows(values))
    assert whole.missing[0].all()
