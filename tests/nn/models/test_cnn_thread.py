import pytest
import torch
from small_models import EDGE_INDEX, LAYOUT, samples

from torch_geometric_tactile.nn.models import CNNThread
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.testing import assert_permutation_equivariant


def test_cnn_thread_by_hand():
    # A kernel that looks one cell up: the taxel in row 0 sees zeros, the other the first.
    thread = CNNThread(1, torch.tensor([[1, 2], [0, 2], [3, 0]]), (2,), (2,))
    assert str(thread) == "CNNThread(1, widths=(2,), pools=(2,), size=(4, 3))"
    torch.nn.init.zeros_(thread.convs[0].weight)
    with torch.no_grad():
        thread.convs[0].weight[:, 0, 0, 1] = torch.tensor([2.0, 10.0])
        thread.convs[0].bias.copy_(torch.tensor([1.0, -3.0]))
    x = torch.tensor([[[5.0], [7.0], [9.0]]])
    assert torch.allclose(thread(x), torch.tensor([[[67.0], [1.0], [1.0]]]))


def test_cnn_thread_is_not_equivariant():
    thread = CNNThread(3, LAYOUT.image_map, (4,), (1,))
    with pytest.raises(AssertionError, match="permutation equivariant"):
        assert_permutation_equivariant(lambda x, _: thread(x), samples(2, 11, 3), EDGE_INDEX)


def test_cnn_thread_empty_cells_are_zero():
    # What is in a cell without a taxel cannot matter: nothing is there.
    layout = grid(3, 3, pitch=0.01)
    keep = torch.tensor([0, 1, 2, 3, 5, 6, 7, 8])
    whole = CNNThread(2, layout.image_map, (4,), (2,))
    ring = CNNThread(2, layout.image_map[keep], (4,), (2,))
    ring.load_state_dict(whole.state_dict())
    x = samples(2, 9, 2)
    x[:, 4] = 0
    assert torch.allclose(ring(x[:, keep]), whole(x)[:, keep], atol=1e-6)


@pytest.mark.parametrize("size", [(11, 3), (2, 10, 3), (2, 11, 4)])
def test_cnn_thread_bad_shape(size):
    thread = CNNThread(3, LAYOUT.image_map)
    with pytest.raises(ValueError, match=r"'x' must have shape \(batch_size, 11, 3\) \(got"):
        thread(torch.zeros(size))
