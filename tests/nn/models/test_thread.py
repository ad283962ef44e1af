import pytest
import torch
from small_models import LAYOUT, PATCH
from torch import nn

from torch_geometric_tactile.nn import CNNThread, GCNThread, SegmentedThread
from torch_geometric_tactile.nn.models import Thread
from torch_geometric_tactile.nn.models._thread_widths import checked_widths

SHAPE = {"widths": (4, 8), "pools": (1, 4)}
THREADS = {
    "gcn": lambda **more: GCNThread(3, **SHAPE, **more),
    "segmented": lambda **more: SegmentedThread(3, PATCH, **SHAPE, **more),
    "cnn": lambda: CNNThread(3, LAYOUT.image_map, **SHAPE),
}


@pytest.mark.parametrize("name", THREADS)
def test_thread_is_one(name):
    thread = THREADS[name]()
    assert isinstance(thread, Thread)
    assert (thread.in_channels, thread.out_channels) == (3, 2)
    assert (thread.widths, thread.pool_sizes) == ((4, 8), (1, 4))
    assert [pool.kernel_size for _, pool in thread.layers()] == [1, 4]
    assert str(thread).startswith(f"{type(thread).__name__}(3, widths=(4, 8), pools=(1, 4)")


@pytest.mark.parametrize("name", ["gcn", "segmented"])
def test_thread_fast(name):
    assert THREADS[name]().fast
    assert not THREADS[name](fast=False).fast
    thread = THREADS[name]()
    assert not thread.explained
    thread.convs[1].explain = True
    assert thread.explained


@pytest.mark.parametrize("name", ["gcn", "segmented"])
@pytest.mark.parametrize("size", [(11, 3), (2, 11, 3), (9, 11, 3)])
def test_thread_needs_edges(name, size):
    with pytest.raises(ValueError, match=r"'edge_index' must be given \(got None\)"):
        THREADS[name]()(torch.zeros(size))


def test_thread_of_the_user():
    # Whatever layer it is made of: here a linear map of each taxel.
    class LinearThread(Thread):
        def forward(self, x, edge_index=None, edge_weight=None):
            for lin, pool in self.layers():
                x = pool(lin(x)).relu()
            return x

    thread = LinearThread(2, (2,), (2,), nn.Linear)
    assert str(thread) == "LinearThread(2, widths=(2,), pools=(2,))"
    nn.init.eye_(thread.convs[0].weight)
    nn.init.zeros_(thread.convs[0].bias)
    assert thread(torch.tensor([[1.0, 3.0], [-2.0, -1.0]])).tolist() == [[3.0], [0.0]]
    assert not thread.explained
    with pytest.raises(NotImplementedError):
        Thread(2, (2,), (2,), nn.Linear)(torch.zeros(1, 2))


def test_checked_widths():
    assert checked_widths(3, [14, 56], [1, 8]) == ((14, 56), (1, 8), (3, 14, 7))
    with pytest.raises(ValueError, match=r"'pools' must divide 'widths' \(got 3 for 8\)"):
        checked_widths(3, (8,), (3,))
