"""Attributes are told by their names and declarations, never by sizes that happen to agree."""

import pytest
import torch

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.data._levels import KNOWN_ATTRIBUTES, Schema

NODES, EDGES = 4, 5
EDGE_INDEX = torch.tensor([[0, 1, 2, 3, 0], [1, 2, 3, 0, 2]])
RANKS = [
    (key, known.level, rank) for key, known in KNOWN_ATTRIBUTES.items() for rank in known.ranks
]
COUNTS = [1, NODES, EDGES]  # samples: also as many as taxels, as edges


def samples(num_samples=3, **kwargs):
    return StaticData(x=torch.zeros(num_samples, NODES, 2), edge_index=EDGE_INDEX, **kwargs)


@pytest.mark.parametrize("num_samples", COUNTS)
@pytest.mark.parametrize(("key", "level", "rank"), RANKS)
def test_known_attributes_are_shared_by_their_dimensions(key, level, rank, num_samples):
    if key in ("x", "edge_index", "adj", "adj_t"):
        return
    size = (NODES if level == "node" else EDGES, 3, 3)[:rank]
    data = samples(num_samples, **{key: torch.zeros(size)})
    assert data.level(key) == level
    assert data.is_shared(key)
    assert data.sample(0)[key].shape == size
    assert data.index_select(slice(0, 1))[key].shape == size
    if rank == KNOWN_ATTRIBUTES[key].ranks[-1]:
        data[key] = torch.zeros(num_samples, *size)
        assert not data.is_shared(key)
        assert data.sample(0)[key].shape == size
        assert data.index_select(slice(0, 1))[key].shape == (1, *size)


@pytest.mark.parametrize("num_samples", COUNTS)
@pytest.mark.parametrize("key", [k for k, known in KNOWN_ATTRIBUTES.items() if not known.ranks])
def test_known_attributes_of_the_samples_have_a_row_for_each(key, num_samples):
    data = samples(num_samples, **{key: torch.arange(num_samples)})
    assert data.level(key) == "sample"
    assert data.sample(num_samples - 1)[key].tolist() == [num_samples - 1]
    with pytest.raises(ValueError, match=rf"'{key}' must have {num_samples} rows, one for each"):
        data[key] = torch.arange(num_samples + 1)


def test_labels_of_another_number_are_refused():
    match = (
        r"'y' must have 5 rows, one for each sample \(got shape \(6,\)\); "
        "name it in 'shared' if it is one value for all"
    )
    with pytest.raises(ValueError, match=match):
        samples(5, y=torch.zeros(6))
    data = samples(5)
    for assign in (setattr, StaticData.__setitem__):
        with pytest.raises(ValueError, match=match):
            assign(data, "y", torch.zeros(6))
    assert "y" not in data
    shared = samples(5, y=torch.zeros(6), shared=["y"])
    assert shared.sample(1).y.shape == (6,)


@pytest.mark.parametrize("num_samples", COUNTS)
def test_flat_edge_attr_is_shared(num_samples):
    data = samples(num_samples, edge_attr=torch.arange(5.0))
    assert data.sample(0).edge_attr.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("num_samples", COUNTS)
def test_edge_weight_in_a_column_is_refused_or_declared(num_samples):
    weight = torch.ones(EDGES, 1)
    with pytest.raises(ValueError, match=r"'edge_weight' must have .* name it in 'edge'"):
        samples(num_samples, edge_weight=weight)
    declared = {"edge": ["edge_weight"], "shared": ["edge_weight"]}
    data = samples(num_samples, edge_weight=weight, **declared)
    assert data.sample(0).edge_weight is weight
    late = StaticData(x=torch.zeros(num_samples, NODES, 2))
    if num_samples == EDGES:  # could be one edge for each of five samples, until there are edges
        late.edge_weight = weight
        with pytest.raises(ValueError, match="'edge_weight' must have 5 edges"):
            late.edge_index = EDGE_INDEX


@pytest.mark.parametrize("key", ["surface", "object_index", "weight", "interface", "gain"])
@pytest.mark.parametrize("num_samples", COUNTS)
def test_parts_of_a_name_and_equal_sizes_mean_nothing(key, num_samples):
    value = torch.arange(4)
    if num_samples == 4:
        assert samples(4, **{key: value}).sample(1)[key].tolist() == [1]
        assert not samples(4, **{key: value}).is_shared(key)
    else:
        with pytest.raises(ValueError, match=rf"'{key}' must have {num_samples} rows.*'shared'"):
            samples(num_samples, **{key: value})
    data = samples(num_samples, **{key: value}, shared=[key])
    assert data.sample(0)[key] is value
    assert data.level(key) == "sample"
    data = samples(num_samples, **{key: value}, node=[key], shared=[key])
    assert data.sample(0)[key] is value
    assert data.level(key) == "node"


