import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import (
    KNNGraph,
    SessionZScore,
    Tare,
    ZScore,
    fit_transform,
)
from torch_geometric_tactile.transforms.fitting import fitted_parts


class Squared(BaseTransform):
    def forward(self, data: Data) -> Data:
        data.x = data.x.square()
        return data


def two_sessions():
    x = torch.tensor([1.0, 3.0, 101.0, 105.0]).view(4, 1, 1)
    return StaticData(x=x, session=torch.tensor([0, 0, 1, 1]))


def test_fitted_parts_order():
    tare, score = Tare(), ZScore()
    assert fitted_parts(None) == []
    assert fitted_parts(Squared()) == []
    assert fitted_parts(score) == [score]
    nested = Compose([KNNGraph(2), Compose([tare, Squared()]), score])
    assert fitted_parts(nested) == [tare, score]


def test_fit_transform_nothing_to_fit():
    data = two_sessions()
    assert fit_transform(None, data) is data
    assert fit_transform(Squared(), data).x.view(-1).tolist() == [1, 9, 10201, 11025]


def test_fit_transform_fits_on_what_comes_before():
    # Readings less the rest of their session: -1, 1, -2, 2; their squares: 1, 1, 4, 4.
    transform = Compose([Tare(), Squared(), ZScore()])
    out = fit_transform(transform, two_sessions())
    assert transform.transforms[2].center.item() == 2.5
    assert out.x.view(-1).tolist() == [-1, -1, 1, 1]
    assert torch.equal(torch.stack([transform(s).x for s in two_sessions().to_data_list()]), out.x)


def test_fit_transform_order_matters():
    first = fit_transform(Compose([ZScore(), Squared()]), two_sessions()).x
    second = fit_transform(Compose([Squared(), ZScore()]), two_sessions()).x
    assert not torch.allclose(first, second)


def test_fit_transform_adapt_keeps_the_training_part():
    transform = Compose([SessionZScore(), ZScore()])
    fit_transform(transform, two_sessions())
    center = transform.transforms[1].center.clone()
    new = StaticData(x=torch.tensor([11.0, 13.0]).view(2, 1, 1), session=torch.tensor([7, 7]))
    out = fit_transform(transform, new, adapt=True)
    assert out.x.view(-1).tolist() == [-1, 1]
    assert torch.equal(transform.transforms[1].center, center)
    assert transform.transforms[0].key_values.tolist() == [0, 1, 7]


def test_fit_transform_adapt_does_not_fit():
    # What is not of a session is measured on the training part or not at all.
    with pytest.raises(RuntimeError, match="ZScore must be fitted"):
        fit_transform(Compose([SessionZScore(), ZScore()]), two_sessions(), adapt=True)


def test_fit_transform_caller_unedited():
    data = two_sessions()
    data.pos = grid(1, 1, 0.1).pos
    fit_transform(Compose([Tare(), ZScore()]), data)
    assert torch.equal(data.x, two_sessions().x)


def test_fit_transform_dataset():
    dataset = FakeTactileDataset(num_samples=30)
    transform = Compose([KNNGraph(2), SessionZScore()])
    out = fit_transform(transform, dataset)
    assert out.x.shape == (30, 24, 3)
    assert out.edge_index.shape == (2, 62)
    for session in out.session.unique():
        x = out.x[out.session == session]
        assert x.mean(0).abs().max() < 1e-5
    dataset.transform = transform
    assert torch.allclose(dataset[3].x, out.x[3])
