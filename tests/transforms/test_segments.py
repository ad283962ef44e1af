import pytest
import torch

from torch_geometric_tactile.transforms._segments import repeat_rows


@pytest.mark.parametrize("shape", [(3,), (3, 2), (2, 4, 3), (0, 2)])
@pytest.mark.parametrize("times", [1, 3])
def test_rows_are_repeated_one_after_another(shape, times):
    rows = torch.arange(torch.Size(shape).numel()).view(shape)
    expected = rows.repeat_interleave(times, dim=0)
    assert torch.equal(repeat_rows(rows, times), expected)
