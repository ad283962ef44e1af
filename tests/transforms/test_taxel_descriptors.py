"""Descriptors as an attribute of samples and windows, in a predictor and in ONNX."""

import pytest
import torch
from torch.nn import Linear, Module
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData, join_frames
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.sensors import allegro_uskin, biotac_sp, grid, taxel_descriptors
from torch_geometric_tactile.transforms import TaxelDescriptors, TaxelPose, ZScore

PAD = grid(3, 4, 0.01)


def samples(num_samples=5, layout=PAD, **kwargs):
    draw = torch.Generator().manual_seed(0)
    return StaticData(x=torch.randn(num_samples, layout.num_taxels, 2, generator=draw), **kwargs)


def test_samples_are_described_and_their_numbers_named():
    data, transform = samples(), TaxelDescriptors(PAD)
    descriptors = transform(data).descriptors
    assert descriptors.shape == (5, len(transform.names(num_channels=2)))
    torch.testing.assert_close(descriptors, taxel_descriptors(data.x, PAD))


def test_windows_are_described_by_their_end_their_change_and_their_course():
    frames = torch.randn(5, 4, 12, 2, generator=torch.Generator().manual_seed(0))
    data = StaticData(x=join_frames(frames.transpose(1, 2)), num_frames=4)
    transform = TaxelDescriptors(PAD)
    found = transform(data).descriptors
    names = transform.names(num_channels=2, of_windows=True)
    assert found.shape == (5, len(names))
    assert names[0] == "last_mean_channel_0"
    each = torch.stack([taxel_descriptors(frames[:, t], PAD) for t in range(4)])
    change = taxel_descriptors(frames[:, 3] - frames[:, 0], PAD)
    expected = torch.cat([each[3], change, each.mean(0), each.std(0, correction=0)], dim=1)
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)
    data.valid_frames = torch.tensor([4, 4, 3, 4, 4])
    with pytest.raises(ValueError, match="TaxelDescriptors needs windows of one length"):
        transform(data)


def test_posed_taxels_follow_the_joints():
    layout = allegro_uskin()
    draw = torch.Generator().manual_seed(1)
    data = samples(3, layout, joint=0.5 * torch.rand(3, 16, generator=draw))
    data = TaxelPose(layout)(data)
    found = TaxelDescriptors(layout, posed=True)(data).descriptors
    torch.testing.assert_close(found, taxel_descriptors(data.x, layout, data.pos))
    still = TaxelDescriptors(layout)(data).descriptors
    names = TaxelDescriptors(layout).names(2)
    moved = [n for n, a, b in zip(names, found[0], still[0], strict=True) if not a.isclose(b)]
    assert {name.partition("_")[0] for name in moved} == {"centroid", "moment", "extent"}
    data.num_frames = 1
    windows = TaxelDescriptors(layout, posed=True)(data).descriptors
    torch.testing.assert_close(windows[:, : len(names)], found)


class Reader(Module):
    """A linear model of descriptors."""

    modalities = ("descriptors",)

    def __init__(self, size):
        super().__init__()
        torch.manual_seed(0)
        self.lin = Linear(size, 3)

    def forward(self, x, edge_index=None, descriptors=None):
        return self.lin(descriptors)


@pytest.mark.parametrize(
    "layout", [PAD, pytest.param(biotac_sp(), marks=pytest.mark.full)], ids=["pad", "biotac"]
)
def test_onnx_gives_the_same(layout, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    from torch_geometric.transforms import Compose

    from torch_geometric_tactile.predictor import export_onnx

    describe = TaxelDescriptors(layout)
    chain = Compose([ZScore(scale_per="channel").fit(samples(layout=layout)), describe])
    model = Reader(len(describe.names(2)))
    predictor = Predictor(model, layout, chain, ("a", "b", "c"), num_channels=2)
    export_onnx(predictor, tmp_path / "a.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx")
    frames = samples(6, layout).x
    frames[1, 3] = torch.nan
    frames[2] = 0.0
    for frame in frames:
        (found,) = session.run(["probability"], {"tactile": frame.unsqueeze(0).numpy()})
        torch.testing.assert_close(torch.from_numpy(found)[0], predictor(frame), atol=1e-5, rtol=0)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"a sample must have 12 taxels, .*'grid_3x4' \(got 9\)"):
        TaxelDescriptors(PAD)(Data(x=torch.zeros(9, 2)))
