import pytest
import torch
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.transforms import (
    GeometricEdgeAttr,
    SessionZScore,
    Tare,
    TaxelPose,
    ZScore,
    _samples,
    fit_parts,
    fit_transform,
)
from torch_geometric_tactile.transforms.fitting import fitted_parts

LAYOUT = allegro_uskin()
NUM_BYTES = 200 * 1024  # of five samples: 22 kB of edge features and 14 kB of places and readings


class Grasps(StaticDataset):
    """Forty frames of a moving hand, in four sessions."""

    layout = LAYOUT

    def read(self):
        draw = torch.Generator().manual_seed(0)
        data = StaticData(
            x=torch.randn(40, 384, 3, generator=draw),
            edge_index=LAYOUT.edge_index("original"),
            joint=0.3 * torch.rand(40, 16, generator=draw),
            session=torch.arange(40) // 10,
        )
        return data, {}


class Watched(BaseTransform):
    """Records how many samples come at a time."""

    supports_static = True

    def __init__(self):
        self.sizes = []

    def forward(self, data):
        self.sizes.append(data.num_samples)
        data.seen = data.session + 7
        return data


def hand(*parts):
    pose = TaxelPose(LAYOUT, HandKinematics.allegro())
    return Compose([ZScore(), ZScore("joint"), pose, GeometricEdgeAttr(), *parts])


def pose_first(*parts):
    return Compose([TaxelPose(LAYOUT, HandKinematics.allegro()), GeometricEdgeAttr(), *parts])


def states(transform):
    return [part.state_dict() for part in fitted_parts(transform)]


def assert_same(first, second):
    assert len(first) == len(second) > 0
    for one, other in zip(first, second, strict=True):
        for key, value in one.items():
            torch.testing.assert_close(value, other[key], rtol=1e-4, atol=1e-7)


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(_samples, "_CHUNK_BYTES", NUM_BYTES)


@pytest.mark.parametrize("selected", [False, True])
def test_fitted_in_chunks_as_at_once(few, selected):
    dataset = Grasps()
    dataset = dataset[list(range(3, 40, 2))] if selected else dataset
    watched = Watched()
    parts = [ZScore("edge_attr"), SessionZScore(attr="pos"), ZScore("joint"), Tare()]
    transform = pose_first(watched, *parts)
    fit_parts(transform, dataset)
    assert max(watched.sizes) == 5
    whole = pose_first(*(type(part)(attr=part.attr) for part in parts))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_samples, "_CHUNK_BYTES", 2**30)
        fit_transform(whole, dataset)
    assert_same(states(transform), states(whole))
    assert transform.transforms[3].center.shape == (1, 1401, 4)


def test_parts_see_what_the_fitted_before_them_return():
    transform = hand(ZScore("edge_attr"), ZScore())
    fit_parts(transform, Grasps())
    again = fitted_parts(transform)[-1]
    assert again.center.abs().max() < 1e-5  # scaled already
    assert (again.scale - 1).abs().max() < 1e-5
    edge_attr = transform(Grasps().data).edge_attr
    assert edge_attr.mean(0).abs().max() < 1e-4


def test_selection_is_not_copied(few, monkeypatch):
    def refuse(self):
        raise AssertionError("all samples were read at once")

    dataset = Grasps()[5:35]
    monkeypatch.setattr(StaticDataset, "data", property(refuse))
    fit_parts(hand(ZScore("edge_attr"), SessionZScore()), dataset)
    fit_parts(Compose([SessionZScore()]), dataset, adapt=True)


def test_samples_read_in_order_are_views():
    data = Grasps().data
    (chunk,) = _samples.Samples(data).values("x", torch.arange(10, 20))
    assert chunk.data_ptr() == data.x[10:].data_ptr()


def test_before_is_applied_and_not_fitted():
    scaled = ZScore("joint").fit(Grasps())
    center = scaled.center
    dataset = Grasps(transform=scaled)
    transform = ZScore("joint")
    fit_parts(transform, dataset, before=dataset.transform)
    assert transform.center.abs().max() < 1e-6
    assert scaled.center is center
    fit_parts(transform, dataset)  # a data set's own transform is left out
    assert torch.equal(transform.center, center)


def test_key_may_come_from_a_part_before():
    transform = Compose([Watched(), SessionZScore("seen")])
    fit_parts(transform, Grasps()[:20])
    assert transform.transforms[1].key_values.tolist() == [7, 8]
    fit_parts(transform, Grasps()[20:], adapt=True)
    assert transform.transforms[1].key_values.tolist() == [7, 8, 9, 10]
    assert transform(Grasps().data).x.mean(0).abs().max() < 1e-5


def test_adapt_reads_nothing_without_a_key():
    watched = Watched()
    transform = Compose([watched, ZScore()])
    fit_parts(transform, Grasps())
    watched.sizes.clear()
    fit_parts(transform, Grasps(), adapt=True)
    assert watched.sizes == []


def test_nothing_to_fit():
    fit_parts(None, Grasps())
    fit_parts(Compose([]), Grasps())
    with pytest.raises(ValueError, match=r"ZScore must be fitted on samples \(got none\)"):
        fit_parts(ZScore(), Grasps()[:0])
