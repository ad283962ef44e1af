import numpy as np
import pytest
import torch

from torch_geometric_tactile.baselines import PosedSummary, posed_summary
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import TaxelForce

# Two patches of two taxels.
LAYOUT = TaxelLayout(
    name="two",
    pos=torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 4, 0]]),
    normal=torch.tensor([[0.0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    patch=torch.tensor([0, 0, 1, 1]),
    patch_names=("a", "b"),
)
REST = np.tile([5.0, 5.0, 7.0, 7.0], (5, 1))
TOUCH = np.array([[6.0, 8.0, 7.0, 7.0], [5.0, 5.0, 7.0, 9.0]])
X = np.concatenate([REST, TOUCH])[:, :, None]


def test_features_by_hand():
    features = posed_summary(X, LAYOUT)
    # force, centre, normal, count of each patch
    rest = [0, 0.5, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0]
    assert np.array_equal(features[:5], np.tile(rest, (5, 1)))
    assert features[5].tolist() == [4, 0.75, 0, 0, 0, 0, 1, 2, *rest[8:]]
    assert features[6].tolist() == [*rest[:8], 2, 0, 4, 0, 0, 1, 0, 1]


def test_places_of_samples_are_taken():
    pos = torch.zeros(7, 4, 3)
    pos[6, 3] = torch.tensor([9.0, 8.0, 7.0])
    normal = torch.zeros(7, 4, 3)
    normal[6, 3, 2] = -1.0
    data = StaticData(x=torch.from_numpy(X), pos=pos, normal=normal)
    features = PosedSummary(LAYOUT).fit(data).transform(data)
    assert features.shape == (7, 16)
    assert features[6, 8:].tolist() == [2, 9, 8, 7, 0, 0, -1, 1]


def test_shear_and_pressure_are_turned_to_the_palm_as_taxel_force_does():
    tangent = torch.tensor([[0.0, 1, 0], [0, 0, 1]]).expand(4, 2, 3)
    normal = torch.tensor([[1.0, 0, 0]]).expand(4, 3)
    x = torch.zeros(7, 4, 3)
    x[6, 0] = torch.tensor([2.0, 3.0, 5.0])
    data = StaticData(x=x, pos=LAYOUT.pos, normal=normal, tangent=tangent)
    features = PosedSummary(LAYOUT).fit(data).transform(data)
    assert features[6, :3].tolist() == [-5, 2, 3]
    assert TaxelForce()(data).x[6, 0].tolist() == [-5, 2, 3]
    plain = StaticData(x=x, pos=LAYOUT.pos, normal=normal)
    assert posed_summary(plain, LAYOUT)[6, :3].tolist() == [2, 3, 5]


def test_missing_readings_are_not_pressed():
    x = X.copy()
    x[6, 3] = np.nan
    x[:, 0] = np.nan
    features = posed_summary(x, LAYOUT)
    assert np.isfinite(features).all()
    assert features[6, -1] == 0
    assert features[5, 7] == 1


def test_threshold_is_of_the_training_part():
    summary = PosedSummary(LAYOUT).fit(X)
    assert summary.transform(0.001 * TOUCH[:, :, None] + REST[:2, :, None])[0, 7] == 0


def test_other_taxels_are_refused():
    with pytest.raises(ValueError, match="'x' must have 4 taxels, like layout 'two'"):
        posed_summary(X[:, :3], LAYOUT)
