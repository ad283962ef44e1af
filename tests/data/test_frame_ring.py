import pytest
import torch

from torch_geometric_tactile.data import FrameRing, StaticDataset, Windows
from torch_geometric_tactile.sensors import grid


@pytest.mark.parametrize("length", [1, 3, 5])
def test_ring_gives_the_windows_of_a_recording(length):
    x = torch.rand(13, 6, 2)
    x[4, 1, 0] = torch.nan
    trial = torch.zeros(13, dtype=torch.long)
    windows = Windows(
        StaticDataset.from_arrays(x, trial=trial, layout=grid(2, 3, 0.002)), length=length
    )
    ring = FrameRing(length, 6, 2)
    for i, frame in enumerate(x):
        ring.push(frame)
        assert len(ring) == min(i + 1, length)
        assert ring.is_full == (i + 1 >= length)
        if ring.is_full:
            expected = windows[i + 1 - length].x
            found = ring.window()
            assert found.view(torch.int32).equal(expected.view(torch.int32))  # NaN as well
            assert found.is_contiguous()


def test_window_of_a_ring_is_a_copy():
    ring = FrameRing(1, 2, 1)
    ring.push([[1.0], [2.0]])
    window = ring.window()
    ring.push(torch.zeros(2, 1))
    assert window.tolist() == [[1], [2]]


def test_ring_clear():
    ring = FrameRing(2, 1, 1)
    for value in (1.0, 2.0, 3.0):
        ring.push([[value]])
    ring.clear()
    assert len(ring) == 0
    ring.push([[5.0]])
    with pytest.raises(RuntimeError, match=r"2 frames for a window \(got 1\)"):
        ring.window()
    ring.push([[6.0]])
    assert ring.window().tolist() == [[5, 6]]


def test_ring_repr_and_bad_input():
    ring = FrameRing(60, 19, 3)
    assert repr(ring) == "FrameRing(60, num_taxels=19, num_channels=3)"
    for shape in [(19,), (3, 19), (1, 19, 3)]:
        with pytest.raises(ValueError, match=r"must have shape \(19, 3\)"):
            ring.push(torch.zeros(shape))
    for name in ("length", "num_taxels", "num_channels"):
        with pytest.raises(ValueError, match=f"'{name}' must be at least 1"):
            FrameRing(**({"length": 1, "num_taxels": 1, "num_channels": 1} | {name: 0}))
