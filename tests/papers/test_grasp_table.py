import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import BioTacSP, default_root
from torch_geometric_tactile.papers._grasp_table import grasp_table


def test_data_is_generated_where_there_is_no_network(monkeypatch, caplog):
    monkeypatch.setattr(BioTacSP, "url", "http://127.0.0.1:9")  # nobody listens there
    data = grasp_table().data
    assert data.kind == "generated"
    assert data.caption.startswith("Data: GENERATED")
    assert len(data.caption) < 90  # one line of the report
    assert "could not be downloaded" in caplog.text
    assert len(data.load()) == 2000


def test_data_is_found_loose_in_a_folder_which_is_left_as_it_was(bts3_recordings, tmp_path):
    before = sorted(path.name for path in bts3_recordings.iterdir())
    for folder in (bts3_recordings, bts3_recordings.parent):
        data = grasp_table(folder).data
        assert data.kind == "measured"
        assert len(data.load()) == 4682
        train, test = data.with_arguments({"split": "all"}).parts(Protocol("given"), 0, 0)
        assert (len(train), len(test)) == (4682, 1149)
    assert sorted(path.name for path in bts3_recordings.iterdir()) == before
    assert data.arguments["root"] == str(default_root("BioTacSP"))


def test_data_is_found_in_the_root_of_the_data_set(bts3_root):
    assert grasp_table(bts3_root).data.arguments["root"] == str(bts3_root)


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"'--root' must be a folder \(got '.*nowhere'\)"):
        grasp_table(tmp_path / "nowhere")


def test_damaged_data_is_an_error_and_not_replaced_by_generated(write_bts3, tmp_path):
    write_bts3(tmp_path / "set" / "raw")
    with pytest.raises(ValueError, match="must have the SHA-256 checksum"):
        grasp_table(tmp_path / "set")
