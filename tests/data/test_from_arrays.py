import copy
import pickle

import numpy as np
import pytest
import torch
from torch.utils.data import random_split
from torch_geometric.data import Data
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import AddLaplacianEigenvectorPE, Distance

from torch_geometric_tactile.data import Recording, StaticDataset, splits
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, biotac_sp, grid
from torch_geometric_tactile.transforms import KNNGraph, ZScore

LAYOUT = grid(2, 3, pitch=0.01)
EDGES = LAYOUT.edge_index("original")


def arrays(num_samples=5, **kwargs):
    x = np.arange(num_samples * 12, dtype=float).reshape(num_samples, 6, 2)
    return StaticDataset.from_arrays(x, **{"layout": LAYOUT} | kwargs)


def test_one_line():
    dataset = arrays(y=[0, 1, 0, 1, 2], trial=[0, 0, 1, 1, 1], joint=np.zeros((5, 4)))
    assert repr(dataset) == "StaticDataset(5)"
    assert dataset.num_classes == 3
    assert dataset.layout is LAYOUT
    data = dataset[1]
    assert type(data) is Data
    assert data.x.tolist() == [[12, 13], [14, 15], [16, 17], [18, 19], [20, 21], [22, 23]]
    shapes = {key: tuple(value.shape) for key, value in data.to_dict().items()}
    assert shapes == {
        "x": (6, 2),
        "edge_index": (2, 14),
        "y": (1,),
        "pos": (6, 3),
        "normal": (6, 3),
        "trial": (1,),
        "joint": (1, 4),
    }
    assert data.validate()


def test_types():
    time = np.array([1e9, 1e9 + 0.001, 1e9 + 0.002, 0, 0])
    ones = np.ones(5)
    dataset = arrays(y=ones > 0, joint=ones, time=time, trial=ones.astype(np.int32), force=ones)
    kinds = {key: dataset[0][key].dtype for key in ("x", "y", "joint", "time", "trial", "force")}
    assert kinds == {
        "x": torch.float,
        "y": torch.long,
        "joint": torch.float,
        "time": torch.double,
        "trial": torch.long,
        "force": torch.float,
    }
    assert dataset.time.diff()[0] == pytest.approx(0.001, rel=1e-3)
    assert arrays(y=torch.rand(5, 2)).y.dtype == torch.float
    counts = np.arange(60, dtype=np.uint16).reshape(5, 6, 2)
    assert StaticDataset.from_arrays(counts, layout=LAYOUT).x.dtype == torch.float


@pytest.mark.parametrize("kind", [np.asarray, torch.as_tensor, list])
def test_kinds_of_arrays(kind):
    x = torch.rand(5, 6, 2)
    dataset = StaticDataset.from_arrays(kind(x), kind(torch.arange(5)), layout=LAYOUT)
    assert torch.equal(dataset.x, x)
    assert dataset.y.tolist() == [0, 1, 2, 3, 4]


def test_array_of_floats_is_not_copied_and_not_edited():
    x = np.ones((5, 6, 2), dtype=np.float32)
    dataset = StaticDataset.from_arrays(x, layout=LAYOUT, transform=ZScore().fit(arrays()))
    assert dataset.x.data_ptr() == x.ctypes.data
    dataset.batch([0, 1])
    assert x.sum() == 60


def test_read_only_and_swapped_arrays():
    x = np.ones((5, 6, 2), dtype=">f8")
    x.flags.writeable = False
    assert StaticDataset.from_arrays(x, layout=LAYOUT).x.sum() == 60


def test_one_channel():
    dataset = StaticDataset.from_arrays(torch.rand(5, 6), layout=LAYOUT)
    assert dataset.x.shape == (5, 6, 1)


def test_missing_readings_stay():
    x = torch.zeros(5, 6, 2)
    x[3, 1] = torch.nan
    assert StaticDataset.from_arrays(x, layout=LAYOUT).x.isnan().sum() == 2


def test_names_are_numbered():
    groups = ["cup", "box", "cup", "can", "box"]
    dataset = arrays(y=np.array(["slip", "stable"])[[0, 1, 1, 0, 1]], group=groups, session=groups)
    assert dataset.class_names == ["slip", "stable"]
    assert dataset.y.tolist() == [0, 1, 1, 0, 1]
    assert dataset.group_names == dataset.session_names == ["box", "can", "cup"]
    assert dataset.group.tolist() == [2, 0, 2, 1, 0]
    given = arrays(group=groups, group_names=["cup", "can", "box", "jar"])
    assert given.group.tolist() == [0, 2, 0, 1, 2]
    assert given.group_names == ["cup", "can", "box", "jar"]
    assert arrays(y=[0, 1, 1, 0, 1], class_names=["no", "yes"]).class_names == ["no", "yes"]


