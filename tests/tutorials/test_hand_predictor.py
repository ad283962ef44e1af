"""The predictor that tutorial 10 shows, and what the file beside it says."""

import json
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
import torch

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.sensors import allegro_uskin

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tutorials" / "data"


@pytest.fixture(scope="module")
def card():
    return json.loads((DATA / "hand.json").read_text())


def test_file_is_small_and_loads(card):
    assert (DATA / "hand.predictor").stat().st_size < 200_000
    predictor = Predictor.load(DATA / "hand.predictor")
    assert list(predictor.class_names) == card["classes"]
    assert torch.equal(predictor.layout.pos, allegro_uskin().pos)
    probability = predictor(torch.zeros(2, 384, 3), torch.zeros(2, 16))
    assert probability.shape == (2, 4)
    torch.testing.assert_close(probability.sum(dim=1), torch.ones(2))


def test_card_names_the_data_of_the_script(card, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(DATA))
    script = import_module("make_predictor")
    try:
        options = dict(re.findall(r"--([a-z-]+) (\S+)", card["data"]))
        assert int(options["num-objects"]) == script.TRAINED["objects"]
        assert int(options["trials"]) == script.TRAINED["trials"]
        assert int(options["seed"]) == script.TRAINED["seed"]
        assert script.OTHERS["seed"] != script.TRAINED["seed"]
        assert all(phase in card["frames"] for phase in script.PHASES)
    finally:
        sys.modules.pop("make_predictor", None)


def test_card_counts_held_out_trials_apart(card):
    held_out = card["held_out_trials_of_the_same_objects"]
    assert held_out["trials"] + card["trained_on"]["trials"] == 600
    assert held_out["frames"] + card["trained_on"]["frames"] == 2397
    assert card["synthetic"]
