import copy
import pickle
from functools import partial

import numpy as np
import pytest
import torch
from torch_geometric.data import Data, InMemoryDataset
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import Compose, Distance, ToUndirected

from torch_geometric_tactile.data import Recording, StaticData, StaticDataset, Windows
from torch_geometric_tactile.datasets import FakeTactileDataset, RecordingFrames
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import KNNGraph


@pytest.fixture(params=["memory", "file"])
def build(request, toy, tmp_path):
    """Builds the toy data set, in memory or by way of a file."""
    return partial(toy, tmp_path / "toy" if request.param == "file" else None)


def add_one(data):
    data = copy.copy(data)
    data.x = data.x + 1
    return data


def test_dataset_repr_len_and_names(build):
    dataset = build()
    assert repr(dataset) == "ToyDataset(6)"
    assert len(dataset) == dataset.len() == 6
    assert dataset.class_names == ["stable", "slip"]
    assert dataset.group_names == ["cup", "box"]
    assert dataset.session_names == []
    assert (dataset.num_classes, dataset.num_features, dataset.num_node_features) == (2, 2, 2)


def test_dataset_item_is_plain_data(build):
    data = build()[1]
    assert type(data) is Data
    assert data.x.tolist() == [[8.0, 9.0], [10.0, 11.0], [12.0, 13.0], [14.0, 15.0]]
    assert {key: list(data[key].shape) for key in data.keys()} == {  # noqa: SIM118
        "x": [4, 2],
        "edge_index": [2, 8],
        "y": [1],
        "pos": [4, 3],
        "trial": [1],
        "group": [1],
    }
    assert data.validate()


def test_dataset_in_pygs_loader(build):
    batch = next(iter(DataLoader(build(), batch_size=3)))
    assert batch.num_graphs == 3
    assert batch.x.shape == (12, 2)
    assert batch.batch.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert batch.edge_index.shape == (2, 24)
    assert batch.edge_index[:, 8:16].sub(4).equal(batch.edge_index[:, :8])
    assert batch.y.tolist() == [0, 1, 0]


def test_dataset_transform_at_every_access(build):
    dataset = build(transform=add_one)
    assert dataset[0].x[0].tolist() == dataset[0].x[0].tolist() == [1.0, 2.0]
    assert dataset.data.x[0, 0].tolist() == [0.0, 1.0]
    assert dataset.batch([0]).x[0, 0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("pre_transform", "edges"),
    [(ToUndirected(), 8), (KNNGraph(k=3), 12), (Compose([KNNGraph(k=3), Distance()]), 12)],
)
def test_dataset_pre_transform(build, pre_transform, edges):
    dataset = build(pre_transform=pre_transform)
    assert dataset[5].edge_index.shape == (2, edges)
    assert dataset[5].x.equal(build(force_reload=True)[5].x)


def test_dataset_pre_filter(build):
    dataset = build(pre_filter=lambda data: int(data.y) == 1)
    assert len(dataset) == 3
    assert dataset.data.trial.tolist() == [0, 1, 2]
    assert dataset[0].x[0].tolist() == [8.0, 9.0]


def test_dataset_pre_filter_that_keeps_none(build):
    with pytest.raises(ValueError, match=r"'pre_filter' must keep at least one sample"):
        build(pre_filter=lambda data: False)


def test_dataset_of_another_layout(toy):
    class Wrong(toy):
        def read(self):
            data, names = super().read()
            self.layout = grid(1, 3, pitch=0.01)
            return data, names

    with pytest.raises(ValueError, match=r"must have 3 taxels, as in layout 'grid_1x3' \(got 4\)"):
        Wrong()


def test_dataset_summary(build):
    summary = build().get_summary()
    assert (summary.num_graphs, summary.num_nodes.mean, summary.num_edges.mean) == (6, 4, 8)


def test_dataset_is_not_edited_by_its_users(build):
    dataset = build()
    before = dataset.data.x.clone()
    data = dataset[0]
    data.x = data.x - 5
    data.edge_index = data.edge_index[:, :1]
    batch = dataset.batch([0, 1])
    batch.x -= 5
    assert dataset.data.x.equal(before)
    assert dataset[0].edge_index.shape == (2, 8)


def test_dataset_without_read():
    class Empty(StaticDataset):
        layout = grid(1, 1, pitch=0.01)

    with pytest.raises(NotImplementedError, match="'Empty' must define 'read', which returns Sta"):
        Empty()


def samples_to_read(count=4):
    edges = torch.tensor([[0, 1], [1, 0]])
    return [
        Data(x=torch.full((2, 3), float(i)), edge_index=edges, pos=torch.eye(2, 3), y=i % 2)
        for i in range(count)
    ]


READS = {
    "static": lambda: StaticData.from_data_list(samples_to_read()),
    "list": samples_to_read,
    "tuple of samples": lambda: tuple(samples_to_read()),
    "pair of samples": lambda: tuple(samples_to_read(2)),
    "list and names": lambda: (samples_to_read(), {"class": ("left", "right")}),
    "static and names": lambda: (StaticData.from_data_list(samples_to_read()), {"class": ["a"]}),
}