def test_names_of_trials_and_further_attributes_are_numbered():
    dataset = arrays(trial=["p2_t1", "p1_t1", "p1_t2", "p1_t1", "P1_T2 "], person=list("baaaa"))
    assert dataset.trial_names == ["p1_t1", "p1_t2", "p2_t1"]
    assert dataset.trial.tolist() == [2, 0, 1, 0, 1]
    assert dataset.person.tolist() == [1, 0, 0, 0, 0]


def test_names_of_trials_stay_with_their_samples_in_each_session():
    dataset = arrays(trial=["b", "b", "a", "a", "b"], session=[0, 1, 1, 1, 0])
    assert [dataset.trial_names[i] for i in dataset.trial] == ["b", "b", "a", "a", "b"]
    assert len(dataset.trial.unique()) == 3


@pytest.mark.parametrize("missing", [None, float("nan"), np.datetime64("NaT")])
@pytest.mark.parametrize("key", ["y", "group", "trial", "session"])
def test_missing_label(key, missing):
    values = np.array(["slip", "hold", missing, "slip", missing], dtype=object)
    match = rf"'{key}' must have a value .* sample 2, and 2 of 5 are missing\): fill them in"
    with pytest.raises(ValueError, match=match):
        arrays(**{key: values})
    with pytest.raises(ValueError, match=match):
        arrays(**{key: [1, 0, np.nan, 1, np.nan]})


def test_missing_label_in_a_list_is_no_class_nan():
    with pytest.raises(ValueError, match=r"got nan in sample 1, and 1 of 5 are missing"):
        arrays(y=["slip", np.nan, "hold", "slip", "hold"])


def test_labels_of_pandas():
    pandas = pytest.importorskip("pandas")
    names = ["slip", "hold", "slip", "slip", "hold"]
    for values in (pandas.Categorical(names), pandas.array(names, dtype="string")):
        assert arrays(y=values).class_names == ["hold", "slip"]
    assert arrays(y=pandas.array([1, 0, 1, 1, 0], dtype="Int64")).y.tolist() == [1, 0, 1, 1, 0]
    for dtype, value in (("string", "a"), ("Int64", 1), ("category", "a")):
        with pytest.raises(ValueError, match="in sample 1, and 1 of 5 are missing"):
            arrays(y=pandas.Series([value, pandas.NA, value, value, value], dtype=dtype))


@pytest.mark.parametrize("dtype", [torch.half, torch.bfloat16, torch.double])
def test_numbers_become_single_precision(dtype):
    x = torch.arange(60).view(5, 6, 2).to(dtype)
    dataset = StaticDataset.from_arrays(x, layout=LAYOUT, joint=torch.ones(5, 3, dtype=dtype))
    assert {dataset[0][key].dtype for key in ("x", "joint")} == {torch.float}
    recording = Recording(time=np.arange(5.0), tactile=x, joint=torch.ones(5, 3, dtype=dtype))
    assert recording.tactile.dtype == recording.joint.dtype == np.float32
    assert recording.tactile.ravel().tolist() == list(range(60))


def test_layout_by_name_and_file(tmp_path):
    x = torch.zeros(2, 24, 3)
    assert StaticDataset.from_arrays(x, layout="biotac_sp").layout.matches(biotac_sp())
    LAYOUT.save(tmp_path / "glove.json")
    assert arrays(layout=tmp_path / "glove.json").layout.matches(LAYOUT)
    assert arrays(layout=str(tmp_path / "glove.json")).layout.matches(LAYOUT)
    with pytest.raises(ValueError, match=r"must be one of .*biotac_sp.* \(got 'glove'\)"):
        arrays(layout="glove")


def test_edges():
    assert arrays()[0].edge_index.equal(EDGES)
    assert arrays(adjacency="dense")[0].edge_index.equal(LAYOUT.edge_index("dense"))
    assert arrays(edge_index=[[0, 1], [1, 2]])[0].edge_index.tolist() == [[0, 1], [1, 2]]
    knn = arrays(pre_transform=KNNGraph(k=2))
    assert knn[0].edge_index.equal(KNNGraph(k=2)(arrays()[0]).edge_index)
    assert StaticDataset.from_arrays(torch.zeros(1, 24, 3), layout="biotac_sp")[0].num_edges == 0
    only = TaxelLayout(name="only", pos=LAYOUT.pos, adjacency={"touching": EDGES[:, :3]})
    assert arrays(layout=only)[0].num_edges == 3


