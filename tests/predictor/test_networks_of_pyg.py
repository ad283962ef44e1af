"""Networks as PyG's tutorials have them, in predictors and as ONNX graphs."""

import pytest
import torch
from own_models import Attention
from torch_geometric.data import Batch
from torch_geometric.nn import GCNConv, SAGEConv, global_max_pool

from torch_geometric_tactile.analysis import taxel_attribution
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.predictor import AverageModel, Predictor
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import GeometricEdgeAttr, KNNGraph, ZScore


class Convolutions(torch.nn.Module):
    modalities = ("edge_attr",)

    def __init__(self):
        super().__init__()
        self.conv1, self.conv2 = GCNConv(2, 8), SAGEConv(8, 8)
        self.lin = torch.nn.Linear(8, 3)

    def forward(self, x, edge_index, batch, edge_attr):
        x = self.conv1(x, edge_index, edge_attr.abs().sum(dim=-1)).relu()
        return self.lin(global_max_pool(self.conv2(x, edge_index).relu(), batch))


def dataset():
    draw = torch.Generator().manual_seed(0)
    x = 100 + 5 * torch.randn(20, 12, 2, generator=draw)
    return StaticDataset.from_arrays(
        x, torch.arange(20) % 3, layout=grid(3, 4, 0.01), pre_transform=KNNGraph(k=3)
    )


NETWORKS = {
    "attention": lambda: Attention(2, 3),
    "convolutions": Convolutions,
    "average": lambda: AverageModel([Attention(2, 3), Attention(2, 3)]),
}


def predictor(name):
    torch.manual_seed(0)
    samples = dataset()
    steps = ZScore().fit(samples)
    if name == "convolutions":
        from torch_geometric.transforms import Compose

        steps = Compose([steps, GeometricEdgeAttr()])
    return Predictor.from_dataset(NETWORKS[name](), samples, steps)


@pytest.mark.parametrize("name", NETWORKS)
def test_a_predictor_says_of_many_frames_what_it_says_of_each(name):
    found, x = predictor(name), dataset().data.x
    torch.testing.assert_close(found(x), torch.stack([found(one) for one in x]))
    data = found.prepare(x)
    network = found.model.eval()
    batch = Batch.from_data_list(data.to_data_list())
    inputs = {name: batch[name] for name in found.network.modalities}
    expected = network(batch.x, batch.edge_index, batch=batch.batch, **inputs).softmax(dim=1)
    torch.testing.assert_close(found(x), expected)
    assert found(x[:0]).shape == (0, 3)


def test_missing_readings_of_one_frame_stay_there():
    found, x = predictor("attention"), dataset().data.x[:3].clone()
    expected = found(x)
    x[1, 2] = torch.nan
    assert found(x)[1].isnan().all()
    torch.testing.assert_close(found(x)[[0, 2]], expected[[0, 2]])


def test_attribution_of_static_samples_is_that_of_pygs_batch():
    network, data = Attention(2, 3).eval(), dataset().batch(torch.arange(4))
    found = taxel_attribution(network, data, 1, per_sample=True)
    assert found.shape == (4, 12)
    joined = Batch.from_data_list(data.to_data_list())
    torch.testing.assert_close(taxel_attribution(network, joined, 1, per_sample=True), found)


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_graph_gives_the_numbers_of_the_network(name, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    from torch_geometric_tactile.predictor.export_onnx import export_onnx

    found = predictor(name)
    exported = export_onnx(found, tmp_path / "own.onnx")
    assert exported.difference <= 1e-5
    session = onnxruntime.InferenceSession(tmp_path / "own.onnx")
    for x in dataset().data.x[:3]:
        (said,) = session.run(["probability"], {"tactile": x[None].numpy()})
        torch.testing.assert_close(torch.from_numpy(said[0]), found(x), atol=1e-5, rtol=0)
