import os

import numpy as np
import pytest
from robustness import kills

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked"),
]


@pytest.mark.parametrize("make", [kills.processing, kills.convert, kills.append])
def test_killed_jobs_lose_nothing_and_leave_nothing_after_the_next_run(make, monkeypatch):
    monkeypatch.setattr(kills, "FRAMES", 60)
    try:
        job = make()
    except ImportError as error:
        pytest.skip(f"needs an extra: {error}")
    draw = np.random.default_rng(0)
    seconds, wanted = kills.undisturbed(job)
    for two in (False, True):
        assert kills.kill_once(job, seconds, wanted, draw, two) == []
