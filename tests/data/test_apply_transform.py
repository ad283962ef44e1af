from unittest.mock import ANY

import pytest
import torch
import torch_geometric.transforms as T
from torch import Tensor
from torch_geometric.data import Data, HeteroData
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._static_rule import StaticRule
from torch_geometric_tactile.data._transform_rules import RULES, flat, own_declaration
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import (
    CommonMode,
    KNNGraph,
    ZScore,
)
from torch_geometric_tactile.transforms._static_transform import static_transform

LAYOUT = grid(2, 3, pitch=0.01)
EDGES = LAYOUT.edge_index("original")[:, 1:]  # not symmetric


def samples(num_samples=4, own_pos=False, seed=0, **attributes):
    draw = torch.Generator().manual_seed(seed)
    pos = LAYOUT.pos + 0.001 * torch.rand(6, 3, generator=draw)
    if own_pos:
        pos = pos + 0.003 * torch.rand(num_samples, 6, 3, generator=draw)
    data = StaticData(
        x=torch.randn(num_samples, 6, 2, generator=draw),
        edge_index=EDGES,
        y=torch.arange(num_samples),
        pos=pos,
        joint=torch.rand(num_samples, 5, generator=draw),
    )
    for key, value in attributes.items():
        data[key] = value
    return data


def rotation():
    return T.LinearTransformation(torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]))


# Each that is in the list, in the forms that take other ways.
TRANSFORMS = [
    T.AddRandomWalkPE(3),
    T.AddRandomWalkPE(3, attr_name=None),
    T.AddRemainingSelfLoops(),
    T.AddRemainingSelfLoops("edge_attr"),
    T.AddSelfLoops(),
    T.AddSelfLoops("edge_attr", fill_value="mean"),
    T.Cartesian(),
    T.Cartesian(norm=False, cat=False),
    T.Center(),
    T.Constant(),
    T.Constant(cat=False),
    T.Distance(),
    T.Distance(norm=False, cat=False),
    T.GCNNorm(),
    T.LocalCartesian(),
    T.LocalDegreeProfile(),
    T.NormalizeRotation(),
    T.NormalizeScale(),
    T.OneHotDegree(8),
    T.OneHotDegree(8, cat=False),
    T.RemoveDuplicatedEdges(),
    T.Spherical(),
    T.Spherical(norm=False),
    T.TargetIndegree(),
    T.ToUndirected(),
    T.ToUndirected(reduce="mean"),
    T.TwoHop(),
    rotation(),
    *([T.RemoveSelfLoops("edge_attr")] if hasattr(T, "RemoveSelfLoops") else []),
]
LIST_ONLY = {T.AddLaplacianEigenvectorPE, T.PointPairFeatures, T.Polar}  # tested below


class Counted(BaseTransform):
    """Counts the calls of a transform, with what is known of it."""

    def __init__(self, transform):
        self.transform = transform
        self.static_rule = RULES[type(transform)](transform)
        self.calls = 0

    def forward(self, data):
        self.calls += 1
        return self.transform(data)


def assert_as_one_by_one(transform, data):
    found = apply_transform(transform, data)
    assert found.num_samples == data.num_samples
    for i in range(data.num_samples):
        expected, one = transform(data.sample(i)).to_dict(), found.sample(i).to_dict()
        assert expected.keys() == one.keys()
        for key, value in expected.items():
            if isinstance(value, Tensor):
                assert value.dtype == one[key].dtype, key
                assert torch.equal(value, one[key]), key
            else:
                assert value == one[key], key


def test_list_is_tested():
    assert {type(transform) for transform in TRANSFORMS} | LIST_ONLY == set(RULES)


@pytest.mark.parametrize("num_samples", [1, 4])
@pytest.mark.parametrize("edge_attr", [None, torch.rand(13, 2), torch.rand(13)])
@pytest.mark.parametrize("transform", TRANSFORMS, ids=str)
def test_once_as_one_by_one(transform, edge_attr, num_samples):
    extra = {}
    if edge_attr is not None:
        extra = {"edge_attr" if edge_attr.dim() == 2 else "edge_weight": edge_attr}
    data = samples(num_samples, **extra)
    counted = Counted(transform)
    assert_as_one_by_one(transform, data)
    apply_transform(counted, data)
    assert counted.calls == 1


@pytest.mark.parametrize("transform", TRANSFORMS, ids=str)
def test_own_positions_as_one_by_one(transform):
    data = samples(own_pos=True)
    counted = Counted(transform)
    assert_as_one_by_one(transform, data)
    apply_transform(counted, data)
    assert counted.calls == (4 if "pos" in counted.static_rule.reads else 1)


