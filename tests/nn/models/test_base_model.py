import copy

import torch

from torch_geometric_tactile.nn.models import MTGCN, GraspGCN, TactileGCN
from torch_geometric_tactile.sensors import TaxelLayout, grid

LAYOUT = grid(2, 3, pitch=0.004)
SMALL = {"widths": (4, 8), "pools": (1, 2), "head_widths": (6,), "head_pools": (2,)}


def test_init_arguments_have_defaults_and_build_the_model_again():
    model = GraspGCN(6, hidden_channels=4, fusion=None, finger=2)
    arguments = model.init_arguments
    assert arguments["layout"] == 6
    assert arguments["hidden_channels"] == 4
    assert arguments["num_layers"] == 1
    again = GraspGCN(**arguments)
    again.load_state_dict(model.state_dict())
    assert str(again) == str(model)
    x = torch.randn(2, 6, 3)
    edge_index = LAYOUT.edge_index("original")
    assert again.eval()(x, edge_index).equal(model.eval()(x, edge_index))


def test_init_arguments_keep_the_order_of_threads():
    inputs = ("tactile", "edge", "absolute")
    model = MTGCN(6, inputs=inputs, threads=dict.fromkeys(inputs), encoder="message")
    assert tuple(model.init_arguments["threads"]) == inputs


def test_init_arguments_of_a_subclass_hold_its_keywords():
    class Wide(TactileGCN):
        def __init__(self, *args, scale=2, **kwargs):
            super().__init__(*args, **kwargs)
            self.scale = scale

    model = Wide(layout=6, scale=3, **SMALL)
    assert model.init_arguments == {"layout": 6, "scale": 3, **SMALL}
    assert Wide(**model.init_arguments).thread.widths == (4, 8)
    assert copy.deepcopy(model).init_arguments == model.init_arguments


def test_init_arguments_hold_the_contents_of_a_layout_file(tmp_path):
    path = tmp_path / "own.json"
    for given in (path, str(path)):
        LAYOUT.save(path)
        model = TactileGCN(given, segments="patch", **SMALL)
        path.unlink()
        layout = model.init_arguments["layout"]
        assert isinstance(layout, TaxelLayout)
        assert layout.to_dict() == LAYOUT.to_dict()
    assert TactileGCN("biotac_sp", **SMALL).init_arguments["layout"] == "biotac_sp"
