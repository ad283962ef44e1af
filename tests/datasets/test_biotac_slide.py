import pytest
from published_files import slide

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import BioTacSlide


def make(folder):
    for material in (1, 2, 10):
        for trial in (1, 2, 10):
            path = folder / f"mat{material}" / f"mat{material}_{trial}_bio.csv"
            slide(path, frames=3 + (trial == 10), base=100 * material + trial)
            path.with_name(f"mat{material}_{trial}_jp.csv").write_text("of the robot")
            path.with_name(f"mat{material}_{trial}.pt").write_bytes(b"\x80a pickle")
    (folder / "compiled_data").mkdir()
    return folder


@pytest.mark.parametrize("inner", [".", "raw", "raw_data", "BioTac_slide_20_50/raw_data"])
def test_slides_by_hand(tmp_path, inner):
    make(tmp_path / inner)
    dataset = BioTacSlide(tmp_path)
    assert repr(dataset) == "BioTacSlide(30)"
    assert dataset.class_names == ["mat1", "mat2", "mat10"]
    assert dataset.trial_names[:4] == ["mat1_1", "mat1_2", "mat1_10", "mat2_1"]
    assert dataset.y.bincount().tolist() == [10, 10, 10]
    assert dataset.trial[:10].tolist() == [0] * 3 + [1] * 3 + [2] * 4
    assert dataset.time[3:7].tolist() == pytest.approx([0, 0.01, 0.02, 0], abs=1e-6)
    assert dataset.x.shape == (30, 19, 1)
    assert dataset.x[5, :, 0].tolist() == [*range(2, 21)]
    assert dataset.pac.shape == (30, 22)
    assert dataset.pac[29].tolist() == [*range(1010, 1032)]
    assert [int(dataset[9][key]) for key in ("pdc", "tac", "tdc")] == [91, 103, 3]
    assert dataset[0].edge_index is None
    assert dataset[0].pos.shape == (19, 3)


def test_slides_are_held_out_and_there_are_no_groups_nor_parts(tmp_path):
    dataset = BioTacSlide(make(tmp_path))
    split = Protocol("trial", folds=3, stratify="y").split(dataset)
    assert set(dataset.y[split.test].tolist()) == {0, 1, 2}
    assert not {*dataset.trial[split.test].tolist()} & {*dataset.trial[split.train].tolist()}
    for protocol in (Protocol("group"), Protocol("given")):
        with pytest.raises(ValueError, match=r"'by' must be a unit|'dataset' must have a 'part'"):
            protocol.split(dataset)


def test_slide_twice_or_in_another_folder(tmp_path):
    make(tmp_path)
    slide(tmp_path / "mat1" / "mat1_01_bio.csv")
    with pytest.raises(ValueError, match=r"slide 1 over mat1 must be in only one file \(got '.*'"):
        BioTacSlide(tmp_path)
    (tmp_path / "mat1" / "mat1_01_bio.csv").rename(tmp_path / "mat2" / "mat1_3_bio.csv")
    with pytest.raises(ValueError, match=r"mat1_3_bio.csv' must be in the folder 'mat1' \(got 'ma"):
        BioTacSlide(tmp_path)


def test_a_damaged_file_is_named_and_nothing_is_kept(tmp_path):
    path = make(tmp_path) / "mat2" / "mat2_10_bio.csv"
    path.write_text(path.read_text()[:-1])
    with pytest.raises(ValueError, match=r"mat2_10_bio.csv', line 5 must end with a line break"):
        BioTacSlide(tmp_path)
    assert not list((tmp_path / "processed").glob("*.pt"))
