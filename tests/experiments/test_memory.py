import sys

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch

from torch_geometric_tactile.experiments import _memory as memory
from torch_geometric_tactile.experiments._memory import PeakMemory

MB = 2**18  # float32


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere peaks are of the whole process")
def test_peak_is_of_each_piece_of_work_also_after_a_larger_one():
    measured = PeakMemory()
    for size in (80, 160, 40):
        measured.start()
        block = torch.ones(size * MB)
        half = torch.ones(size // 2 * MB)
        del block, half
        assert measured.stop() == pytest.approx(1.5 * size, abs=8)
    assert measured.measure == "resident memory of the process"


def test_peak_of_nothing_is_nothing():
    measured = PeakMemory()
    measured.start()
    assert 0 <= measured.stop() < 4


def test_without_reset_the_highest_point_of_the_process_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_CLEAR_REFS_FILE", tmp_path / "none" / "clear_refs")
    assert not PeakMemory.reset_peak()
    block = torch.ones(100 * MB)
    del block
    measured = PeakMemory()
    measured.start()
    block = torch.ones(30 * MB)
    del block
    assert measured.stop() < 10  # below what came before