def test_positions_of_several_links_are_left_out():
    dataset = StaticDataset.from_arrays(torch.zeros(2, 384, 3), layout=allegro_uskin())
    assert "pos" not in dataset[0]
    pos = torch.rand(5, 6, 3)
    two = TaxelLayout(name="two", pos=LAYOUT.pos, link=[0, 0, 0, 1, 1, 1], link_names=("a", "b"))
    assert "pos" not in arrays(layout=two)[0]
    one = TaxelLayout(name="one", pos=LAYOUT.pos, link=[0] * 6)
    assert arrays(layout=one)[0].pos.equal(LAYOUT.pos)
    own = arrays(pos=pos)
    assert own[3].pos.equal(pos[3])
    assert "normal" not in own[3]


def test_attributes_of_ones_own():
    dataset = arrays(
        mask=torch.rand(5, 6) > 0.5,
        weight=torch.rand(14),
        gain=torch.tensor([2.0, 3.0]),
        force=torch.rand(5, 3),
        node=["mask"],
        edge=["weight"],
        shared=["weight", "gain"],
    )
    assert {key: tuple(dataset[2][key].shape) for key in ("mask", "weight", "gain", "force")} == {
        "mask": (6,),
        "weight": (14,),
        "gain": (2,),
        "force": (1, 3),
    }
    assert dataset[[4, 0]].force.shape == (2, 3)
    assert dataset[[4, 0]].weight.shape == (14,)


WRONG = [
    (
        {"layout": biotac_sp()},
        r"'x' must have shape \(num_samples, 24, num_channels\), since layout",
    ),
    ({"y": [0, 1]}, r"'y' must have 5 rows, one for each sample of 'x' \(got shape \(2,\)\)"),
    ({"joint": torch.zeros(3, 5)}, r"'joint' must have 5 rows, .* \(got shape \(3, 5\)\)"),
    ({"force": torch.zeros(3)}, r"'force' must have 5 rows, .*name it in 'node' or 'edge'"),
    ({"y": [[0], [1, 2], [1], [1], [1]]}, r"'y' must hold numbers, the same number in each row"),
    ({"y": np.array([["a"]] * 5)}, r"'y' must have one name for each sample \(got shape \(5, 1\)"),
    ({"group": list("aabbc"), "group_names": ["a", "b"]}, r"'group_names' must name every 'group'"),
    ({"edge_index": torch.zeros(3, 2).long()}, r"'edge_index' must have shape \(2, num_edges\)"),
    ({"edge_index": [[0], [6]]}, r"'edge_index' must join taxels 0 to 5 \(got 0 to 6\)"),
    ({"edge_index": EDGES, "adjacency": "dense"}, r"only one of 'edge_index' and 'adjacency'"),
    ({"adjacency": "none"}, r"must be an adjacency of layout 'grid_2x3'"),
    ({"edge_attr": torch.zeros(13, 2)}, r"'edge_attr' must have 14 edges"),
]


@pytest.mark.parametrize(("arguments", "match"), WRONG)
def test_wrong_arrays(arguments, match):
    with pytest.raises(ValueError, match=match):
        arrays(**arguments)


@pytest.mark.parametrize("x", [torch.zeros(5, 12), torch.zeros(6), torch.zeros(5, 2, 6), 3.0])
def test_wrong_readings(x):
    with pytest.raises(ValueError, match=r"'x' must have shape \(num_samples, 6, num_channels\)"):
        StaticDataset.from_arrays(x, layout=LAYOUT)


def test_infinite_readings():
    x = torch.zeros(5, 6, 2)
    x[3, 2, 1] = torch.inf
    with pytest.raises(ValueError, match=r"\(got infinity in sample 3, taxel 2, channel 1\)"):
        StaticDataset.from_arrays(x, layout=LAYOUT)


