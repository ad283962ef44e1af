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


def test_size_is_counted_before_the_memory_is_taken():
    with AllocationLimit([]):
        for make in (
            lambda: torch.full((2**50,), 1.0),
            lambda: torch.zeros(2**50, dtype=torch.double),
            lambda: torch.rand(2**25, 2**25, generator=torch.Generator()),
            lambda: torch.arange(2**50),
            lambda: torch.eye(2**25),
        ):
            with pytest.raises(ValueError, match="the model must not be larger than its weights"):
                make()
    tensor = torch.zeros(1)
    with AllocationLimit([]), pytest.raises(ValueError, match="must not be larger"):
        tensor.new_zeros(2**50)


def test_each_naming_of_a_tensor_is_counted_in_double_precision():
    tensor = torch.zeros(200, dtype=torch.uint8)
    limit = AllocationLimit([tensor])
    assert limit.count_reference(tensor) is tensor  # 1600 of 2600 bytes
    with pytest.raises(ValueError, match=r"referenced too often \(got more than 2600 bytes"):
        limit.count_reference(tensor)
