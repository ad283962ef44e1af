import logging

import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData, join_frames, split_frames
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import ContactCrop, Resample


def grasps(num_samples=40, num_frames=150, dtype=torch.float, speed=4.0, noise=1.5, step=1.0):
    """Grasps of 19 electrodes and three fingers with a known frame of contact of each finger:
    offsets, noise, drift of up to two counts a second, whole counts; pressure that then grows."""
    draw = torch.Generator().manual_seed(0)

    def rand(*size):
        return torch.rand(*size, generator=draw, dtype=torch.double)

    contact = 30 + (90 * rand(num_samples)).long()
    late = contact.unsqueeze(1) + torch.tensor([0, 4, 9])  # the other fingers follow
    time = torch.arange(num_frames)
    pressed = (time - late.unsqueeze(-1) + 1).clamp(min=0)  # (S, C, T)
    gain = (
        rand(num_samples, 19, 3) ** 3 * torch.tensor([1.0, -1.0])[(rand(19) < 0.5).long()][:, None]
    )
    gain[:, 0] = 1.0  # the electrode that is touched
    touch = speed * pressed.transpose(1, 2).unsqueeze(1) * gain.unsqueeze(2)
    offset = 400 + 200 * rand(num_samples, 19, 1, 3)
    drift = 0.02 * (2 * rand(num_samples, 19, 1, 3) - 1) * time.view(-1, 1)
    error = torch.randn(num_samples, 19, num_frames, 3, generator=draw, dtype=torch.double)
    frames = offset + drift + noise * error + touch
    x = join_frames((frames / step).round() * step if step else frames).to(dtype)
    return StaticData(x=x, num_frames=num_frames), contact


def window(values, **more):
    return Data(x=torch.tensor([values], dtype=torch.float), num_frames=len(values), **more)


def test_value_by_hand():
    # Deviations at rest are 1, 1, 0, 2, 0: their median is 1, the threshold 2 * 1.4826.
    values = [10, 12, 11, 13, 11, 20, 11, 14, 15, 16, 9]
    crop = ContactCrop(rest=5, k=2.0, floor=0.0, sustain=2)
    out = crop(window(values))
    assert out.contact_frame.tolist() == [7]  # the spike at 5 does not last
    assert out.valid_frames.tolist() == [4]
    assert out.x[0, :4].tolist() == [14, 15, 16, 9]
    assert out.x[0, 4:].isnan().all()
    assert out.num_frames == 11
    earlier = ContactCrop(rest=5, k=2.0, floor=0.0, sustain=1, before=2)(window(values))
    assert (earlier.contact_frame.item(), earlier.valid_frames.item()) == (5, 8)
    assert earlier.x[0, :3].tolist() == [13, 11, 20]
    later = ContactCrop(rest=5, k=2.0, floor=4.5, sustain=2, missing="keep")(window(values))
    assert later.contact_frame.item() == -1  # 14 is no further than the floor, nor are two in turn
    assert (
        ContactCrop(rest=5, before=99, floor=2.5, k=0, sustain=2)(window(values)).x.isfinite().all()
    )


def test_quiet_taxels_take_the_deviation_of_the_others():
    """Ten frames of one taxel may be equal by chance; the usual noise is no contact."""
    x = torch.tensor([[0.0] * 7 + [4.0, 4.0], [1.0, -2.0] * 4 + [1.0], [1.0, -2.0] * 4 + [1.0]])
    data = Data(x=x, num_frames=9)
    crop = ContactCrop(rest=6, k=2.0, floor=0.0, sustain=2, missing="keep")
    assert crop(data).contact_frame.tolist() == [-1]  # 4 is below 2 * 1.4826 * 1.5
    data.x = x[:1]
    assert crop(data).contact_frame.tolist() == [7]


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
def test_static_batched_and_one_by_one_are_one(dtype):
    data, _ = grasps(6, dtype=dtype)
    data.valid_frames = torch.tensor([150, 149, 140, 150, 148, 145])
    for crop in (ContactCrop(), ContactCrop(before=5, sustain=1, missing="keep")):
        assert_transform_static_equals_batched(crop, data, atol=0)
    assert data.x.isfinite().all()  # the caller's
    one = ContactCrop()(Data(x=data.x[1], num_frames=150, valid_frames=149))
    torch.testing.assert_close(one.x, ContactCrop()(data).x[1], rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.5, 3.0])
def test_contact_is_found_within_a_few_frames(noise):
    """Four counts a frame: five deviations are passed in about 5 * noise / 4 frames."""
    data, contact = grasps(noise=noise)
    found = ContactCrop(missing="keep")(data).contact_frame
    assert (found >= 0).all()
    late = found - contact
    assert late.min() >= 0  # never before it
    assert late.max() <= 1 + 1.5 * noise


def test_noise_alone_is_no_contact():
    data, _ = grasps(200, speed=0.0, noise=2.0, step=0.0)
    found = ContactCrop(missing="keep")(data).contact_frame
    assert found.eq(-1).all()
    careless = ContactCrop(k=2.0, sustain=1, missing="keep")(data).contact_frame
    assert careless.ge(0).float().mean() > 0.9  # so the test above can fail