@pytest.mark.parametrize("num_samples", COUNTS)
@pytest.mark.parametrize(("level", "size"), [("node", NODES), ("edge", EDGES)])
def test_own_attributes_by_declaration(level, size, num_samples):
    own = torch.rand(num_samples, size, 2)
    data = samples(num_samples, own=own, **{level: ["own"]})
    assert data.level("own") == level
    assert not data.is_shared("own")
    assert torch.equal(data.sample(0).own, own[0])
    once = samples(num_samples, own=own[0], **{level: ["own"], "shared": ["own"]})
    assert once.is_shared("own")
    assert once.sample(0).own.shape == (size, 2)
    with pytest.raises(ValueError, match=rf"'own' must have {size} .* in its dimension 1"):
        samples(num_samples, own=own[:, 1:], **{level: ["own"]})
    with pytest.raises(ValueError, match=rf"'own' must have {size} .* in its dimension 0"):
        samples(num_samples, own=own[0, 1:], **{level: ["own"], "shared": ["own"]})
    with pytest.raises(ValueError, match=rf"'own' must have {num_samples + 1} rows, one"):
        samples(num_samples + 1, own=own, **{level: ["own"]})
    with pytest.raises(ValueError, match="'own' must have a dimension for each sample and each"):
        samples(num_samples, own=own[:, 0, 0], **{level: ["own"]})


def test_declaration_takes_precedence_over_a_known_name():
    data = samples(3, y=torch.zeros(3, NODES), node=["y"])
    assert data.sample(0).y.shape == (NODES,)
    data = samples(3, edge_attr=torch.zeros(3, EDGES), edge=["edge_attr"])
    assert data.sample(0).edge_attr.shape == (EDGES,)
    data = samples(3, joint=torch.zeros(1, 16), shared=["joint"])
    assert data.sample(2).joint.shape == (1, 16)


@pytest.mark.parametrize("order", [1, -1])
def test_order_of_attributes_does_not_matter(order):
    own = {
        "edge_weight": torch.zeros(2, EDGES),
        "y": torch.zeros(2),
        "x": torch.zeros(2, NODES, 1),
        "edge_index": EDGE_INDEX,
        "mask": torch.zeros(2, NODES),
        "joint": torch.zeros(2, 7),
    }
    data = StaticData(**dict(list(own.items())[::order]), node=["mask"])
    step_by_step = StaticData(node=["mask"])
    for key in list(own)[::order]:
        step_by_step[key] = own[key]
    for key, value in own.items():
        assert data[key] is step_by_step[key] is value
    wrong = {**own, "joint": torch.zeros(3, 7)}
    with pytest.raises(ValueError, match=r"'joint' must have 2 rows|must have 3 (rows|samples)"):
        StaticData(**dict(list(wrong.items())[::order]), node=["mask"])


def test_readings_of_another_number_of_samples():
    data = samples(3, y=torch.arange(3))
    match = r"'x' must have 3 samples, as 'y' has \(got shape \(2, 4, 2\)\); use 'index_select'"
    with pytest.raises(ValueError, match=match):
        data.x = data.x[:2]
    assert data.x.shape == (3, NODES, 2)
    alone = samples(3)
    alone.x = alone.x[:2]
    assert alone.num_samples == 2
    data.x = None  # PyG's way to delete an attribute
    data.y = None
    data.x = torch.zeros(2, NODES, 2)
    assert data.num_samples == 2


