from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import Linear, Module
from torch_geometric.transforms import BaseTransform, Compose, Distance

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import (
    Recording,
    StaticData,
    StaticDataset,
    Windows,
    apply_transform,
)
from torch_geometric_tactile.nn import TactileGCN, TaxelNet
from torch_geometric_tactile.predictor import _constant_transforms as constant_transforms
from torch_geometric_tactile.sensors import HandKinematics, Joint, TaxelLayout, grid
from torch_geometric_tactile.transforms import (
    FillMissing,
    GeometricEdgeAttr,
    KNNGraph,
    SessionZScore,
    Tare,
    TaxelPose,
    ZScore,
    fit_parts,
)

LAYOUT = grid(2, 2, pitch=0.01)
NAMES = ("soft", "hard")


class Sum(Module):
    """Two logits a frame: the sum of the readings, and its negative."""

    def forward(self, x, edge_index):
        total = x.sum(dim=(1, 2))
        return torch.stack([total, -total], dim=1)


def readings(*size, seed=0):
    return torch.randn(*size, generator=torch.Generator().manual_seed(seed))


def test_probabilities_by_hand():
    x = torch.tensor([[0.25], [0.0], [0.5], [-0.5]])  # sums to 0.25
    logits = torch.tensor([0.25, -0.25])
    for task, expected in (
        ("multiclass", logits.softmax(0)),
        ("multilabel", logits.sigmoid()),
        ("regression", logits),
    ):
        predictor = Predictor(Sum(), LAYOUT, task=task)
        torch.testing.assert_close(predictor(x), expected)
    scaled = ZScore().fit(StaticData(x=torch.tensor([1.0, 3.0]).view(2, 1, 1).expand(2, 4, 1)))
    torch.testing.assert_close(  # (x - 2) / 1 summed over four taxels
        Predictor(Sum(), LAYOUT, scaled, task="regression")(x), torch.tensor([-7.75, 7.75])
    )


def test_one_frame_many_frames_numpy_and_integers_agree():
    predictor = Predictor(Sum(), LAYOUT, num_channels=2)
    x = (10 * readings(5, 4, 2)).round()
    many = predictor(x)
    assert many.shape == (5, 2)
    for i in range(5):
        assert predictor(x[i]).equal(many[i])
    assert predictor(x.numpy()).equal(many)
    assert predictor(x.numpy().astype(np.int32)).equal(many)
    assert predictor(x.tolist()).equal(many)
    read_only = x.numpy().copy()
    read_only.flags.writeable = False
    assert predictor(read_only).equal(many)
    assert predictor(x[:0]).shape == (0, 2)
    assert predictor(x[:1]).shape == (1, 2)
    assert predictor(x[:1].tolist()).shape == (1, 2)


HAND = HandKinematics([Joint("bend", "base", "tip", axis=(0.0, 0.0, 1.0))], name="finger")
FINGER = TaxelLayout(
    "finger",
    pos=0.01 * torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]),
    link=torch.tensor([0, 0, 1, 1]),
    link_names=("base", "tip"),
    adjacency={"original": torch.tensor([[0, 1, 2, 3], [1, 2, 3, 0]])},
)


def finger_chain():
    return Compose(
        [
            ZScore(),
            TaxelPose(FINGER, HAND, normal=False),
            GeometricEdgeAttr(),
            ZScore(attr="edge_attr"),
            ZScore(attr="joint"),
        ]
    )


def test_the_whole_chain_equals_transforms_and_model_by_hand():
    x, joint = readings(6, 4, 3), readings(6, 1, seed=1)
    edge_index = FINGER.edge_index("original")
    data = StaticData(x=x, joint=joint, edge_index=edge_index)
    chain = finger_chain()
    fit_parts(chain, data)
    torch.manual_seed(0)
    model = TactileGCN(4, 3, inputs=("tactile", "edge"), num_edges=4, num_joints=1).eval()
    predictor = Predictor(model, FINGER, chain, adjacency="original", num_joints=1)
    ready = apply_transform(chain, data)
    with torch.no_grad():
        logits = model(ready.x, edge_index, edge_attr=ready.edge_attr, joint=ready.joint)
    torch.testing.assert_close(predictor(x, joint), logits.softmax(dim=1))
    torch.testing.assert_close(predictor(x[2], joint[2]), logits.softmax(dim=1)[2])
    # One pose for all frames.
    same = predictor(x, joint[2].expand(6, 1))
    torch.testing.assert_close(predictor(x, joint[2]), same)
    assert not predictor.model.training
    prepared = predictor.prepare_samples(data)
    torch.testing.assert_close(predictor.logits(prepared), logits)


