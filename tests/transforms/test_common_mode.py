import pytest
import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import allegro_uskin, biotac_sp
from torch_geometric_tactile.transforms import CommonMode

LAYOUT = allegro_uskin()


def counts(num_samples=4, num_taxels=384, num_channels=3):
    draw = torch.Generator().manual_seed(0)
    size = (num_samples, num_taxels, num_channels)
    return StaticData(x=torch.randint(0, 65535, size, generator=draw).float())


def all_kinds():
    return [CommonMode(), CommonMode("digit", LAYOUT), CommonMode("patch", "allegro_uskin")]


def test_all_taxels_by_hand():
    x = torch.tensor([[1.0, 10.0], [3.0, 20.0], [8.0, 60.0]])
    expected = torch.tensor([[-3.0, -20.0], [-1.0, -10.0], [4.0, 30.0]])
    assert CommonMode()(Data(x=x)).x.equal(expected)


def test_segments_by_hand():
    x = torch.tensor([[1.0], [3.0], [8.0], [10.0]])
    assert CommonMode([7, 2, 7, 2])(Data(x=x)).x.view(-1).tolist() == [-3.5, -3.5, 3.5, 3.5]


def test_missing_readings_are_left_out_and_stay():
    nan = torch.nan
    x = torch.tensor([[1.0, nan], [nan, nan], [3.0, 5.0], [nan, 7.0]])
    found = CommonMode([0, 0, 1, 1])(Data(x=x)).x
    expected = torch.tensor([[0.0, nan], [nan, nan], [0.0, -1.0], [nan, 1.0]])
    torch.testing.assert_close(found, expected, equal_nan=True)


@pytest.mark.parametrize(
    ("transform", "by"), [(all_kinds()[1], "digit"), (all_kinds()[2], "patch")]
)
def test_offsets_of_segments_are_gone(transform, by):
    data = counts()
    segment = LAYOUT.segments(by)
    offset = torch.randint(-9999, 9999, (4, int(segment.max()) + 1, 3)).float()
    shifted = StaticData(x=data.x + offset[:, segment])
    torch.testing.assert_close(transform(shifted).x, transform(data).x, atol=0.01, rtol=0)
    assert not torch.allclose(CommonMode()(shifted).x, CommonMode()(data).x, atol=100)
    means = torch.zeros(4, len(offset[0]), 3).index_add_(1, segment, transform(data).x)
    assert float(means.abs().max()) < 0.5


def test_uniform_pressure_is_destroyed():
    x = torch.full((24, 3), 512.0)
    assert not CommonMode()(Data(x=x)).x.any()


def test_fingers_as_channels_are_each_finger():
    data = counts(num_taxels=24)
    found = CommonMode()(data).x
    assert len(biotac_sp()) == 24
    expected = data.x.double() - data.x.double().mean(dim=1, keepdim=True)
    assert found.equal(expected.float())


def test_integers_and_samples_of_other_sizes():
    assert CommonMode()(Data(x=torch.tensor([[1], [2]]))).x.tolist() == [[-0.5], [0.5]]
    parts = [Data(x=torch.rand(n, 2)) for n in (2, 7, 1)]
    batch = CommonMode()(Batch.from_data_list(parts)).x
    assert batch.equal(torch.cat([CommonMode()(Data(x=part.x)).x for part in parts]))


def test_gradients_pass():
    x = torch.rand(3, 1, requires_grad=True)
    data = Data(x=x)
    CommonMode()(data).x[0].sum().backward()
    torch.testing.assert_close(x.grad, torch.tensor([[2 / 3], [-1 / 3], [-1 / 3]]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("digit",), r"'segments' requires a 'layout' if it is a name \(got 'digit'\)"),
        (("link", LAYOUT), r"'by' must be one of .* \(got 'link'\)"),
        (([0, 1], LAYOUT), r"'segments' must have 384 numbers, .* layout 'allegro_uskin' .* 2"),
        (([0.5, 1.0],), "'segments', if neither 'digit' nor 'patch', must be a whole number"),
    ],
)
def test_bad_segments(arguments, message):
    with pytest.raises(ValueError, match=message):
        CommonMode(*arguments)


def test_bad_samples():
    with pytest.raises(ValueError, match=r"must have 3 taxels, as in its segments \(got 2\)"):
        CommonMode([0, 0, 1])(Data(x=torch.zeros(2, 1)))
