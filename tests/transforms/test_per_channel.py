import copy

import numpy as np
import pytest
import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import Normalize, SessionZScore, ZScore, fit_parts

PER = "channel"


def readings(num_samples=30, num_taxels=5, **kwargs):
    draw = torch.Generator().manual_seed(0)
    x = torch.randn(num_samples, num_taxels, 3, generator=draw) * torch.tensor([1.0, 9.0, 0.1]) + 7
    return StaticData(x=x, session=torch.arange(num_samples) % 3, **kwargs)


def both():
    return [ZScore(per=PER), Normalize(0.0, 1.0, per=PER), SessionZScore(per=PER)]


def test_z_score_of_channels_is_that_of_numpy():
    data = readings()
    exact = data.x.double().numpy()
    transform = ZScore(per=PER).fit(data)
    assert transform.center.shape == transform.scale.shape == (1, 1, 3)
    assert transform.center.dtype == torch.double
    expected = (exact - exact.mean((0, 1))) / exact.std((0, 1))
    np.testing.assert_allclose(transform(data).x.numpy(), expected, atol=1e-5)


def test_normalize_of_channels_by_hand():
    x = torch.tensor([[[1.0, 0.0], [3.0, 0.0]], [[5.0, torch.nan], [2.0, 4.0]]])
    found = Normalize(0.0, 1.0, per=PER).fit(StaticData(x=x))(StaticData(x=x)).x
    expected = torch.tensor([[[0.0, 0.0], [0.5, 0.0]], [[1.0, torch.nan], [0.25, 1.0]]])
    torch.testing.assert_close(found, expected, equal_nan=True)


def test_a_centre_of_each_taxel_and_one_scale_are_those_of_numpy():
    data = readings()
    data.x = data.x + 100 * torch.arange(5.0).view(5, 1)
    exact = data.x.double().numpy()
    transform = ZScore(scale_per=PER).fit(data)
    assert transform.center.shape == transform.scale.shape == (1, 5, 3)
    expected = (exact - exact.mean(0)) / np.sqrt(exact.var(0).mean(0))
    found = transform(data).x
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-4)
    assert float(found.square().mean()) == pytest.approx(1, abs=1e-4)
    again = ZScore(scale_per=PER)
    again.load_state_dict(transform.state_dict())
    assert torch.equal(again(data).x, found)


@pytest.mark.parametrize("arguments", [{}, {"per": PER}, {"scale_per": PER}])
def test_without_the_mean_zero_stays_zero(arguments):
    data = readings()
    data.x[0] = 0
    plain = ZScore(**arguments, with_mean=False).fit(data)
    centred = ZScore(**arguments).fit(data)
    assert torch.equal(plain.scale, centred.scale)
    assert not plain(data).x[0].any()
    torch.testing.assert_close(plain(data).x - centred(data).x, -centred(data).x[:1] + 0 * data.x)


def test_a_centre_of_each_taxel_and_one_scale_of_joints_and_of_what_never_changes():
    joint = torch.tensor([[1.0, 10.0], [3.0, 50.0]])
    data = StaticData(x=torch.full((2, 3, 1), 5.0), joint=joint)
    found = ZScore("joint", scale_per=PER).fit(data)(data)
    torch.testing.assert_close(found.joint, torch.tensor([[-1.0, -1.0], [1.0, 1.0]]))
    assert ZScore(scale_per=PER).fit(data)(data).x.tolist() == [[[0.0]] * 3] * 2


@pytest.mark.parametrize("per", ["taxel", PER])
def test_one_scale_of_all_numbers_keeps_directions(per):
    data = readings()
    exact = data.x.double().numpy()
    center = exact.mean(0) if per == "taxel" else exact.mean((0, 1))
    deviation = np.sqrt(np.square(exact - center).mean((0, 1)).mean())
    transform = ZScore(per=per, scale_per="all", with_mean=False).fit(data)
    np.testing.assert_allclose(transform(data).x.numpy(), exact / deviation, rtol=1e-5)
    found = ZScore(per=per, scale_per="all").fit(data)(data).x
    np.testing.assert_allclose(found.numpy(), (exact - center) / deviation, atol=1e-5)
    assert str(transform).endswith("scale_per='all', with_mean=False)")


def test_scale_per_must_not_be_finer_than_the_centre():
    for bad in ({"scale_per": "patch"}, {"per": PER, "scale_per": "taxel"}):
        with pytest.raises(
            ValueError, match=r"'scale_per' must be 'channel', 'all' or the same as 'per'"
        ):
            ZScore(**bad)
    assert str(ZScore(per=PER, scale_per=PER)) == "ZScore(per='channel')"


def test_taxels_keep_their_differences():
    """A taxel that is never pressed is not scaled up to those that are."""
    draw = torch.Generator().manual_seed(0)
    x = torch.randn(100, 2, 1, generator=draw) * torch.tensor([[0.01], [1.0]])
    data = StaticData(x=x)
    ratio = ZScore(per=PER).fit(data)(data).x.std(0).view(-1)
    assert float(ratio[0] / ratio[1]) == pytest.approx(float(x[:, 0].std() / x[:, 1].std()))
    alone = ZScore().fit(data)(data).x.std(0).view(-1)
    assert float(alone[0] / alone[1]) == pytest.approx(1.0)