def test_a_predictor_is_a_copy():
    x = readings(3, 4, 1)
    model, scaler = Linear(1, 1), ZScore().fit(StaticData(x=x))

    class Flat(Module):
        def __init__(self):
            super().__init__()
            self.lin = model

        def forward(self, x, edge_index):
            return self.lin(x).mean(dim=1)

    flat = Flat().train()
    predictor = Predictor(flat, LAYOUT, scaler, task="regression")
    before = predictor(x)
    with torch.no_grad():
        model.weight.add_(1)
    scaler.fit(StaticData(x=x + 5))
    assert flat.training
    assert predictor(x).equal(before)
    predictor.model.train()  # as by a training loop that holds it
    assert predictor(x).equal(before)
    assert not predictor.model.training


def test_what_depends_on_the_layout_is_computed_once(monkeypatch):
    calls = []
    forward = KNNGraph.forward
    monkeypatch.setattr(KNNGraph, "forward", lambda t, data: calls.append(1) or forward(t, data))

    class Edges(Module):
        modalities = ("edge_attr",)

        def forward(self, x, edge_index, edge_attr):
            lengths = edge_attr[..., 0].sum(dim=-1).expand(len(x))
            return torch.stack([lengths, x.sum(dim=(1, 2))], dim=1)

    chain = Compose([FillMissing(), KNNGraph(k=1), GeometricEdgeAttr(), Distance(norm=False)])
    predictor = Predictor(Edges(), LAYOUT, chain, task="regression")
    data = StaticData(x=readings(2, 4, 1), pos=LAYOUT.pos)
    ready = apply_transform(chain, data)
    calls.clear()
    for i in range(2):
        expected = torch.stack([ready.edge_attr[:, 0].sum(), data.x[i].sum()])
        torch.testing.assert_close(predictor(data.x[i]), expected)
    assert predictor.prepare(data.x).edge_attr.equal(ready.edge_attr)
    assert not calls


def test_order_is_kept_where_a_later_transform_changes_what_an_earlier_one_read():
    # The edges of the pose must be those before the graph is made anew.
    chain = Compose([TaxelPose(FINGER, HAND), GeometricEdgeAttr(), KNNGraph(k=1)])
    shared = StaticData(
        x=torch.zeros(1, 4, 0), pos=FINGER.pos, edge_index=FINGER.edge_index("original")
    )
    _, rest = constant_transforms.apply_constant_transforms(shared, chain.transforms)
    assert rest == chain.transforms
    _, rest = constant_transforms.apply_constant_transforms(
        shared, [KNNGraph(k=1), *chain.transforms[:2]]
    )
    assert rest == chain.transforms[:2]
    _, rest = constant_transforms.apply_constant_transforms(
        shared, [torch.nn.Identity(), KNNGraph(k=1)]
    )
    assert len(rest) == 2


def test_missing_readings():
    x = readings(3, 4, 1)
    x[1, 2] = torch.nan
    plain = Predictor(Sum(), LAYOUT, class_names=NAMES)
    found = plain(x)
    assert found.isnan().any(dim=1).tolist() == [False, True, False]
    assert [len(labels) for labels in plain.labels(found)] == [1, 0, 1]
    filled = Predictor(Sum(), LAYOUT, FillMissing(), class_names=NAMES)
    torch.testing.assert_close(filled(x), Predictor(Sum(), LAYOUT)(x.nan_to_num()))


def test_masked_and_infinite_readings_are_missing():
    predictor = Predictor(Sum(), LAYOUT, num_channels=2)
    x = np.random.default_rng(0).normal(size=(3, 4, 2)).astype(np.float32)
    hidden = np.zeros(x.shape, dtype=bool)
    hidden[1, 2, 0] = True
    missing = predictor(np.where(hidden, np.nan, x))
    assert missing.isnan().any(dim=1).tolist() == [False, True, False]
    assert predictor.labels(missing)[1] == []
    for value in (np.ma.masked_array(x, hidden), np.where(hidden, np.inf, x)):
        torch.testing.assert_close(predictor(value), missing, equal_nan=True)
    counts = np.ma.masked_array((10 * x).astype(np.int16), hidden)
    assert predictor(counts).isnan().any(dim=1).tolist() == [False, True, False]
    filled = Predictor(Sum(), LAYOUT, FillMissing(), num_channels=2)
    expected = filled(np.where(hidden, np.nan, x))
    assert filled(np.ma.masked_array(x, hidden)).equal(expected)
    assert filled(np.where(hidden, -np.inf, x)).equal(expected)