def test_all_fingers_are_cut_at_one_frame():
    data, _ = grasps(5)
    out = ContactCrop()(data)
    before, after = (split_frames(part.x, 150) for part in (data, out))
    for i in range(5):
        start, left = int(out.contact_frame[i]), int(out.valid_frames[i])
        assert left == 150 - start
        assert after[i, :, :left].equal(before[i, :, start:])
        assert after[i, :, left:].isnan().all()


def test_padding_is_no_contact():
    frames = torch.zeros(1, 20)
    frames[0, 15:] = 100.0  # rubbish behind the end
    crop = ContactCrop(missing="keep")
    data = StaticData(x=frames.unsqueeze(0), num_frames=20, valid_frames=torch.tensor([15]))
    assert crop(data).contact_frame.tolist() == [-1]
    assert crop(data).valid_frames.tolist() == [15]
    data.valid_frames = torch.tensor([17])
    assert crop(data).contact_frame.tolist() == [-1]  # two frames do not last three
    data.valid_frames = torch.tensor([18])
    assert crop(data).contact_frame.tolist() == [15]
    assert crop(data).valid_frames.tolist() == [3]


def test_missing_readings_do_not_count():
    data, contact = grasps(5)
    data.x[:, 3] = torch.nan
    data.x[:, 5, ::7] = torch.nan
    found = ContactCrop()(data)
    assert (found.contact_frame - contact).abs().max() <= 6
    assert found.x[:, 3].isnan().all()
    dead = StaticData(x=torch.full((2, 3, 20), torch.nan), num_frames=20)
    assert ContactCrop(missing="keep")(dead).contact_frame.tolist() == [-1, -1]


def test_windows_without_contact_are_named_and_kept_whole(caplog):
    data, _ = grasps(6)
    data.x[4] = data.x[4, :, :1]
    with pytest.raises(ValueError, match=r"must have contact \(got none in 1 of 6 .*first is 4\)"):
        ContactCrop()(data)
    with caplog.at_level(logging.WARNING):
        out = ContactCrop(missing="keep")(data)
    assert "no contact in 1 of 6 windows, the first is 4: kept unchanged" in caplog.text
    assert out.contact_frame.lt(0).nonzero().view(-1).tolist() == [4]
    assert out.valid_frames[4] == 150
    assert out.x[4].equal(data.x[4])


def test_what_follows_does_not_move_contact():
    """Causal: contact is known `sustain` frames after it, whatever comes."""
    data, _ = grasps(20)
    found = ContactCrop()(data).contact_frame
    frames = split_frames(data.x, 150)
    for i, contact in enumerate(found.tolist()):
        seen = frames[i : i + 1, :, : contact + 3]
        live = StaticData(x=join_frames(seen), num_frames=contact + 3)
        assert ContactCrop()(live).contact_frame.item() == contact
        less = StaticData(x=join_frames(seen[:, :, :-1]), num_frames=contact + 2)
        assert ContactCrop(missing="keep")(less).contact_frame.item() == -1


def test_crop_and_resample_end_at_the_last_frame():
    data, _ = grasps(6)
    out = Resample(60)(ContactCrop()(data))
    last, first = split_frames(out.x, 60)[:, :, -1], split_frames(data.x, 150)[:, :, -1]
    assert last.equal(first)
    assert out.x.isfinite().all()
    assert out.contact_frame.shape == (6,)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"rest": 0}, r"'rest' must be an integer between 1 and 100000 \(got 0\)"),
        ({"sustain": 0}, r"'sustain' must be an integer between 1 and 100000 \(got 0\)"),
        ({"before": -1}, r"'before' must be an integer between 0 and 100000 \(got -1\)"),
        ({"k": -1.0}, r"'k' must be at least 0 and finite \(got -1.0\)"),
        ({"floor": torch.inf}, r"'floor' must be at least 0 and finite \(got inf\)"),
        ({"missing": "drop"}, r"'missing' must be one of \['error', 'keep'\] \(got 'drop'\)"),
    ],
)
def test_bad_arguments(arguments, match):
    with pytest.raises(ValueError, match=match):
        ContactCrop(**arguments)


def test_bad_samples():
    with pytest.raises(ValueError, match=r"'num_frames' must be above 10, .*rest \(got 10\)"):
        ContactCrop()(window([0.0] * 10))
    with pytest.raises(ValueError, match=r"ContactCrop needs 'num_frames' \(got none\)"):
        ContactCrop()(Data(x=torch.zeros(3, 20)))
    data = StaticData(x=torch.zeros(2, 3, 20), num_frames=20)
    batch = data.to_batch()
    batch.ptr = torch.tensor([0, 2, 6])
    with pytest.raises(ValueError, match=r"the same number of taxels \(got \[2, 4\]\)"):
        ContactCrop()(batch)