def test_missing_readings_do_not_count():
    x = torch.tensor([[[torch.nan], [1.0]], [[torch.nan], [5.0]], [[3.0], [torch.nan]]])
    transform = ZScore(per=PER).fit(StaticData(x=x))
    assert transform.center.item() == 3
    assert transform.scale.item() == pytest.approx((8 / 3) ** 0.5)
    nothing = ZScore(per=PER).fit(StaticData(x=torch.full((4, 2, 1), torch.nan)))
    assert (nothing.center.item(), nothing.scale.item()) == (0, 1)


def test_large_offsets_keep_their_digits():
    draw = np.random.default_rng(0)
    x = draw.normal(33000, 0.5, (9000, 24, 3)).astype(np.float32)
    exact = x.astype(np.float64)
    data = StaticData(x=torch.from_numpy(x))
    found = ZScore(per=PER).fit(data)(data).x.numpy()
    expected = (exact - exact.mean((0, 1))) / exact.std((0, 1))
    assert np.abs(found - expected).max() < 1e-4


@pytest.mark.parametrize("transform", both(), ids=str)
def test_other_numbers_of_taxels_are_scaled_alike(transform):
    transform.fit(readings())
    wide = readings(num_taxels=8)
    few = readings(num_taxels=8)
    few.x = few.x[:, :2]
    assert transform(wide).x[:, :2].equal(transform(few).x)


def test_samples_of_a_batch_may_have_other_taxels_than_one_another():
    transform = SessionZScore(per=PER).fit(readings())
    parts = [Data(x=torch.randn(n, 3), session=torch.tensor([n % 3])) for n in (2, 5, 7)]
    batch = transform(Batch.from_data_list(copy.deepcopy(parts)))
    alone = torch.cat([transform(copy.copy(part)).x for part in parts])
    assert batch.x.equal(alone)


def test_sessions_by_hand_and_new_ones_are_adapted_to():
    x = torch.tensor([[1.0, 3.0], [101.0, 105.0], [7.0, 7.0]]).view(3, 2, 1)
    data = StaticData(x=x, session=torch.tensor([0, 4, 9]))
    transform = SessionZScore(per=PER).fit(data.index_select([0, 1]))
    with pytest.raises(ValueError, match="SessionZScore was not fitted on session 9"):
        transform(data)
    transform.adapt(data)
    assert transform(data).x.view(3, 2).tolist() == [[-1, 1], [-1, 1], [0, 0]]


def test_other_attributes_have_their_channels_last():
    draw = torch.Generator().manual_seed(0)
    edge_attr, joint = torch.rand(4, 2, generator=draw), torch.rand(30, 6, generator=draw)
    edge_index = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 4]])
    data = readings(edge_index=edge_index, edge_attr=edge_attr, joint=joint)
    edges = ZScore("edge_attr", per=PER).fit(data)
    expected = (edge_attr - edge_attr.mean(0)) / edge_attr.std(0, correction=0)
    torch.testing.assert_close(edges(data).edge_attr, expected)  # shared, and not zero
    assert edges.center.shape == (1, 1, 2)
    joints = ZScore("joint", per=PER).fit(data)
    assert joints(data).joint.equal(ZScore("joint").fit(data)(data).joint)


def test_shared_attribute_by_session():
    edge_attr = torch.tensor([[1.0], [3.0]])
    data = readings(edge_index=torch.tensor([[0, 1], [1, 0]]), edge_attr=edge_attr)
    transform = SessionZScore(attr="edge_attr", per=PER).fit(data)
    assert transform(data).edge_attr.equal(torch.tensor([[-1.0], [1.0]]).expand(30, 2, 1))


def test_lists_and_parts_of_a_pipeline_are_fitted_alike():
    data = readings()
    expected = ZScore(per=PER).fit(data)
    found = ZScore(per=PER)
    fit_parts(found, data.to_data_list())
    assert found.center.equal(expected.center)


def test_one_sample_alone():
    transform = ZScore(per=PER).fit(readings())
    assert transform(Data(x=torch.full((2, 3), 7.0))).x.shape == (2, 3)


@pytest.mark.parametrize("make", [ZScore, Normalize, SessionZScore])
def test_unknown_per(make):
    with pytest.raises(ValueError, match=r"'per' must be one of .* \(got 'patch'\)"):
        make(per="patch")


@pytest.mark.parametrize("shape", [(2, 5, 2), (5, 2), (3,), (1, 2, 5, 3)])
def test_other_channels_are_named(shape):
    transform = ZScore(per=PER).fit(readings())
    with pytest.raises(ValueError, match=r"'x' must have 3 channels, in its last of 2 or 3 dim"):
        transform(Data(x=torch.zeros(shape)))
