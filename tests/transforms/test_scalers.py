import copy
import io

import numpy as np
import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import Normalize, SessionZScore, Tare, ZScore


def sessions(**kwargs):
    x = torch.tensor([1.0, 3.0, 101.0, 105.0, 109.0]).view(5, 1, 1)
    return StaticData(x=x, session=torch.tensor([0, 0, 4, 4, 4]), **kwargs)


def random_data(num_samples=20):
    generator = torch.Generator().manual_seed(0)
    x = 7 + 3 * torch.randn(num_samples, 4, 2, generator=generator)
    return StaticData(x=x, session=torch.arange(num_samples) % 3)


def fitted():
    makes = (ZScore(), SessionZScore(), Tare(), Tare(first=2), Normalize(), ZScore(per="channel"))
    return [transform.fit(random_data()) for transform in makes]


def test_z_score_by_hand():
    # Taxel 0: mean 2, deviation 1; taxel 1: mean 20, deviation 10.
    train = StaticData(x=torch.tensor([[[1.0], [10.0]], [[3.0], [30.0]]]))
    transform = ZScore().fit(train)
    assert transform(train).x.view(2, 2).tolist() == [[-1, -1], [1, 1]]
    test = StaticData(x=torch.tensor([[[5.0], [20.0]]]))  # not fitted again on the test part
    assert transform(test).x.view(2).tolist() == [3, 0]
    assert transform.adapt(test)(test).x.view(2).tolist() == [3, 0]


def test_session_z_score_by_hand():
    x = SessionZScore().fit(sessions())(sessions()).x.view(-1)
    root = (32 / 3) ** 0.5  # the deviation of 101, 105, 109
    assert torch.allclose(x, torch.tensor([-1, 1, -4 / root, 0, 4 / root]))


def test_tare_by_hand():
    assert Tare().fit(sessions())(sessions()).x.view(-1).tolist() == [-1, 1, -4, 0, 4]
    assert Tare(first=1).fit(sessions())(sessions()).x.view(-1).tolist() == [0, 2, 0, 4, 8]
    assert Tare(first=2).fit(sessions())(sessions()).x.view(-1).tolist() == [-1, 1, -2, 2, 6]


def test_z_score_missing_readings():
    nan = torch.nan
    data = StaticData(x=torch.tensor([[nan, nan], [1.0, nan], [3.0, nan], [nan, nan]])[..., None])
    transform = ZScore().fit(data)
    assert transform.center.view(-1).tolist() == [2, 0]
    assert transform.scale.view(-1).tolist() == [1, 1]
    x = transform(data).x.view(4, 2)
    assert x[1:3, 0].tolist() == [-1, 1]
    assert x.isnan().tolist() == data.x.view(4, 2).isnan().tolist()


def test_z_score_constant_taxel():
    for level in (0.0, 3000.1, -1e-3):
        data = StaticData(x=torch.full((5, 1, 1), level))
        transform = ZScore().fit(data)
        assert transform.scale.item() == 1
        assert transform(data).x.abs().max() == 0
        assert transform(StaticData(x=data.x + 2)).x.sub(2).abs().max() < 1e-3


@pytest.mark.parametrize("transform", [ZScore(), SessionZScore()], ids=str)
def test_scalers_large_offset(transform):
    draw = np.random.default_rng(0)
    x = draw.normal(3000 + draw.uniform(-100, 100, (24, 3)), 0.5, (9000, 24, 3)).astype(np.float32)
    exact = x.astype(np.float64)
    expected = (exact - exact.mean(0)) / exact.std(0)
    data = StaticData(x=torch.from_numpy(x), session=torch.zeros(9000, dtype=torch.long))
    found = transform.fit(data)(data).x
    assert found.dtype == torch.float
    assert np.abs(found.numpy() - expected).max() < 1e-4


def test_step_of_an_exported_graph_keeps_the_digits_of_large_offsets():
    x = 1 + torch.tensor([0, 0, 1, 1, 2]) / 2**18  # the mean is between two numbers of float32
    data = StaticData(x=x.view(5, 1, 1))
    transform = ZScore().fit(data)
    found = transform.graph_step(data, set())(data.index_select(slice(None))).x
    torch.testing.assert_close(found, transform(data).x, rtol=0, atol=1e-4)


