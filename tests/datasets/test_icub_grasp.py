import pytest
import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import ICubGrasp
from torch_geometric_tactile.sensors import icub_hand

OBJECTS = ("full_coke", "bear", "none")


def write(folder, name, number, frames=2, pressed=10):
    """Taxel 0 reads 240 less what it is pressed by, and the number of the frame; others 240."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["-10000"]
    for t in range(frames):
        rows = [[240] * 12 for _ in range(5)]
        rows[0][0] -= pressed + t
        lines.append(" ".join(str(10 * i + number) for i in range(9)))
        lines.append(" ".join(str(255 - min(row)) for row in rows))
        lines += [" ".join(map(str, row)) for row in rows]
    (folder / f"{name}_{number}.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture
def root(tmp_path):
    """Three objects with three trials of 2, 3 and 4 frames."""
    for name in OBJECTS:
        for number in (1, 2, 10):
            write(tmp_path / "raw", name, number, {1: 2, 2: 3, 10: 4}[number])
    (tmp_path / "raw" / "README.txt").write_text("not a trial")
    return tmp_path


def test_small_files_by_hand(root):
    dataset = ICubGrasp(root)
    assert repr(dataset) == "ICubGrasp(18)"
    assert dataset.class_names == dataset.group_names == ["bear", "none"]
    assert dataset.num_classes == 2
    assert dataset.y.tolist() == dataset.group.tolist() == [0] * 9 + [1] * 9
    assert dataset.trial.tolist() == [0] * 2 + [1] * 3 + [2] * 4 + [6] * 2 + [7] * 3 + [8] * 4
    assert [dataset.trial_names[i] for i in (0, 1, 2, 6)] == [
        "bear_1",
        "bear_2",
        "bear_10",
        "none_1",
    ]
    assert dataset.step.tolist() == [0, 1, 0, 1, 2, 0, 1, 2, 3] * 2
    assert dataset.x.shape == (18, 60, 1)
    assert dataset.x[:, 0, 0].tolist() == [230.0 - t for t in dataset.step.tolist()]
    assert (dataset.x[:, 1:] == 240).all()
    assert torch.rad2deg(dataset.joint[2]).tolist() == pytest.approx(range(2, 92, 10), rel=1e-5)


def test_unreliable_object_is_the_last_class(root):
    dataset = ICubGrasp(root, unreliable=True)
    assert len(dataset) == 27
    assert dataset.class_names == ["bear", "none", "full_coke"]
    assert dataset.num_classes == 3
    without = ICubGrasp(root)
    kept = dataset.y < 2
    assert without.x.equal(dataset.x[kept])
    assert without.y.equal(dataset.y[kept])
    assert [path.name for path in (root / "processed").iterdir()] == ["icub_grasp.pt"]


def test_contact_grows_with_pressure(root):
    dataset, raw = ICubGrasp(root, contact=True), ICubGrasp(root)
    assert dataset.x.equal(255 - raw.x)
    assert dataset.x[0, :2, 0].tolist() == [25.0, 15.0]


def test_sample_is_plain_data(root):
    sample = ICubGrasp(root)[3]
    assert type(sample) is Data
    assert sample.x.shape == (60, 1)
    assert sample.joint.shape == (1, 9)
    assert sample.edge_index.equal(icub_hand().edge_index("original"))
    assert "pos" not in sample  # each finger has a frame of its own


@pytest.mark.parametrize("inner", ["raw", "iCubGraspDataset", "."])
def test_folders_of_the_files(tmp_path, inner):
    write(tmp_path / inner, "bear", 1)
    assert len(ICubGrasp(tmp_path)) == 2


def test_changed_file_is_processed_again(root, caplog):
    ICubGrasp(root)
    write(root / "raw", "bear", 1, frames=5)
    assert len(ICubGrasp(root)) == 21
    assert "'bear_1.txt' was changed" in caplog.text


def test_unreliable_trials_only(tmp_path):
    write(tmp_path, "full_coke", 1)
    with pytest.raises(
        ValueError, match=r"must hold trials of objects other .* choose unreliable=True"
    ):
        ICubGrasp(tmp_path)
    assert ICubGrasp(tmp_path, unreliable=True).class_names == ["full_coke"]


def test_one_trial_in_two_files(root):
    (root / "raw" / "bear_01.txt").write_bytes((root / "raw" / "bear_1.txt").read_bytes())
    with pytest.raises(
        ValueError, match=r"trial 1 of 'bear' must be in only one file \(got .*bear_01"
    ):
        ICubGrasp(root)


def test_damaged_file_is_named(root):
    path = root / "raw" / "none_2.txt"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match=r"none_2\.txt', line 22 must end with a line break"):
        ICubGrasp(root)


def test_published_files(icub_root):
    dataset = ICubGrasp(icub_root)
    assert (len(dataset), dataset.num_classes) == (2520, 10)
    assert "full_coke" not in dataset.class_names
    assert len(dataset.trial.unique()) == 203
    every = ICubGrasp(icub_root, unreliable=True)
    assert (len(every), every.num_classes, every.class_names[-1]) == (2883, 11, "full_coke")
    assert every.y.bincount().min() > 0
    assert every.joint.isfinite().all()


def test_first_frame_of_a_published_trial_tells_the_object(icub_root):
    from sklearn.ensemble import RandomForestClassifier

    dataset = ICubGrasp(icub_root)
    parts = Protocol("trial", folds=5, stratify="y").split(dataset)
    train, test = (part[dataset.step[part] == 0] for part in (parts.train, parts.test))
    forest = RandomForestClassifier(50, random_state=0)
    forest.fit(dataset.joint[train].numpy(), dataset.y[train].numpy())
    assert forest.score(dataset.joint[test].numpy(), dataset.y[test].numpy()) > 0.9
