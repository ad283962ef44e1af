"""A folder of data from elsewhere runs nothing when it is opened."""

import inspect
from functools import partial

import pytest
import torch
from hostile_pickle import Touch
from torch_geometric.data import Dataset

from torch_geometric_tactile import datasets
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._processed_dataset import ProcessedDataset
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms import KNNGraph

LAYOUT = TaxelLayout("glove", [[0.0, 0.0], [0.01, 0.0], [0.02, 0.0]])
CLASSES = [getattr(datasets, name) for name in datasets.__all__]


@pytest.fixture
def hostile(tmp_path):
    """Puts files into a folder that would run something if they were unpickled; returns what
    they would make."""

    def put(root):
        mark = tmp_path / "mark"
        for folder in ("", "raw", "processed"):
            (root / folder).mkdir(parents=True, exist_ok=True)
            for name in ("pre_transform.pt", "pre_filter.pt", "data.pt"):
                torch.save(Touch(mark), root / folder / name)
        return mark

    return put


@pytest.mark.parametrize("kwargs", [{}, {"pre_transform": KNNGraph(2)}, {"force_reload": True}])
@pytest.mark.parametrize("own", [False, True])
def test_pickles_of_a_received_folder_are_not_run(toy, tmp_path, hostile, own, kwargs):
    make = toy if own else partial(RecordingFrames, layout=LAYOUT)
    for i in range(4 * (not own)):
        recording = Recording(time=[0.0, 0.1], tactile=[[[i], [1.0], [2.0]]] * 2)
        write_recording(recording, tmp_path / "data" / "raw" / f"cup{i % 2}_{i}.npz")
    make(tmp_path / "data")
    mark = hostile(tmp_path / "data")
    for _ in range(2):
        dataset = make(tmp_path / "data", **kwargs)
        assert dataset[0].x is not None
        assert dataset.copy(slice(0, 2)).num_classes > 0
    assert not mark.exists()
    for path in (tmp_path / "data" / "processed").glob("*.pt"):
        if path.name.startswith("pre_"):  # nor overwritten
            torch.load(path, weights_only=False)
            assert mark.exists()


def test_the_way_of_pyg_runs_them(tmp_path, hostile):
    class Plain(Dataset):
        processed_file_names = "data.pt"

        def process(self):
            pass

        def len(self):
            return 1

        def get(self, idx):
            return None

    mark = hostile(tmp_path / "data")
    Plain(str(tmp_path / "data"))
    assert mark.exists()


@pytest.mark.parametrize("cls", [cls for cls in CLASSES if inspect.isclass(cls)])
def test_no_data_set_processes_in_the_way_of_pyg(cls):
    ours = [base for base in cls.__mro__ if "_process" in vars(base) and base is not Dataset]
    assert ours[-1] is ProcessedDataset
    for base in ours:
        text = inspect.getsource(vars(base)["_process"])
        assert "pre_transform.pt" not in text
        assert base is not ProcessedDataset or "super()" not in text


def test_hostile_processed_file_is_not_run(toy, tmp_path):
    dataset = toy(tmp_path / "data")
    mark = tmp_path / "mark"
    for content in (Touch(mark), {"format": 3, "attributes": {"x": Touch(mark)}}):
        torch.save(content, dataset.processed_paths[0])
        with pytest.raises(ValueError, match=r"cannot be read; delete it.*plain data and tensors"):
            toy(tmp_path / "data")
    assert not mark.exists()