@pytest.mark.parametrize("in_memory", [True, False], ids=["memory", "folder"])
@pytest.mark.parametrize("name", READS)
def test_read_returns_static_data_or_a_list_with_or_without_names(name, in_memory, tmp_path):
    class MyGrasps2D(StaticDataset):
        def read(self):
            return READS[name]()

    dataset = MyGrasps2D(None if in_memory else tmp_path)
    assert len(dataset) == (2 if name == "pair of samples" else 4)
    assert dataset[1].x.equal(torch.ones(2, 3))
    assert dataset.layout.pos.equal(torch.eye(2, 3))
    names = {"list and names": ["left", "right"], "static and names": ["a"]}
    assert dataset.class_names == names.get(name, [])
    if not in_memory:
        assert [path.name for path in (tmp_path / "processed").glob("my*")] == ["my_grasps2_d.pt"]
        again = MyGrasps2D(tmp_path)
        assert again.class_names == dataset.class_names
        assert again.layout.matches(dataset.layout)


def test_raw_files_are_those_of_the_folder_by_default(tmp_path):
    class Grasps(StaticDataset):
        def read(self):
            assert [path.rpartition("/")[2] for path in self.raw_paths] == ["a.txt", "b.txt"]
            return samples_to_read()

    (tmp_path / "raw" / "folder").mkdir(parents=True)
    for name in ("b.txt", "a.txt", ".hidden"):
        (tmp_path / "raw" / name).write_text(name)
    assert len(Grasps(tmp_path)) == 4


@pytest.mark.parametrize("result", [None, (1, 2), torch.zeros(3), {"x": 1}], ids=str)
def test_read_that_returns_something_else(result):
    class Grasps(StaticDataset):
        def read(self):
            return result

    with pytest.raises(TypeError, match="must "):
        Grasps()


@pytest.mark.parametrize("cut", [slice(None), slice(2, 5), [3, 1]])
def test_dataset_pickles(cut):
    dataset = FakeTactileDataset(num_samples=8, transform=KNNGraph(k=2))[cut]
    dataset.batch([0])  # fills the cache of the selection
    loaded = pickle.loads(pickle.dumps(dataset))
    assert repr(loaded) == repr(dataset)
    assert loaded.data.x.equal(dataset.data.x)
    assert loaded.batch([1]).edge_index.equal(dataset.batch([1]).edge_index)
    assert loaded.layout.matches(dataset.layout)


def test_dataset_attributes_are_those_of_the_selection(build):
    dataset = build()
    assert dataset.y.tolist() == [0, 1, 0, 1, 0, 1]
    assert dataset[[5, 0]].y.tolist() == [1, 0]
    assert dataset[[5, 0]].pos.shape == (4, 3)
    assert dataset[[5, 0]].edge_index.shape == (2, 8)
    with pytest.raises(AttributeError, match="'ToyDataset' object has no attribute 'z'"):
        dataset.z
    assert not hasattr(dataset, "joint")


@pytest.mark.parametrize(
    ("idx", "trial"),
    [
        (None, [0, 1, 2]),
        (slice(1, None), [1, 2]),
        ([2, 0], [2, 0]),
        (torch.tensor([True, False, True]), [0, 2]),
    ],
)
def test_dataset_copy(build, idx, trial):
    part = build()[[1, 3, 5]]
    copied = part.copy(idx)
    assert type(copied) is type(part)
    assert copied.trial.tolist() == trial
    assert len(copied) == copied.len() == len(trial)  # without the samples left out
    copied.data.x.zero_()
    copied.data.pos.zero_()
    copied.data.edge_index.zero_()
    assert part.data.x.min() > 0
    assert part.data.pos.max() > 0
    assert part.data.edge_index.max() > 0
    assert copied.class_names == ["stable", "slip"]


def test_dataset_to_a_device(build):
    dataset = build(transform=KNNGraph(k=2))
    part = dataset[2:]
    assert part.to("meta") is part
    assert part.x.device.type == part.pos.device.type == part.edge_index.device.type == "meta"
    assert part.x.shape == (4, 4, 2)
    assert part.len() == 4
    assert dataset.cpu().x.device.type == "cpu"  # its own samples stay
    assert dataset[0].x.device.type == "cpu"
    assert dataset.trial.tolist() == [0, 0, 1, 1, 2, 2]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_dataset_on_a_gpu(build):
    dataset = build(transform=Distance()).cuda()
    assert dataset[[3, 1]].batch([0]).edge_attr.is_cuda
    assert dataset.cpu()[0].x.device.type == "cpu"


def stretch(data):
    data.pos *= 1000
    return data


def shift(data):
    data.x -= 1
    return data


@pytest.mark.parametrize(("transform", "name"), [(stretch, "pos"), (shift, "x")])
def test_dataset_transform_that_writes_into_what_is_stored(build, transform, name):
    dataset = build(transform=transform)
    with pytest.raises(ValueError, match=f"must not change the stored tensor of '{name}' in place"):
        dataset[0]