def test_scalers_strided_readings():
    x = random_data().x
    strided = StaticData(x=x.permute(2, 1, 0).contiguous().permute(2, 1, 0))
    assert not strided.x.is_contiguous()
    assert torch.equal(
        ZScore().fit(strided)(strided).x, ZScore().fit(random_data())(random_data()).x
    )


def test_session_z_score_adapt():
    data = sessions()
    transform = SessionZScore().fit(data.index_select(slice(2, 5)))
    before = transform.center.clone()
    with pytest.raises(ValueError, match="was not fitted on session 0: call 'adapt'"):
        transform(data)
    changed = StaticData(x=data.x + 1000, session=data.session)
    transform.adapt(changed)  # measures session 0 and leaves session 4 alone
    assert transform.key_values.tolist() == [0, 4]
    assert torch.equal(transform.center[1:], before)
    assert transform.center.view(-1).tolist() == [1002, 105]
    assert transform(changed).x.view(-1)[:2].tolist() == [-1, 1]
    transform.adapt(data)
    assert transform.center.view(-1).tolist() == [1002, 105]
    transform.fit(data)
    assert transform.center.view(-1).tolist() == [2, 105]


def test_session_z_score_column_of_sessions():
    data = sessions()
    column = StaticData(x=data.x, session=data.session.view(-1, 1))
    transform = SessionZScore().fit(column)
    assert transform.center.view(-1).tolist() == [2, 105]
    assert torch.equal(transform(column).x, transform(data).x)
    sample = Data(x=torch.tensor([[105.0]]), session=4)  # a plain number, as in a live stream
    assert transform(sample).x.item() == 0


def test_scalers_state_dict():
    for transform in fitted():
        file = io.BytesIO()
        torch.save(transform.state_dict(), file)
        file.seek(0)
        state = torch.load(file, weights_only=True)
        other = copy.deepcopy(transform)
        other.load_state_dict(type(transform)().state_dict())
        with pytest.raises(RuntimeError, match="must be fitted"):
            other(random_data())
        other.load_state_dict(state)
        assert torch.equal(other(random_data()).x, transform(random_data()).x)


@pytest.mark.parametrize(
    "transform", [ZScore(), SessionZScore("trial"), Tare(), Normalize()], ids=str
)
def test_scalers_unfitted(transform):
    assert isinstance(transform, BaseTransform)
    with pytest.raises(RuntimeError, match=f"{type(transform).__name__} must be fitted before"):
        transform(random_data())
    assert transform.state_dict() == {}


@pytest.mark.parametrize("size", [(3, 2), (5, 3, 2), (5, 8, 2), (5, 4, 3), (4, 1), (2, 5, 4, 2)])
def test_scalers_wrong_shape(size):
    match = r"'x' must have 4 taxels and 2 features, as in .* ZScore was fitted \(got shape"
    with pytest.raises(ValueError, match=match):
        ZScore().fit(random_data())(Data(x=torch.zeros(size)))


def test_scalers_bad_input():
    without = StaticData(x=torch.zeros(3, 4, 2))
    with pytest.raises(ValueError, match=r"Tare needs samples with 'trial' \(got none\)"):
        Tare("trial").fit(without)
    with pytest.raises(ValueError, match=r"SessionZScore needs samples with 'session'"):
        SessionZScore().fit(random_data())(without)
    for wrong in (torch.zeros(2, dtype=torch.long), torch.tensor(0)):
        data = StaticData(x=torch.zeros(3, 4, 2), session=wrong, shared=["session"])
        match = rf"'session' must have 3 values, one for each sample \(got {wrong.numel()}\)"
        with pytest.raises(ValueError, match=match):
            SessionZScore().fit(data)
        with pytest.raises(ValueError, match=match):
            SessionZScore().fit(random_data())(data)
    with pytest.raises(ValueError, match=r"'first' must be at least 1 \(got 0\)"):
        Tare(first=0)
