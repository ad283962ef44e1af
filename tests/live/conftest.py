import pytest
from viewer_pages import recording

from torch_geometric_tactile.live import ReplaySource, Stream, Viewer


@pytest.fixture
def stream():
    with Stream(ReplaySource(recording(meta={"unit": "count"}), loop=True)) as stream:
        yield stream


@pytest.fixture
def viewer(stream):
    with Viewer(stream) as viewer:
        yield viewer