def test_replaced_edges_may_be_followed_by_their_attributes():
    data = samples(2, edge_attr=torch.zeros(EDGES, 2))
    data.edge_index = EDGE_INDEX[:, :3]
    with pytest.raises(ValueError, match="'edge_attr' must have 3 edges in its dimension 0"):
        data.validate()
    with pytest.warns(UserWarning, match="'edge_attr' must have 3 edges"):
        assert not data.validate(raise_on_error=False)
    with pytest.raises(ValueError, match="'edge_attr' must have 3 edges"):
        data.edge_attr = torch.zeros(4, 2)
    data.edge_attr = torch.zeros(3, 2)
    assert data.validate()
    data.edge_index = EDGE_INDEX[:, :3] + 2
    with pytest.raises(ValueError, match="larger indices than the number of nodes"):
        data.validate()


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"edge_index": torch.zeros(7, 2)}, r"'edge_index' must have shape \(2, num_edges\)"),
        ({"pos": torch.zeros(3)}, r"'pos' must have 2 dimensions if all samples share it, or 3"),
        ({"edge_attr": torch.zeros(3, 5, 1, 1)}, "'edge_attr' must have 1 or 2 dimensions if all"),
        ({"pos": torch.zeros(3, 3)}, "'pos' must have 4 taxels in its dimension 0"),
        (
            {"pos": torch.zeros(2, 4, 3)},
            r"'pos' must have 3 rows.*\(2, 4, 3\)\); if all samples share",
        ),
        ({"dropped": torch.zeros(5)}, "'dropped' must have 4 taxels in its dimension 0"),
        ({"edge_attr": torch.zeros(4, 2)}, "'edge_attr' must have 5 edges in its dimension 0"),
        ({"rate": torch.tensor(50.0)}, r"'rate' must have 3 rows.*got shape \(\)\); name it in"),
        ({"bias": torch.zeros(4)}, "'bias' must have 3 rows.*'node' or 'edge' if.*'shared' if"),
        ({"y": [0, 1, 2]}, r"'y' must be a tensor \(got list\)"),
        ({"name": ["a", "b", "c"]}, r"'name' must be a tensor .* in 'shared' \(got list\)"),
        ({"batch": torch.zeros(12)}, r"StaticData has no 'batch': call 'to_batch\(\)'"),
        ({"node": "mask"}, r"'node' must be a list of names \(got 'mask'\)"),
        ({"shared": [1]}, r"'shared' must be a list of names \(got \[1\]\)"),
        ({"node": ["a"], "edge": ["a"]}, r"'a' must be named in 'node' or in 'edge' \(got both\)"),
        ({"shared": ["x"]}, r"'shared' must not name attributes of a fixed level \(got 'x'\)"),
    ],
)
def test_bad_attributes(attributes, message):
    given = {"edge_index": EDGE_INDEX} | attributes
    with pytest.raises(ValueError, match=message):
        StaticData(x=torch.zeros(3, NODES, 2), **given)


def test_rows_that_contradict_each_other_without_readings():
    with pytest.raises(ValueError, match="'joint' must have 2 rows, one for each sample"):
        StaticData(y=torch.zeros(2), joint=torch.zeros(3, 16))
    with pytest.raises(ValueError, match=r"'rate' must have a row for each sample"):
        StaticData(rate=torch.tensor(1.0))
    with pytest.raises(ValueError, match="'normal' must have 3 taxels"):
        StaticData(pos=torch.zeros(3, 3), normal=torch.zeros(4, 3))
    with pytest.raises(ValueError, match="'pos' must have 5 taxels"):
        StaticData(num_nodes=5).pos = torch.zeros(4, 3)


def test_values_that_are_no_tensors_are_shared():
    data = samples(2, note="dry", rate=50.0, unit={"x": "counts"}, names=["a"], shared=["names"])
    for key in ("note", "rate", "unit", "names"):
        assert data.is_shared(key)
        assert data.sample(1)[key] == data[key]


def test_declare_replaces_and_checks():
    data = samples(NODES, own=torch.zeros(NODES, NODES))
    assert data.declare(node=["own"]) is data
    assert data.level("own") == "node"
    assert not data.is_shared("own")
    data.declare(node=["own"], shared=["own"])
    assert data.is_shared("own")
    data.declare(shared=["own"])
    assert data.level("own") == "sample"
    assert data.schema == {"node": [], "edge": [], "shared": ["own"]}
    with pytest.raises(ValueError, match="'own' must have 5 edges in its dimension 1"):
        data.declare(edge=["own"])
    assert data.level("own") == "sample"
    data.declare(node=["later"])
    data.later = torch.zeros(NODES, NODES, 3)
    assert data.level("later") == "node"


def test_schema_is_made_of_constructor_arguments():
    declared = {"node": ["b", "a"], "edge": ["c"], "shared": ["a"]}
    data = samples(2, **declared)
    assert data.schema == {"node": ["a", "b"], "edge": ["c"], "shared": ["a"]}
    assert StaticData(**data.schema).schema == data.schema
    assert Schema.from_names(**declared).to_dict() == data.schema
    assert data.level("b") == "node"  # though it is not set