def test_works_with_everything_else():
    draw = torch.Generator().manual_seed(0)
    x, y = torch.randn(40, 6, 2, generator=draw), torch.arange(40) % 2
    trial = torch.arange(40) // 4
    dataset = StaticDataset.from_arrays(x, y, layout=LAYOUT, trial=trial, group=trial // 2)
    split = splits.by_trial(dataset, seed=1)
    assert not set(dataset[split.train].trial.tolist()) & set(dataset[split.test].trial.tolist())
    assert next(iter(DataLoader(dataset, 4))).num_graphs == 4
    first, _ = random_split(dataset, [30, 10])
    assert next(iter(StaticLoader(first, 4))).x.shape == (4, 6, 2)
    loaded = pickle.loads(pickle.dumps(dataset[3:7]))
    assert loaded.x.equal(dataset.x[3:7])
    assert copy.deepcopy(dataset).y.equal(y)


def test_pre_filter_and_transform():
    dataset = arrays(y=[0, 1, 0, 1, 2], pre_filter=lambda data: int(data.y) == 1)
    assert dataset.x[:, 0, 0].tolist() == [12, 36]
    assert arrays(transform=Distance())[0].edge_attr.shape == (14, 1)


def listed(**kwargs):
    data_list = [
        Data(x=torch.full((6, 2), float(i)), edge_index=EDGES, y=torch.tensor([i % 2]))
        for i in range(4)
    ]
    for i, data in enumerate(data_list):
        for key, value in kwargs.items():
            data[key] = value(i)
    return data_list


def test_from_data_list():
    names = {"class_names": ["no", "yes"], "session_names": ["monday"]}
    dataset = StaticDataset.from_data_list(listed(), layout=LAYOUT, **names)
    assert repr(dataset) == "StaticDataset(4)"
    assert dataset.x[:, 0, 0].tolist() == [0, 1, 2, 3]
    assert dataset[2].edge_index.equal(EDGES)
    assert (dataset.class_names, dataset.session_names) == (["no", "yes"], ["monday"])
    assert dataset.group_names == []


def test_from_data_list_of_a_dataset_and_back():
    dataset = arrays(y=[0, 1, 0, 1, 2], transform=Distance(norm=False))
    again = StaticDataset.from_data_list(dataset, layout=LAYOUT)
    for one, other in zip(dataset, again, strict=True):
        assert one.to_dict().keys() == other.to_dict().keys()
        assert all(torch.equal(value, other[key]) for key, value in one.to_dict().items())


def test_from_data_list_without_a_layout():
    dataset = StaticDataset.from_data_list(listed(pos=lambda i: LAYOUT.pos))
    assert dataset.layout.matches(LAYOUT)
    with pytest.raises(ValueError, match=r"'layout' must be given, .* 'pos' .* \(got none\)"):
        StaticDataset.from_data_list(listed())
    with pytest.raises(ValueError, match=r"'layout' must be given, .* \(got shape \(4, 6, 3\)\)"):
        StaticDataset.from_data_list(listed(pos=lambda i: LAYOUT.pos + i))


def test_from_data_list_attributes_of_ones_own():
    data_list = listed(mask=lambda i: torch.arange(6) == i, gain=lambda i: torch.tensor([2.0, 3.0]))
    dataset = StaticDataset.from_data_list(data_list, layout=LAYOUT, node=["mask"], shared=["gain"])
    assert dataset.mask.shape == (4, 6)
    assert dataset[3].mask.tolist() == [False, False, False, True, False, False]
    assert dataset[3].gain.tolist() == [2.0, 3.0]


def test_from_data_list_wrong_samples():
    with pytest.raises(ValueError, match="must hold at least one sample"):
        StaticDataset.from_data_list([], layout=LAYOUT)
    with pytest.raises(ValueError, match=r"24 taxels, as in layout 'biotac_sp' \(got 6\)"):
        StaticDataset.from_data_list(listed(), layout="biotac_sp")
    edges = listed()
    edges[2].edge_index = EDGES[:, 1:]
    with pytest.raises(ValueError, match="sample 2 must have the same 'edge_index' as sample 0"):
        StaticDataset.from_data_list(edges, layout=LAYOUT)


def test_random_encodings_are_the_samples_own():
    torch.manual_seed(0)
    dataset = arrays(16, transform=AddLaplacianEigenvectorPE(2))
    pe = dataset.batch(range(16)).laplacian_eigenvector_pe
    assert pe.shape == (16, 6, 2)
    assert dataset[0].laplacian_eigenvector_pe.shape == (6, 2)


class Named(StaticDataset):
    @property
    def class_names(self):
        return ["a", "b"]


def test_from_arrays_of_a_subclass():
    dataset = Named.from_arrays(torch.zeros(2, 6, 1), layout=LAYOUT)
    assert type(dataset) is Named
    assert dataset.class_names == ["a", "b"]
