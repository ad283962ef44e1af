import inspect

import pytest

pytest.importorskip("onnx", reason="needs the extra 'export'")

from docs import cheat_sheets
from torch_geometric_tactile import datasets, nn


def test_pages_match_the_code():
    assert cheat_sheets.page() == cheat_sheets.PAGE.read_text()
    assert cheat_sheets.data_sets_page() == cheat_sheets.DATA_SETS_PAGE.read_text()


def test_every_data_set_and_model_is_on_the_page():
    classes = {n for n in datasets.__all__ if inspect.isclass(getattr(datasets, n))}
    assert set(cheat_sheets.DATA_SETS) == classes
    parts = {
        "CNNThread",
        "GCNThread",
        "SegmentedThread",
        "Thread",
        "PooledMLP",
        "TactileModel",
        "TouchEncoder",
    }
    assert set(cheat_sheets.MODELS) == set(nn.models.__all__) - parts
