import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.data.frames import cut_windows


@pytest.mark.parametrize("shape", [(2,), (5, 2), ()])
def test_split_and_join_are_inverse(shape):
    x = torch.rand(*shape, 3, 8)
    frames = split_frames(x, 4)
    assert frames.shape == (*shape, 3, 4, 2)
    assert join_frames(frames).equal(x)


def test_split_and_join_bad_shapes():
    with pytest.raises(ValueError, match=r"3 frames of each channel \(got \(2, 8\)\)"):
        split_frames(torch.rand(2, 8), 3)
    with pytest.raises(ValueError, match="must have shape"):
        split_frames(torch.rand(8), 2)
    with pytest.raises(ValueError, match="must have shape"):
        join_frames(torch.rand(2, 8))


@pytest.mark.parametrize("dtype", [torch.float, torch.double, torch.half, torch.bfloat16])
@pytest.mark.parametrize("form", ["plain", "strided", "grad"])
def test_cut_windows(dtype, form):
    x = torch.rand(9, 4, 2).to(dtype)
    x = x.transpose(1, 2).contiguous().transpose(1, 2) if form == "strided" else x
    x.requires_grad_(form == "grad")
    rows = [slice(2, 5), slice(0, 3), np.array([8, 1, 4]), slice(7, 9)]
    found = split_frames(cut_windows(x, rows, 3), 3).transpose(1, 2)
    for window, index in zip(found[:3], rows, strict=False):
        assert window.equal(x[index])
    assert found[3, :2].equal(x[7:])
    assert found[3, 2].isnan().all()
    assert cut_windows(x, [], 3).shape == (0, 4, 6)
