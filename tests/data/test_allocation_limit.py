import pytest
import torch

from torch_geometric_tactile.data import _allocation_limit as allocation_limit
from torch_geometric_tactile.data._allocation_limit import AllocationLimit


@pytest.fixture(autouse=True)
def little_room(monkeypatch):
    monkeypatch.setattr(allocation_limit, "MODEL_BYTES", 1000)


def test_a_model_may_take_four_times_its_weights_and_some_room():
    weights = [torch.zeros(50, 10), torch.zeros(500), "no tensor"]  # 4000 bytes
    with AllocationLimit(weights):
        torch.zeros(4000)  # 16,000 of 17,000 bytes
        torch.ones(250)
        with pytest.raises(ValueError, match=r"\(got more than 17000 bytes or "):
            torch.empty(1)


def test_without_weights_there_is_the_room_only():
    with AllocationLimit([]):
        torch.full((125,), 1.0, dtype=torch.double)
        with pytest.raises(ValueError, match=r"\(got more than 1000 bytes or "):
            torch.arange(1)
    torch.zeros(1000)


def test_many_small_tensors_end_it_too(monkeypatch):
    monkeypatch.setattr(allocation_limit, "MODEL_TENSORS", 3)
    with AllocationLimit([torch.zeros(50)]):
        for _ in range(7):
            torch.zeros(1)
        with pytest.raises(ValueError, match=r"more than 1800 bytes or 7 tensors\)"):
            torch.zeros(1)
