import pytest
import torch

from torch_geometric_tactile.io import FlexiTacDecoder
from torch_geometric_tactile.sensors import as_layout, flexitac, grid


def test_pad_by_hand():
    layout = flexitac()
    assert repr(layout) == "TaxelLayout('flexitac', num_taxels=384, patches=1, digits=1)"
    # Row by row: taxel 33 is the second of the second row.
    millimetres = (layout.pos[[0, 33, 383]] * 1e3).flatten().tolist()
    assert millimetres == pytest.approx([-31, -11, 0, -29, -9, 0, 31, 11, 0], abs=1e-5)
    assert layout.normal.tolist() == [[0.0, 0.0, 1.0]] * 384
    assert layout.image_map[[0, 33]].tolist() == [[11, 0], [10, 1]]
    assert "https://" in layout.source
    assert "check yours" in layout.source


@pytest.mark.parametrize("name", ["original", "slanted", "dense"])
def test_pad_is_a_grid(name):
    layout, expected = flexitac(), grid(12, 32, pitch=0.002)
    assert torch.allclose(layout.pos - layout.pos[0], expected.pos, atol=1e-7)
    pairs, expected_pairs = (one.edge_index(name).t().tolist() for one in (layout, expected))
    assert set(map(tuple, pairs)) == set(map(tuple, expected_pairs))


def test_decoder_names_the_layout_of_its_default_shape():
    assert as_layout(FlexiTacDecoder().layout).num_taxels == 384
    assert FlexiTacDecoder(shape=(16, 32)).layout is None
