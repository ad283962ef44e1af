import hashlib
import os
import socket
import stat

import pytest
from datasets_server import served

from torch_geometric_tactile.datasets import BioTacSP


@pytest.fixture
def server(monkeypatch):
    with served(monkeypatch, BioTacSP) as server:
        yield server


@pytest.fixture
def published(server, write_bts3, tmp_path, monkeypatch):
    """Lets six small files be the published ones."""
    folder = write_bts3(tmp_path / "upstream")
    server.files = {path.name: path.read_bytes() for path in folder.iterdir()}
    hashes = {name: hashlib.sha256(server.files[name]).hexdigest() for name in BioTacSP._sha256}
    monkeypatch.setattr(BioTacSP, "_sha256", hashes)
    return server


def raw_files(root):
    return sorted(path.name for path in (root / "raw").iterdir())


def test_download_of_the_recordings(server, bts3_recordings, tmp_path):
    server.files = {path.name: path.read_bytes() for path in bts3_recordings.glob("*.csv")}
    assert len(BioTacSP(tmp_path, split=None)) == 5831
    assert sorted(server.asked) == raw_files(tmp_path)
    assert len(BioTacSP(tmp_path, split="test")) == 1149
    assert len(server.asked) == 6


def test_download_of_small_files(published, tmp_path):
    assert len(BioTacSP(tmp_path)) == 24
    assert raw_files(tmp_path) == sorted(published.files)
    for name, content in published.files.items():
        assert (tmp_path / "raw" / name).read_bytes() == content


@pytest.mark.skipif(os.name != "posix", reason="rights follow the umask on POSIX only")
def test_downloaded_files_have_the_rights_of_new_files(published, tmp_path):
    before = os.umask(0o022)
    try:
        BioTacSP(tmp_path / "set")
    finally:
        os.umask(before)
    for path in (tmp_path / "set" / "raw").iterdir():
        assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_download_fetches_only_what_is_missing(published, tmp_path):
    (tmp_path / "raw").mkdir()
    for name in ("bts3v2_palm_down.csv", "bts3v2_palm_45_test.csv"):
        (tmp_path / "raw" / name).write_bytes(published.files[name])
    BioTacSP(tmp_path)
    assert sorted(published.asked) == [
        "bts3v2_palm_45.csv",
        "bts3v2_palm_down_test.csv",
        "bts3v2_palm_side.csv",
        "bts3v2_palm_side_test.csv",
    ]


@pytest.mark.parametrize("content", [b"", b"<html>404</html>"])
def test_download_of_other_bytes(published, tmp_path, content):
    published.files["bts3v2_palm_down.csv"] = content
    with pytest.raises(ValueError, match=r"hash of downloaded file .*bts3v2_palm_down\.csv"):
        BioTacSP(tmp_path)
    assert raw_files(tmp_path) == []


def test_download_that_breaks_off_leaves_no_file_and_goes_on_later(published, tmp_path):
    published.broken = {"bts3v2_palm_down.csv"}
    with pytest.raises(
        ConnectionError, match=r"'bts3v2_palm_down\.csv' is not in .*put the file there by hand"
    ):
        BioTacSP(tmp_path)
    assert raw_files(tmp_path) == []
    published.broken = set()
    assert len(BioTacSP(tmp_path)) == 24


def test_download_not_found(published, tmp_path):
    del published.files["bts3v2_palm_side.csv"]
    with pytest.raises(ConnectionError, match=r"palm_side\.csv' is not in .*by hand \(404"):
        BioTacSP(tmp_path)
    assert raw_files(tmp_path) == ["bts3v2_palm_down.csv"]


def test_download_refused(tmp_path, monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(BioTacSP, "url", f"http://127.0.0.1:{port}")
    with pytest.raises(ConnectionError, match=r"raw' and could not .*put the file there by hand"):
        BioTacSP(tmp_path)
    assert raw_files(tmp_path) == []


def test_download_leaves_other_files_of_the_user_as_they_are(published, write_bts3, tmp_path):
    mine = write_bts3(tmp_path / "raw", rows=4) / "bts3v2_palm_side.csv"
    content = mine.read_bytes()
    (tmp_path / "raw" / "bts3v2_palm_45.csv").unlink()
    assert len(BioTacSP(tmp_path, palm="side", checksum=False)) == 4
    assert published.asked == ["bts3v2_palm_45.csv"]
    assert mine.read_bytes() == content


def test_files_put_by_hand_need_no_server(published, tmp_path, monkeypatch):
    monkeypatch.setattr(BioTacSP, "url", "http://nowhere.invalid")
    (tmp_path / "raw").mkdir()
    for name, content in published.files.items():
        (tmp_path / "raw" / name).write_bytes(content)
    assert len(BioTacSP(tmp_path)) == 24
    assert published.asked == []


def test_download_removes_what_a_killed_one_left(published, tmp_path):
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / ".bts3v2_palm_down.csv.0.tmp").write_bytes(b"half")
    BioTacSP(tmp_path)
    assert raw_files(tmp_path) == sorted(published.files)
