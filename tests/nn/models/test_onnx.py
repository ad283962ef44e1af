import numpy as np
import pytest
import torch

from torch_geometric_tactile.nn.models import (
    BMFCNN,
    MSCNN,
    MTGCN,
    GraspLSTM,
    PosedTaxelNet,
    TactileGCN,
    TaxelNet,
    TemporalCNN,
    TemporalTaxelNet,
)
from torch_geometric_tactile.sensors import allegro_uskin, grid, letter_array

pytestmark = pytest.mark.full

LAYOUT = grid(3, 4, pitch=0.004)
SMALL = {"head_widths": (6,), "head_pools": (2,)}
NARROW = {"widths": (4, 8), "pools": (1, 2)}


def inputs(batch_size, num_nodes, **sizes):
    draw = torch.Generator().manual_seed(batch_size)
    sizes = {"x": (num_nodes, 3), **sizes}
    return {k: torch.randn(batch_size, *size, generator=draw) for k, size in sizes.items()}


def assert_onnx_equals(model, path, edge_index, *sizes, **other_sizes):
    """The exported file gives the model's numbers, for batches of other sizes as well."""
    for name in ("onnx", "onnxscript"):
        pytest.importorskip(name)
    runtime = pytest.importorskip("onnxruntime")
    model = model.eval()
    example = {"edge_index": edge_index, **inputs(3, *sizes, **other_sizes)}
    shapes = {name: {0: "batch"} for name in example} | {"edge_index": None}
    torch.onnx.export(
        model,
        (),
        path,
        kwargs=example,
        dynamo=True,
        opset_version=18,
        dynamic_shapes=shapes,
        verbose=False,
    )
    session = runtime.InferenceSession(path, providers=["CPUExecutionProvider"])
    for batch_size in (1, 3, 10):
        given = {"edge_index": edge_index, **inputs(batch_size, *sizes, **other_sizes)}
        feed = {node.name: given[node.name].numpy() for node in session.get_inputs()}
        assert feed.keys() == given.keys()
        with torch.no_grad():
            expected = model(**given).numpy()
        (out,) = session.run(None, feed)
        assert out.shape == expected.shape
        assert np.abs(out - expected).max() < 1e-5


def test_onnx_tactile_gcn(tmp_path):
    model = TactileGCN(12, 3, **NARROW, **SMALL)
    assert_onnx_equals(model, tmp_path / "model.onnx", LAYOUT.edge_index("original"), 12)


def test_onnx_mt_gcn(tmp_path):
    edge_index = LAYOUT.edge_index("original")
    num_edges = edge_index.size(1)
    threads = {"tactile": NARROW, "edge": NARROW}
    model = MTGCN(12, 3, threads=threads, num_edges=num_edges, num_joints=2, **SMALL)
    path = tmp_path / "model.onnx"
    assert_onnx_equals(model, path, edge_index, 12, edge_attr=(num_edges, 4), joint=(2,))


def test_onnx_tactile_gcn_of_segments(tmp_path):
    layout = allegro_uskin()
    model = TactileGCN(layout, segments="patch", widths=(4, 8), pools=(1, 4), **SMALL)
    assert_onnx_equals(model, tmp_path / "model.onnx", layout.edge_index("original"), 384)


@pytest.mark.parametrize("shared", [False, True], ids=["different", "shared"])
def test_onnx_ms_cnn(tmp_path, shared):
    model = MSCNN(out_channels=3, share_weights=shared, num_joints=2, hidden_channels=5)
    edge_index = LAYOUT.edge_index("original")
    assert_onnx_equals(model, tmp_path / "model.onnx", edge_index, 240, joint=(2,))


def test_onnx_taxel_net(tmp_path):
    model = TaxelNet(LAYOUT, 3, max_taxels=6, widths=(4,), hidden_channels=5)
    assert_onnx_equals(model, tmp_path / "model.onnx", LAYOUT.edge_index("original"), 12)


def test_onnx_posed_taxel_net(tmp_path):
    model = PosedTaxelNet(LAYOUT, 3, num_strongest=5, widths=(4,), hidden_channels=5)
    places = {"pos": (12, 3), "normal": (12, 3), "tangent": (12, 2, 3)}
    edge_index = LAYOUT.edge_index("original")
    assert_onnx_equals(model, tmp_path / "model.onnx", edge_index, 12, **places)