def test_labels():
    probability = torch.tensor([[0.2, 0.8], [0.6, 0.9], [0.1, 0.3]])
    one = Predictor(Sum(), LAYOUT, class_names=NAMES)
    assert one.labels(probability) == [["hard"], ["hard"], ["hard"]]
    assert one.labels(probability[0]) == [["hard"]]
    assert one.labels(probability[:0]) == []
    several = Predictor(Sum(), LAYOUT, class_names=NAMES, task="multilabel")
    assert several.labels(probability) == [["hard"], ["soft", "hard"], []]
    assert Predictor(Sum(), LAYOUT).labels(probability) == [["1"], ["1"], ["1"]]
    with pytest.raises(ValueError, match=r"'class_names' must have 3 names.*\(got 2\)"):
        one.labels(torch.rand(2, 3))
    with pytest.raises(ValueError, match="a regression has no labels"):
        Predictor(Sum(), LAYOUT, task="regression").labels(probability)


def test_sessions_are_measured_without_labels():
    x = readings(8, 4, 1)
    session = torch.arange(8) // 4
    chain = Compose([Tare("session", first=2), SessionZScore()])
    data = StaticData(x=x, session=session)
    fit_parts(chain, data)
    predictor = Predictor(Sum(), LAYOUT, chain, task="regression")
    with pytest.raises(ValueError, match=r"adapt.* with some unlabelled readings of this session"):
        predictor(x)
    expected = apply_transform(chain, data).x.sum(dim=(1, 2))
    torch.testing.assert_close(predictor(x[4:], session=1)[:, 0], expected[4:])
    # The same readings as a session that was never seen give the same numbers.
    assert predictor.adapt(x[4:]) == 2
    torch.testing.assert_close(predictor(x[4:])[:, 0], expected[4:])
    torch.testing.assert_close(predictor(x[:4], session=0)[:, 0], expected[:4])
    assert predictor.adapt(x[:4] + 7) == 3
    torch.testing.assert_close(predictor(x[:4] + 7)[:, 0], expected[:4], atol=1e-4, rtol=0)
    with pytest.raises(ValueError, match="was not fitted on session 9"):
        predictor(x, session=9)
    with pytest.raises(ValueError, match="no transform of this predictor measures sessions"):
        Predictor(Sum(), LAYOUT).adapt(x)


def test_rest_by_seconds_needs_times():
    x = readings(4, 4, 1)
    tare = Tare("session", seconds=0.25)
    tare.fit(StaticData(x=x, session=torch.zeros(4), time=torch.arange(4) / 10))
    predictor = Predictor(Sum(), LAYOUT, tare, task="regression")
    predictor.adapt(x, time=torch.arange(4) / 10)
    expected = (x - x[:3].mean(dim=0)).sum(dim=(1, 2))
    torch.testing.assert_close(predictor(x)[:, 0], expected)
    with pytest.raises(ValueError, match="needs samples with 'time'"):
        predictor.adapt(x)


def test_a_recording_is_predicted_in_parts():
    tactile = readings(7, 4, 2).numpy()
    recording = Recording(time=np.arange(7) / 100, tactile=tactile)
    predictor = Predictor(Sum(), LAYOUT)
    whole = predictor.recording(recording)
    assert whole.equal(predictor(tactile))
    torch.testing.assert_close(predictor.recording(recording, batch_size=3), whole)
    assert predictor.recording(recording.select(slice(0, 0))).shape == (0, 2)
    with pytest.raises(ValueError, match="'batch_size' must be at least 1"):
        predictor.recording(recording, batch_size=0)
    with pytest.raises(ValueError, match=r"must have 4 taxels \(got 3\)"):
        predictor.recording(Recording(time=np.arange(7) / 100, tactile=tactile[:, :3]))


class Double(BaseTransform):
    def forward(self, data):
        data.x = 2 * data.x
        return data


def test_from_dataset_takes_its_transforms_once(toy):
    # The graph of the data set is taken as it is; only what changes readings is applied again.
    pre = Compose([Double(), KNNGraph(k=1)])
    dataset = toy(pre_transform=pre, transform=Double())
    scaler = ZScore()
    fit_parts(scaler, dataset, before=dataset.transform)
    predictor = Predictor.from_dataset(Sum(), dataset, scaler, task="regression")
    assert predictor.class_names == ("stable", "slip")
    raw = torch.arange(48.0).view(6, 4, 2)
    expected = apply_transform(scaler, apply_transform(Double(), dataset.data))
    torch.testing.assert_close(predictor.prepare(raw).x, expected.x)
    torch.testing.assert_close(predictor.prepare_samples(dataset.data).x, expected.x)
    assert predictor.prepare(raw).edge_index.equal(dataset.data.edge_index)
    (rest,) = predictor.preparation.pre_transform.transforms
    assert isinstance(rest, Double)