@pytest.mark.parametrize("transform", TRANSFORMS, ids=str)
def test_own_edge_features_as_one_by_one(transform):
    assert_as_one_by_one(transform, samples(edge_attr=torch.rand(4, 13, 2)))


def test_distance_differs_between_samples():
    found = apply_transform(T.Distance(norm=False), samples(own_pos=True))
    assert found.edge_attr.shape == (4, 13, 1)
    assert not torch.equal(found.edge_attr[0], found.edge_attr[1])


@pytest.mark.parametrize("transform", TRANSFORMS, ids=str)
def test_no_sample_gets_the_edges_of_others(transform):
    some, none = samples(2), samples(2).index_select(torch.tensor([], dtype=torch.long))
    expected, found = apply_transform(transform, some), apply_transform(transform, none)
    assert found.num_samples == 0
    for key, value in expected.to_dict().items():
        if expected.is_shared(key):
            assert torch.equal(found[key], value), key
        else:
            assert found[key].shape[1:] == value.shape[1:], key


def test_point_pair_features_once():
    assert_as_one_by_one(T.PointPairFeatures(), samples(norm=LAYOUT.normal))


def test_polar_once():
    data = samples()
    flat = StaticData(**{**data.to_dict(), "pos": LAYOUT.pos[:, :2].contiguous()})
    assert_as_one_by_one(T.Polar(norm=False), flat)


def test_edges_on_which_sizes_agree():
    # Two taxels, two edges, two samples, two joints: nothing follows from a size.
    data = StaticData(
        x=torch.rand(2, 2, 2),
        edge_index=torch.tensor([[0, 1], [1, 1]]),
        pos=torch.rand(2, 3),
        y=torch.tensor([0, 1]),
    )
    for transform in (T.ToUndirected(), T.AddSelfLoops(), T.Distance(), T.Constant()):
        assert_as_one_by_one(transform, data)


def test_laplacian_signs_are_drawn_for_each_sample():
    torch.manual_seed(0)
    found = apply_transform(T.AddLaplacianEigenvectorPE(2, attr_name=None), samples(16))
    pe = found.x[:, :, 2:]
    assert found.x.shape == (16, 6, 4)
    assert len({tuple(sign.tolist()) for sign in pe[:, 0].sign()}) > 1


def test_random_transform_stays_one_by_one():
    torch.manual_seed(0)
    data = samples()
    found = apply_transform(T.RandomJitter(0.001), data)
    torch.manual_seed(0)
    expected = [T.RandomJitter(0.001)(sample).pos for sample in data.to_data_list()]
    assert found.pos.equal(torch.stack(expected))
    draws = T.NormalizeRotation(max_points=3)
    assert RULES[T.NormalizeRotation](draws).reads is None


def test_subclass_is_not_taken_for_its_parent():
    class ByReading(T.Distance):
        def forward(self, data):
            data = super().forward(data)
            data.edge_attr = data.edge_attr * data.x.sum()
            return data

    assert_as_one_by_one(ByReading(), samples())


class OneOf(T.Compose):
    def forward(self, data):
        return self.transforms[int(data.y) % len(self.transforms)](data)


def test_subclass_of_compose_runs_its_forward():
    transform = OneOf([CommonMode(), RandomNothing()])
    assert flat(T.Compose([transform, T.Center()])) == [transform, ANY]
    assert_as_one_by_one(T.Compose([T.Center(), transform]), samples())


class RandomNothing(BaseTransform):
    supports_static = True

    def forward(self, data):
        return data


class ByItsOwnMean(ZScore):
    def forward(self, data):
        data = super().forward(data)
        data.x = data.x - data.x.mean()  # of all samples, if it were given them at once
        return data


class Called(RandomNothing):
    def __call__(self, data):
        data = super().__call__(data)
        data.x = data.x - data.x.mean()
        return data


def test_subclass_that_overrides_forward_gets_one_sample():
    data = samples()
    for transform in (ByItsOwnMean().fit(data), Called()):
        assert own_declaration(transform, "supports_static") is None
        assert_as_one_by_one(transform, data)


def test_subclass_that_declares_it_again_gets_all_samples():
    class Again(ByItsOwnMean):
        supports_static = True

        def forward(self, data):
            assert data.x.dim() == 3
            return data

    class Inherits(Again):
        pass

    class OneByOne(Again):
        supports_static = False

    apply_transform(Inherits(), samples())
    assert own_declaration(OneByOne(), "supports_static") is False


