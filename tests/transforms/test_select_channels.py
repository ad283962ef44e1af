import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.transforms import SelectChannels


def test_select_channels_by_hand():
    x = torch.tensor([[1, 2, 3], [4, 5, 6]])
    for channels in ([2, 0], torch.tensor([2, 0])):
        assert SelectChannels(channels)(Data(x=x)).x.tolist() == [[3, 1], [6, 4]]


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