def test_a_shared_attribute_of_ones_own_is_kept():
    class Masked(Module):
        modalities = ("mask",)

        def forward(self, x, edge_index, mask):
            return (x * mask.view(-1, 1)).sum(dim=1)

    class Own(StaticDataset):
        layout = LAYOUT

        def read(self):
            mask = torch.tensor([1.0, 0.0, 0.0, 1.0])
            data = StaticData(x=readings(4, 4, 1), mask=mask, node=["mask"], shared=["mask"])
            data.y = torch.zeros(4, dtype=torch.long)
            return data, {}

    dataset = Own()
    predictor = Predictor.from_dataset(Masked(), dataset, task="regression")
    x = dataset.data.x
    torch.testing.assert_close(predictor(x), x[:, 0] + x[:, 3])
    assert "y" not in predictor.preparation.shared


def test_bad_input_is_named():
    predictor = Predictor(Sum(), LAYOUT, num_channels=1, num_joints=2)
    for size in ((4,), (3, 1), (2, 3, 1), (4, 2), (1, 1, 4, 1)):
        bad = readings(*size)
        shape = str(tuple(bad.shape)).replace("(", r"\(").replace(")", r"\)")
        with pytest.raises(ValueError, match=rf"'reading' must have shape \(4, 1\).*got {shape}"):
            predictor(bad)
    with pytest.raises(ValueError, match="'reading' must be an array of numbers"):
        predictor([["a"]])
    with pytest.raises(ValueError, match=r"'joint' must have shape \(2,\) or \(3, 2\).*got \(3,\)"):
        predictor(readings(3, 4, 1), readings(3))
    with pytest.raises(ValueError, match=r"'joint' must have shape .*got \(2, 2\)"):
        predictor(readings(3, 4, 1), readings(2, 2))
    with pytest.raises(ValueError, match=r"'task' must be one of .* \(got 'guess'\)"):
        Predictor(Sum(), LAYOUT, task="guess")
    with pytest.raises(ValueError, match="'joint' must be given"):
        Predictor(Sum(), FINGER, TaxelPose(FINGER, HAND))(readings(4, 1))

    class Needs(Sum):
        modalities = ("edge_attr",)

    with pytest.raises(ValueError, match=r"the model needs 'edge_attr' .*GeometricEdgeAttr"):
        Predictor(Needs(), LAYOUT)(readings(4, 1))
    with pytest.raises(ValueError, match=r"needs 'edge_index' \(got none\): give 'adjacency', or"):
        Predictor(TactileGCN(4, 2, channels={"tactile": 1}), LAYOUT)(readings(4, 1))


def test_model_and_data_without_edges(tmp_path):
    x = readings(20, 4, 1)
    dataset = StaticDataset.from_arrays(x, layout=replace(LAYOUT, adjacency={}))
    transform = ZScore().fit(dataset.data)
    model = TaxelNet(LAYOUT, 2, in_channels=1).eval()
    predictor = Predictor.from_dataset(model, dataset, transform)
    predictor.save(tmp_path / "a.predictor")
    expected = model(transform(dataset.data).x).softmax(-1)
    for found in (predictor, Predictor.load(tmp_path / "a.predictor")):
        assert found.preparation.shared.edge_index is None
        torch.testing.assert_close(found(x), expected)


def test_tare_comes_first(tmp_path):
    dataset = StaticDataset.from_arrays(readings(20, 4, 1), layout=LAYOUT)
    transform = ZScore(per="channel").fit(dataset.data)
    tared = Predictor.from_dataset(Sum(), dataset, transform, task="regression")
    raw = tared.with_tare()
    raw.save(tmp_path / "a.predictor")
    x, rest = readings(5, 4, 1), readings(20, 4, 1) + 500
    expected = tared(x)
    for predictor in (raw, Predictor.load(tmp_path / "a.predictor", Sum())):
        predictor.adapt(rest)
        mean = rest.double().mean(0).float()
        torch.testing.assert_close(predictor(x + mean), expected, rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match=r"'session' must be given.*Tare\('session'"):
        tared.with_tare()(x)
    with pytest.raises(ValueError, match=r"already measures the rest, by Tare\('session'"):
        raw.with_tare()


def test_tare_cannot_come_after_a_transform_of_frames():
    trial = torch.zeros(20, dtype=torch.long)
    data = StaticData(x=readings(20, 4, 1), trial=trial, step=torch.arange(20))
    transform = ZScore(per="channel").fit(data)
    frames = StaticDataset._from_samples((data, {}), LAYOUT, transform, None, None)
    predictor = Predictor.from_dataset(Sum(), Windows(frames, 4), task="regression")
    with pytest.raises(ValueError, match="the rest must be subtracted before all other transforms"):
        predictor.with_tare()


def test_repr():
    predictor = Predictor(Sum(), LAYOUT, class_names=NAMES)
    assert repr(predictor) == (
        f"Predictor(Sum, '{LAYOUT.name}', classes=['soft', 'hard'], task='multiclass')"
    )