def test_static_rule_of_a_parent_is_not_that_of_its_subclass():
    class Height(BaseTransform):
        static_rule = StaticRule(reads=("pos",), node=("height",))

        def forward(self, data):
            data.height = data.pos[:, 2:]
            return data

    class ByReading(Height):
        def forward(self, data):
            data = super().forward(data)
            data.pos = data.pos * data.x.sum()
            del data["height"]
            return data

    assert_as_one_by_one(ByReading(), samples())


def test_compose_mixes_both():
    transform = T.Compose([KNNGraph(k=2), T.ToUndirected(), T.Distance(), rotation()])
    assert_as_one_by_one(transform, samples())


def test_caller_is_unedited():
    data = samples()
    before = {key: value.clone() for key, value in data.to_dict().items()}
    apply_transform(T.Compose([T.AddSelfLoops("edge_attr"), T.Constant(), T.Center()]), data)
    assert data.to_dict().keys() == before.keys()
    assert all(torch.equal(value, before[key]) for key, value in data.to_dict().items())


def stretch(data):
    data.pos *= 1000
    return data


class Stretch(BaseTransform):
    supports_static = True

    def forward(self, data):
        return stretch(data)


WRITING = [
    stretch,
    Stretch(),
    static_transform(stretch, reads=["pos"]),
    T.Compose([T.Distance(), stretch]),
]


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
@pytest.mark.parametrize("transform", WRITING, ids=["function", "static", "declared", "Compose"])
def test_write_into_what_samples_share_is_refused(transform, mode):
    data, own = samples(), samples(own_pos=True)
    expected = 1000 * own.pos
    with mode():
        with pytest.raises(
            ValueError, match=r"must not change the stored tensor of 'pos' .* by .*[Ss]tretch"
        ):
            apply_transform(transform, data)
        out = apply_transform(transform, own)  # whose samples do not share it
    torch.testing.assert_close(out.pos, expected)


def test_write_into_a_batch_of_readings_is_harmless():
    def clear(data):
        data.x[0] = 0
        return data

    assert apply_transform(clear, samples()).x[:, 0].abs().sum() == 0


@pytest.mark.parametrize(
    ("returned", "found"), [(None, "None"), ((1, 2), "tuple"), (HeteroData(), "HeteroData")]
)
@pytest.mark.parametrize("reads", [None, ["pos"]])
def test_transform_that_returns_no_sample(returned, found, reads):
    def transform(data):
        return returned

    if reads:
        transform = static_transform(transform, reads=reads)
    with pytest.raises(
        TypeError, match=rf"must return the sample as a Data object \(got {found} fr"
    ):
        apply_transform(transform, samples())


def add_height(data):
    data.height = data.pos[:, 2:]
    data.length = (data.pos[data.edge_index[0]] - data.pos[data.edge_index[1]]).norm(dim=1)
    data.unit = "m"
    return data


def declared():
    reads = ["pos", "edge_index"]
    return static_transform(add_height, reads=reads, node=["height"], edge=["length"])


def test_declared_transform_runs_once():
    found = apply_transform(declared(), samples())
    assert found.height.shape == (6, 1)
    assert found.length.shape == (13,)
    assert found.is_shared("height")
    assert found.is_shared("length")
    assert found.index_select(torch.tensor([1])).sample(0).height.equal(found.height)


def test_declared_transform_class():
    class Height(BaseTransform):
        static_rule = StaticRule(reads=("pos",), node=("height",))
        calls = 0

        def forward(self, data: Data) -> Data:
            type(self).calls += 1
            data.height = data.pos[:, 2:]
            return data

    assert_as_one_by_one(Height(), samples(2))
    Height.calls = 0
    apply_transform(Height(), samples(2))
    assert Height.calls == 1


def test_undeclared_change_of_a_reading_is_made_one_by_one():
    def scale(data):
        data.x = data.x * data.x.max()
        return data

    assert_as_one_by_one(static_transform(scale), samples())


def test_static_transform_repr_and_wrong_names():
    assert repr(declared()) == "StaticTransform(add_height)"
    assert repr(static_transform(T.Center())) == "StaticTransform(Center())"
    with pytest.raises(ValueError, match=r"'node' must be a list of names \(got 'height'\)"):
        static_transform(add_height, node="height")


def test_thousands_of_samples_are_one_call():
    counted = Counted(T.Distance())
    assert apply_transform(counted, samples(4000)).edge_attr.shape == (13, 1)
    assert counted.calls == 1
