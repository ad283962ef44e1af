import random

import numpy as np
import pytest
import torch

from torch_geometric_tactile.loader._random_states import (
    RandomStates,
    mix_seeds,
    preserve_random_states,
    seeded_rng,
)


def drawn():
    """Normal numbers, of which NumPy and Python keep a second one."""
    numpy = float(np.random.normal())  # noqa: NPY002
    return torch.rand(1).item(), numpy, random.gauss(0, 1)


def test_states_are_plain_data_and_draw_the_same_again(tmp_path):
    drawn()
    states = RandomStates.now()
    expected = [drawn(), drawn()]
    torch.save(states.to_dict(), tmp_path / "states.pt")
    read = torch.load(tmp_path / "states.pt", weights_only=True)
    RandomStates.from_dict(read).restore()
    assert [drawn(), drawn()] == expected


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"torch": torch.zeros(7, dtype=torch.uint8)}, "RuntimeError"),
        ({"torch": torch.zeros(7)}, "TypeError"),
        ({"torch": 3}, "AttributeError"),
        ({"numpy": None}, "TypeError"),
        ({"numpy": {"key": torch.zeros(9)}}, "KeyError"),
        ({"python": {"version": 3, "numbers": torch.zeros(5), "gauss": None}}, "ValueError"),
        ({"python": {}}, "KeyError"),
    ],
)
def test_states_that_were_changed_are_an_error(change, said):
    before = RandomStates.now()
    with pytest.raises(ValueError, match=rf"random states must be valid for PyTorch.*got {said}"):
        RandomStates.from_dict(before.to_dict() | change)
    expected = drawn()
    before.restore()
    assert drawn() == expected


def test_kept_states_are_those_before_also_after_an_error():
    with preserve_random_states():
        first = drawn(), drawn()
    with pytest.raises(KeyError), preserve_random_states():
        raise KeyError(drawn())
    assert (drawn(), drawn()) == first


def test_seeded_states_follow_from_the_seed_alone():
    own = torch.Generator().manual_seed(3)
    before = RandomStates.now(), own.get_state()
    found = []
    for seed in (11, 12, 11):
        with seeded_rng(seed, [own]):
            found.append((*drawn(), torch.rand(1, generator=own).item()))
        random.random()
        torch.rand(3)
    assert found[0] == found[2]
    assert not set(found[0]) & set(found[1])
    assert own.get_state().equal(before[1])
    before[0].restore()
    np.random.seed(2)  # noqa: NPY002 - no second normal number is kept
    with preserve_random_states():
        expected = drawn()
    with seeded_rng(11):
        drawn()
    assert drawn() == expected


def test_other_seeds_of_own_sources_draw_other_numbers():
    found = []
    for seed in (3, 4):
        own = torch.Generator().manual_seed(seed)
        with seeded_rng(11, [own]):
            found.append(torch.rand(1, generator=own).item())
    assert found[0] != found[1]


def test_mixed_seeds_are_in_the_range_of_every_source():
    found = {mix_seeds(a, b) for a in range(10) for b in range(-5, 5)}
    assert len(found) == 100
    assert 0 <= min(found) <= max(found) < 2**63
    assert mix_seeds(1, 2) == mix_seeds(1, 2) != mix_seeds(2, 1)