@pytest.mark.parametrize("posed", [True, False], ids=["posed", "open"])
def test_onnx_posed_taxel_net_of_taxels_that_tie(posed, tmp_path):
    for name in ("onnx", "onnxscript"):
        pytest.importorskip(name)
    runtime, path = pytest.importorskip("onnxruntime"), tmp_path / "model.onnx"
    torch.manual_seed(0)
    model = PosedTaxelNet("allegro_uskin", 4, posed=posed)
    sizes = {"pos": (384, 3), "normal": (384, 3), "tangent": (384, 2, 3)} if posed else {}
    data = inputs(41, 384, **sizes)
    model(**data)  # measures the scales
    example = {key: value[:3] for key, value in data.items()}
    torch.onnx.export(
        model.eval(),
        (),
        path,
        kwargs=example,
        dynamo=True,
        opset_version=18,
        dynamic_shapes={name: {0: "batch"} for name in example},
        verbose=False,
    )
    session = runtime.InferenceSession(path, providers=["CPUExecutionProvider"])
    # Nothing else is touched: of 0 to 40 taxels, and of 384 with three levels of pressure.
    order = torch.randn(41, 384).argsort(dim=1)
    pressure = data["x"][..., -1].abs().clamp(max=2).ceil()
    for number in (torch.arange(41), torch.full((41,), 384)):
        data["x"][..., -1] = torch.where(order < number.view(-1, 1), pressure, 0.0)
        with torch.no_grad():
            expected = model(**data).softmax(dim=-1)
        (out,) = session.run(None, {key: value.numpy() for key, value in data.items()})
        assert (torch.from_numpy(out).softmax(dim=-1) - expected).abs().max() < 1e-5


def test_onnx_temporal_taxel_net(tmp_path):
    # The three numbers of a taxel are frames.
    model = TemporalTaxelNet(LAYOUT, 3, filter_size=2, dilation=1, max_taxels=6, widths=(4,))
    assert_onnx_equals(model, tmp_path / "model.onnx", LAYOUT.edge_index("original"), 12)


def test_onnx_grasp_lstm(tmp_path):
    model = GraspLSTM(4, 2, hidden_channels=5)
    edge_index = LAYOUT.edge_index("original")
    assert_onnx_equals(model, tmp_path / "model.onnx", edge_index, 4, x=(4, 12))


def test_onnx_temporal_cnn(tmp_path):
    model = TemporalCNN(4, 2, in_channels=3, widths=(6, 5))
    edge_index = LAYOUT.edge_index("original")
    assert_onnx_equals(model, tmp_path / "model.onnx", edge_index, 4, x=(4, 12))


@pytest.mark.parametrize("x", [(1024, 1), (1, 32, 32)], ids=["readings", "images"])
def test_onnx_bmf_cnn(x, tmp_path):
    edge_index = letter_array().edge_index("original")
    assert_onnx_equals(BMFCNN(), tmp_path / "model.onnx", edge_index, 1024, x=x)


@pytest.mark.parametrize("fusion", ["C3", "C1+C3", "bilinear(C2)+C3"])
def test_onnx_bmf_cnn_of_other_fusions(fusion, tmp_path):
    layout = grid(20, 22, pitch=0.01)
    model = BMFCNN(layout, 3, fusion=fusion, in_channels=3)
    assert_onnx_equals(model, tmp_path / "model.onnx", layout.edge_index("original"), 440)


@pytest.mark.parametrize("attached", [None, "fc1", "bilinear_feature"])
def test_onnx_bmf_cnn_multiplies_most_equal_products_once(attached, tmp_path):
    onnx = pytest.importorskip("onnx")
    layout, path = grid(20, 20, pitch=0.01), tmp_path / "model.onnx"
    model = BMFCNN(layout, 3, in_channels=3)
    if attached:  # and then the file has it as well
        hook = getattr(model, attached).register_forward_hook
        hook(lambda module, args, out: 2 * out)
    assert_onnx_equals(model, path, layout.edge_index("original"), 400)
    operations = [node.op_type for node in onnx.load(path).graph.node]
    assert (operations.count("Slice") >= 6) == (attached is None)  # cut into strips
