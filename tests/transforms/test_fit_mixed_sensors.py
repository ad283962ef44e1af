import pytest
import torch
from mixed_sensors import Gloves, gloves
from torch.utils.data import Subset
from torch_geometric.data import Batch, Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import Compose

from torch_geometric_tactile.transforms import (
    FillMissing,
    GeometricEdgeAttr,
    SelectChannels,
    SessionZScore,
    ZScore,
    fit_parts,
)

SAMPLES = gloves()
ALL = torch.cat([sample.x for sample in SAMPLES])


@pytest.mark.parametrize("data", [SAMPLES, Gloves(), Subset(SAMPLES, range(72))], ids=type)
def test_one_centre_and_scale_of_all_taxels(data):
    scale = ZScore(per="channel").fit(data)
    assert scale.center.shape == (1, 1, 2)
    torch.testing.assert_close(scale.center.view(-1).float(), ALL.mean(dim=0))
    torch.testing.assert_close(scale.scale.view(-1), ALL.std(dim=0, correction=0))
    batch = next(iter(DataLoader([scale(sample) for sample in SAMPLES], batch_size=72)))
    joined = scale(Batch.from_data_list(SAMPLES))
    torch.testing.assert_close(batch.x, joined.x)
    torch.testing.assert_close(batch.x.mean(dim=0), torch.zeros(2), atol=1e-5, rtol=0)


def test_by_hand():
    samples = [Data(x=torch.tensor([[1.0], [3.0]])), Data(x=torch.tensor([[8.0]]))]
    scale = ZScore(per="channel").fit(samples)
    assert scale.center.item() == 4
    assert scale.scale.item() == pytest.approx((26 / 3) ** 0.5)


def test_missing_readings_do_not_count():
    samples = [Data(x=torch.tensor([[1.0], [torch.nan]])), Data(x=torch.tensor([[3.0]]))]
    assert ZScore(per="channel").fit(samples).center.item() == 2


def test_session_by_session():
    scale = SessionZScore(key="group", per="channel").fit(SAMPLES)
    assert scale.key_values.tolist() == list(range(12))
    of_first = torch.cat([sample.x for sample in SAMPLES if sample.group == 0])
    torch.testing.assert_close(scale.center[0].view(-1).float(), of_first.mean(dim=0))
    batch = scale(Batch.from_data_list(SAMPLES))
    torch.testing.assert_close(batch[0].x, scale(SAMPLES[0]).x)


def test_behind_other_transforms_and_of_edges():
    steps = Compose([GeometricEdgeAttr(), ZScore(attr="edge_attr", per="channel"), FillMissing()])
    fit_parts(steps, SAMPLES)
    edges = torch.cat([steps(sample).edge_attr for sample in SAMPLES])
    torch.testing.assert_close(edges.mean(dim=0), torch.zeros(edges.size(1)), atol=1e-4, rtol=0)
    one = ZScore(per="channel").fit(SAMPLES, before=SelectChannels([1]))
    torch.testing.assert_close(one.center.view(-1).float(), ALL[:, 1:].mean(dim=0))


def test_a_centre_of_each_taxel_is_refused():
    match = (
        r"ZScore must be fitted on .* except with per='channel', .*\(got samples of 30 to 60 tax"
    )
    for scale in (ZScore(), ZScore(scale_per="channel")):
        with pytest.raises(ValueError, match=match):
            scale.fit(SAMPLES)
    for nothing in ([], Subset(SAMPLES, [])):
        with pytest.raises(ValueError, match=r"ZScore must be fitted on samples \(got none\)"):
            ZScore(per="channel").fit(nothing)
    with pytest.raises(ValueError, match=r"ZScore needs 'absolute' \(got none\)"):
        ZScore(attr="absolute", per="channel").fit(SAMPLES)
    with pytest.raises(ValueError, match=r"SessionZScore needs samples with 'size' \(got none\)"):
        SessionZScore(key="size", per="channel").fit(SAMPLES)
