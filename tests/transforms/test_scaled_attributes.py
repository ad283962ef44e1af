import pytest
import torch
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import Normalize, SessionZScore, Tare, ZScore

EDGES = torch.tensor([[0, 1, 2], [1, 2, 3]])
ATTRIBUTES = ("x", "edge_attr", "joint", "absolute", "pos", "edge_weight", "force")


def hand(num_samples=20, **kwargs):
    draw = torch.Generator().manual_seed(0)

    def normal(*size):
        return 2 + 3 * torch.randn(num_samples, *size, generator=draw)

    data = StaticData(
        x=normal(4, 2),
        edge_index=EDGES,
        edge_attr=normal(3, 4),
        pos=normal(4, 3),
        edge_weight=normal(3),
        absolute=normal(4, 4),
        joint=normal(5),
        force=normal(),
        session=torch.arange(num_samples) % 3,
    )
    for key, value in kwargs.items():
        data[key] = value
    return data


@pytest.mark.parametrize("attr", ATTRIBUTES)
@pytest.mark.parametrize("kind", [ZScore, SessionZScore, Normalize, Tare])
def test_each_number_of_an_attribute_is_scaled_by_itself(kind, attr):
    data = hand()
    out = kind(attr=attr).fit(data)(data)
    for key in ATTRIBUTES:
        assert out[key].equal(data[key]) == (key != attr)
    if kind is ZScore:
        expected = (data[attr] - data[attr].mean(0)) / data[attr].std(0, unbiased=False)
        torch.testing.assert_close(out[attr], expected, rtol=0, atol=1e-5)
    elif kind is Normalize:
        assert out[attr].amin(0).add(1).abs().max() < 1e-5
        assert out[attr].amax(0).sub(1).abs().max() < 1e-5
    elif kind is SessionZScore:
        assert out[attr][data.session == 1].mean(0).abs().max() < 1e-5


def test_joint_by_hand():
    # Joint 0: mean 2, deviation 1; joint 1: mean 20, deviation 10.
    data = StaticData(x=torch.zeros(2, 1, 1), joint=torch.tensor([[1.0, 10.0], [3.0, 30.0]]))
    transform = ZScore(attr="joint").fit(data)
    assert transform(data).joint.tolist() == [[-1, -1], [1, 1]]
    assert transform(Data(joint=torch.tensor([[5.0, 20.0]]))).joint.tolist() == [[3, 0]]
    assert transform(Data(joint=torch.tensor([5.0, 20.0]))).joint.tolist() == [3, 0]
    batch = Batch.from_data_list(data.to_data_list())
    assert transform(batch).joint.tolist() == [[-1, -1], [1, 1]]


def test_edge_attr_by_hand():
    edge_attr = torch.tensor([[[1.0], [7.0]], [[3.0], [7.0]]])
    data = StaticData(x=torch.zeros(2, 1, 1), edge_attr=edge_attr)
    transform = ZScore("edge_attr").fit(data)
    assert transform.scale.view(-1).tolist() == [1, 1]  # the second never changes
    assert transform(data).edge_attr.view(-1).tolist() == [-1, 0, 1, 0]
    assert data.edge_attr is edge_attr


@pytest.mark.parametrize("attr", ["edge_attr", "absolute", "pos"])
@pytest.mark.parametrize("kind", [ZScore, Normalize])
def test_shared_attribute_stays_shared(kind, attr, caplog):
    shared = torch.rand(3 if attr == "edge_attr" else 4, 4)
    data = hand(**{attr: shared})
    transform = kind(attr=attr).fit(data)
    assert f"all samples share one '{attr}'" in caplog.text
    assert_transform_static_equals_batched(transform, data)
    assert transform(data)[attr].shape == shared.shape
    assert transform(data)[attr].abs().max() < 1e-6
    assert transform(data.sample(0))[attr].shape == shared.shape


def test_shared_attribute_scaled_by_session_is_no_longer_shared():
    data = hand(edge_attr=torch.ones(3, 4))
    transform = SessionZScore(attr="edge_attr").fit(data)
    transform.center[1] += 5
    assert_transform_static_equals_batched(transform, data)
    assert transform(data).edge_attr.shape == (20, 3, 4)


def test_rounding_is_no_change():
    # The length of an edge in a rigid patch, computed from places in the root frame.
    length = torch.full((50, 1), 0.0047) + 2e-8 * torch.randn(50, 1)
    other = 0.05 + 0.01 * torch.randn(50, 1)
    slow = 0.01 + 1e-5 * torch.randn(50, 1)
    edge_attr = torch.stack([length, other, slow], dim=1)
    data = StaticData(x=torch.zeros(50, 1, 1), edge_attr=edge_attr)
    scale = ZScore("edge_attr").fit(data).scale.view(-1)
    assert scale[0] == 1
    assert scale[1:].allclose(edge_attr[:, 1:, 0].std(0, unbiased=False), rtol=1e-3)
    assert Normalize(attr="edge_attr").fit(data).scale[0, 0] == 1
    assert Normalize(attr="edge_attr").fit(data).scale[0, 1] < 0.1


@pytest.mark.parametrize("attr", ATTRIBUTES)
def test_no_sample_and_no_edge(attr):
    transform = ZScore(attr).fit(hand())
    empty = hand().index_select(torch.empty(0, dtype=torch.long))
    assert transform(empty)[attr].shape == empty[attr].shape
    without = hand(2, edge_index=EDGES[:, :0], edge_attr=torch.zeros(2, 0, 4))
    assert ZScore("edge_attr").fit(without)(without).edge_attr.shape == (2, 0, 4)


def test_one_value_for_all_samples_cannot_be_scaled_by_session():
    data = hand(3).declare(shared=["force"])
    transform = SessionZScore(attr="force").fit(hand())
    with pytest.raises(ValueError, match=r"'force' must have a value for each sample, .*'shared'"):
        transform(data)


def test_state_of_old_checkpoints_is_taken_over():
    state = {  # as versions without 'attr' wrote it
        "center": torch.full((1, 4, 2), 2.0, dtype=torch.double),
        "scale": torch.full((1, 4, 2), 4.0),
        "key_values": torch.tensor([0]),
    }
    transform = ZScore()
    transform.load_state_dict(state)
    assert transform(Data(x=torch.full((4, 2), 10.0))).x.unique().tolist() == [2]


@pytest.mark.parametrize(
    ("attr", "size"),
    [
        ("joint", (6,)),
        ("joint", (20, 6)),
        ("joint", (20, 1, 5)),
        ("edge_attr", (4, 4)),
        ("edge_attr", (3, 5)),
        ("edge_attr", (20, 6, 4)),
        ("force", ()),
        ("force", (20, 1)),
    ],
)
def test_wrong_shape_is_named(attr, size):
    transform = ZScore(attr).fit(hand())
    with pytest.raises(
        ValueError, match=rf"'{attr}' must have shape .* in each sample, as in .* ZScore was"
    ):
        transform(Data(**{attr: torch.zeros(size)}))


def test_missing_attribute_is_named():
    data = StaticData(x=torch.zeros(2, 4, 2))
    with pytest.raises(ValueError, match=r"ZScore needs 'edge_attr' \(got none\)"):
        ZScore("edge_attr").fit(data)
    with pytest.raises(ValueError, match=r"ZScore needs 'edge_attr' \(got none\)"):
        ZScore("edge_attr").fit(hand())(data)