def test_windows_transform_that_writes_into_what_is_stored():
    trial = torch.arange(6) // 3
    frames = StaticDataset.from_arrays(
        torch.ones(6, 4, 1), trial=trial, layout=grid(2, 2, 0.01), transform=shift
    )
    windows = Windows(frames, 2, transform=shift)
    for _ in range(2):  # readings of a window are its own
        assert windows[0].x.unique().tolist() == [-1]
    for transforms in ((None, stretch), (stretch, None)):
        frames.transform, last = transforms
        with pytest.raises(ValueError, match="must not change the stored tensor of 'pos' in place"):
            Windows(frames, 2, transform=last)[0]


def test_layout_and_arguments_stay_as_they_are():
    layout, gain = grid(2, 2, pitch=0.01), torch.ones(2)
    before = copy.deepcopy(layout)
    dataset = StaticDataset.from_arrays(
        torch.rand(3, 4, 1), layout=layout, gain=gain, shared=["gain"]
    )
    for name in ("pos", "normal", "edge_index", "gain"):
        dataset._data[name].zero_()
    recordings = [Recording(time=[0.0, 1.0], tactile=torch.rand(2, 4, 1), meta={"object": "a"})]
    frames = RecordingFrames(layout=layout, recordings=recordings, adjacency="original")
    for name in ("pos", "normal", "edge_index"):
        frames._data[name].zero_()
    assert gain.tolist() == [1, 1]
    assert layout.pos.equal(before.pos)
    assert layout.normal.equal(before.normal)
    assert layout.edge_index("original").equal(before.edge_index("original"))


def test_dataset_transform_that_returns_nothing(build):
    dataset = build(transform=lambda data: None)
    with pytest.raises(TypeError, match=r"must return the sample as a Data object \(got None from"):
        dataset[0]


INDICES = [
    (torch.tensor([[0, 1], [5, 2]]), [0, 1, 5, 2]),
    (torch.tensor([[True, False, True], [False, False, True]]), [0, 2, 5]),
    (np.array([[3], [1]], dtype=np.int16), [3, 1]),
    ((2, 0), [2, 0]),
    ([True, False, True, False, False, False], [0, 2]),
    (range(1, 3), [1, 2]),
    ([], []),
]


@pytest.mark.parametrize(("index", "expected"), INDICES)
def test_dataset_index_of_any_shape(build, index, expected):
    dataset = build()
    for data in (dataset[index].data, dataset.data[index], dataset.batch(index)):
        assert data.trial.tolist() == dataset.trial[expected].tolist()
        assert data.x.shape == (len(expected), 4, 2)


@pytest.mark.parametrize(
    "index", [(slice(2), 0), "trial", [0.5], torch.rand(3), None, [[0], [1, 2]]]
)
def test_dataset_index_that_is_none(build, index):
    dataset = build()
    with pytest.raises(IndexError, match=r"'index' must (be a slice, integers or a mask|hold int)"):
        dataset[index]
    with pytest.raises(IndexError, match="'index' must"):
        dataset.batch(index)


def test_dataset_number_of_classes_is_that_of_all_samples():
    x, layout = torch.zeros(6, 4, 1), grid(2, 2, pitch=0.01)
    dataset = StaticDataset.from_arrays(x, [0, 1, 2, 0, 1, 2], layout=layout)
    assert dataset[:2].num_classes == dataset[:0].num_classes == 3
    assert dataset[:2].copy().num_classes == 2  # it stores no others
    trial = torch.arange(6) // 2
    frames = StaticDataset.from_arrays(x, trial, trial=trial, layout=layout)
    assert Windows(frames, 2)[:1].num_classes == 3
    assert StaticDataset.from_arrays(x, layout=layout).num_classes == 0


@pytest.mark.parametrize("declared", [{"node": ["y"]}, {"node": ["y"], "shared": ["y"]}])
@pytest.mark.parametrize(
    ("labels", "expected"),
    [
        ([[0, 1, 1, 0], [1, 0, 0, 0]], 2),
        ([[0, 3, 1, 0], [1, 0, 0, 0]], 4),
        ([[0.0, 1.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0]], 2),
        ([[[0], [1], [4], [0]], [[1], [0], [0], [0]]], 5),
        ([4 * [[1, 0, 0]], 4 * [[0, 1, 0]]], 3),  # one column a class
    ],
)
def test_number_of_classes_of_labels_of_each_taxel_is_that_of_pyg(labels, expected, declared):
    y = torch.tensor(labels)
    y = y[0] if "shared" in declared else y
    data = StaticData(x=torch.zeros(2, 4, 1), edge_index=torch.zeros(2, 0).long(), y=y, **declared)

    class Labelled(StaticDataset):
        layout = grid(2, 2, pitch=0.01)

        def read(self):
            return data, {}

    class OfPyG(InMemoryDataset):
        def __init__(self):
            super().__init__()
            self.data, self.slices = self.collate(data.to_data_list())

    assert Labelled().num_classes == OfPyG().num_classes == expected
    assert Labelled()[:1].num_classes == expected
