import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import SelectChannels


def test_select_channels_by_hand():
    transform = SelectChannels([2, 0])
    assert transform(Data(x=torch.tensor([[1, 2, 3], [4, 5, 6]]))).x.tolist() == [[3, 1], [6, 4]]


@pytest.mark.parametrize("num_samples", [1, 2, 4])
@pytest.mark.parametrize("channels", [[0], [1, 2], torch.tensor([2, 1, 0])])
def test_select_channels_laws(num_samples, channels):
    data = StaticData(x=torch.rand(num_samples, 4, 3))
    assert_transform_static_equals_batched(SelectChannels(channels), data)
    out = SelectChannels(channels)(data)
    expected = torch.stack([data.x[..., int(i)] for i in channels], dim=-1)
    assert torch.equal(out.x, expected)
    assert data.x.size(-1) == 3  # the caller's


@pytest.mark.parametrize("channels", [[], [[0]], [0.5], [True], 1])
def test_select_channels_needs_numbers(channels):
    with pytest.raises(ValueError, match="'channels' must be a list of numbers of channels"):
        SelectChannels(channels)


@pytest.mark.parametrize("channels", [[-1], [0, 1, 0]])
def test_select_channels_counts_from_zero_and_names_each_once(channels):
    with pytest.raises(ValueError, match=r"numbered from 0, each named once \(got \["):
        SelectChannels(channels)


def test_select_channels_that_are_not_there():
    with pytest.raises(ValueError, match=r"must have channel 3 \(got 3 channels, numbered from 0"):
        SelectChannels([0, 3])(Data(x=torch.zeros(2, 3)))
    with pytest.raises(ValueError, match=r"SelectChannels needs 'x' \(got none\)"):
        SelectChannels([0])(Data(pos=torch.zeros(2, 3)))
