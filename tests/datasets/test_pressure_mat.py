import pytest
from datasets_server import served
from mat_files import mat_files, write_mat

from torch_geometric_tactile.data import Protocol, Trials
from torch_geometric_tactile.datasets import PressureMat
from torch_geometric_tactile.io._pressure_mat_zip import pressure_mat_hash


@pytest.fixture
def root(tmp_path, monkeypatch):
    path = write_mat(tmp_path / "pmd-1.0.0.zip")
    monkeypatch.setattr(PressureMat, "_sha256", {path.name: pressure_mat_hash(path)})
    return tmp_path


def test_experiment_i_by_hand(root):
    dataset = PressureMat(root)
    assert repr(dataset) == "PressureMat(18)"  # 3 persons, 3 postures, 2 of 5 frames
    assert dataset.class_names == ["1", "3", "13"]
    assert dataset.group_names == ["S1", "S2", "S10"]
    assert dataset.y.tolist() == 3 * [0, 0, 1, 1, 2, 2]
    assert dataset.group[::6].tolist() == [0, 1, 2]
    assert dataset[3].x[:4, 0].tolist() == [1, 3, 4, 0]
    assert dataset.step[:4].tolist() == dataset.time[:4].tolist() == [0, 1, 0, 1]
    assert dataset.trial_names[:2] == ["S1_1", "S1_3"]
    assert Trials(dataset)[0].x.shape == (2048, 2)


def test_sides(root):
    dataset = PressureMat(root, target="side")
    assert dataset.class_names == ["supine", "left", "right"]
    assert dataset.y[:6].tolist() == [0, 0, 1, 1, 2, 2]  # of postures 1, 3 and 13
    second = PressureMat(root, "ii", "side")
    assert second.y[:4].tolist() == [0, 0, 2, 1]  # B1, B10, C2, E3


def test_experiment_ii_leaves_out_what_is_not_described(root):
    dataset = PressureMat(root, experiment="ii")
    assert repr(dataset) == "PressureMat(24)"
    assert dataset.class_names == ["B1", "B10", "C2", "E3"]
    assert dataset.session_names == ["air", "sponge"]
    assert dataset.session[:8].tolist() == [0] * 4 + [1] * 4
    assert dataset.column("step") is None
    assert dataset[0].x.shape == (64 * 27, 1)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"experiment": "iii"}, r"'experiment' must be 'i' or 'ii' \(got 'iii'\)"),
        ({"target": "weight"}, r"'target' must be 'posture' or 'side' \(got 'weight'\)"),
    ],
)
def test_other_arguments(root, options, match):
    with pytest.raises(ValueError, match=match):
        PressureMat(root, **options)


def test_changed_files_are_refused(root):
    write_mat(root / "pmd-1.0.0.zip", mat_files() | {"experiment-i/S1/1.txt": b"1 " * 2048})
    with pytest.raises(ValueError, match=r"pmd-1\.0\.0\.zip' must have the SHA-256 checksum"):
        PressureMat(root)
    (root / "pmd-1.0.0.zip").write_bytes(b"PK")
    with pytest.raises(ValueError, match="cannot be read"):
        PressureMat(root)


def test_download_with_wrong_and_cut_files(root, monkeypatch):
    with served(monkeypatch, PressureMat) as server:
        data = (root / "pmd-1.0.0.zip").read_bytes()
        server.files = {"1.0.0/": b"<html>404</html>"}
        with pytest.raises(ValueError, match=r"pmd-1\.0\.0\.zip.* cannot be read"):
            PressureMat(root / "new")
        server.files = {"1.0.0/": data}
        server.broken = {"1.0.0/"}
        with pytest.raises(ConnectionError, match=r"pmd-1\.0\.0\.zip"):
            PressureMat(root / "new")
        server.broken = set()
        assert len(PressureMat(root / "new")) == 18
        assert [path.name for path in (root / "new" / "raw").iterdir()] == ["pmd-1.0.0.zip"]


@pytest.mark.full
def test_published_files(published_root):
    root = published_root("pressure_mat")
    dataset = PressureMat(root)
    assert len(dataset) == 19_361
    assert dataset.num_classes == 17
    assert len(Protocol("group", leave_one_out=True).split(dataset, fold=12).test) > 1000
    assert PressureMat(root, target="side").y.bincount().tolist() == [10_262, 4_583, 4_516]
    second = PressureMat(root, "ii", "side")
    assert second.y.bincount().tolist() == [270, 96, 96]
    assert second.session.bincount().tolist() == [230, 232]
