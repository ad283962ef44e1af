import logging
import os

import pytest
import torch
from allegro_files import everything, write

from torch_geometric_tactile.datasets import AllegroUSkin, recording_frames
from torch_geometric_tactile.sensors import allegro_uskin, grid


@pytest.fixture
def root(tmp_path):
    """Two objects with two trials of two frames."""
    for i, name in enumerate(("sponge_0", "sponge_1", "purse_0", "purse_1")):
        write(tmp_path / "raw" / f"{name}.npz", value=10.0 * i)
    return tmp_path


def test_second_time_reads_no_raw_file(root, monkeypatch):
    first = everything(root)
    monkeypatch.setattr(recording_frames, "read_recording", None)
    assert everything(root).data.x.equal(first.data.x)
    for arguments in ({"task": "property"}, {"split": "test"}, {"adjacency": "dense"}):
        AllegroUSkin(root, **arguments)
    with pytest.raises(TypeError):
        everything(root, force_reload=True)


@pytest.mark.parametrize(
    ("change", "message", "size"),
    [
        (lambda raw: write(raw / "purse_2.npz"), "'purse_2.npz' was added", 10),
        (lambda raw: (raw / "sponge_1.npz").unlink(), "'sponge_1.npz' was removed", 6),
        (lambda raw: write(raw / "sponge_1.npz", frames=5), "'sponge_1.npz' was changed", 11),
        (
            lambda raw: [write(raw / f"cup_{i}.npz") for i in range(5)],
            "'cup_0.npz' was added, 'cup_1.npz' was added, 'cup_2.npz' was added and 2 more",
            18,
        ),
    ],
)
def test_changed_files_are_processed_again(root, caplog, change, message, size):
    first = everything(root)
    change(root / "raw")
    with caplog.at_level(logging.WARNING):
        assert len(everything(root)) == size
    assert "again" in caplog.text
    assert message in caplog.text
    caplog.clear()
    assert len(everything(root)) == size
    assert not caplog.text
    assert first.data.x.shape == (8, 384, 3)


def test_file_of_the_same_size_and_time_is_known_by_its_content(root, caplog):
    path = root / "raw" / "cup_0.csv"
    write(path, value=10.0)
    before, stat = everything(root).data.x, path.stat()
    write(path, value=20.0)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert path.stat().st_size == stat.st_size
    with caplog.at_level(logging.WARNING):
        after = everything(root).data.x
    assert "again: 'cup_0.csv' was changed" in caplog.text
    assert (after - before).sum() == 2 * 384 * 3 * 10


def test_copied_files_are_not_processed_again(root, caplog):
    everything(root)
    path = root / "raw" / "sponge_1.npz"
    os.utime(path, (5, 5))
    with caplog.at_level(logging.WARNING):
        assert len(everything(root)) == 8
    assert not caplog.text


def test_edges_of_another_layout_are_processed_again_for_a_pre_transform(root, caplog):
    layout = allegro_uskin(symmetric=True)
    assert everything(root, pre_transform=_unchanged)[0].num_edges == 1401
    assert everything(root, pre_transform=_unchanged, layout=layout)[0].num_edges == 1400
    assert "again: layout: TaxelLayout('allegro_uskin'" in caplog.text


def _unchanged(data):
    return data


def test_processed_file_without_its_raw_files_is_used(root):
    everything(root)
    for path in (root / "raw").iterdir():
        path.unlink()
    assert len(everything(root)) == 8
    with pytest.raises(FileNotFoundError, match="there are no trials"):
        everything(root, force_reload=True)


def test_damaged_processed_file_says_what_to_do(root):
    path = root / "processed" / "allegro_uskin.pt"
    everything(root)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"cannot be read; delete it or .*force_reload=True"):
        everything(root)
    assert len(everything(root, force_reload=True)) == 8


def test_failure_leaves_the_old_file(root, monkeypatch):
    everything(root)
    write(root / "raw" / "sponge_2.npz", taxels=3)
    with pytest.raises(ValueError, match="must have 384 taxels"):
        everything(root)
    (root / "raw" / "sponge_2.npz").unlink()
    monkeypatch.setattr(recording_frames, "read_recording", None)
    assert len(everything(root)) == 8
    assert [path.name for path in (root / "processed").iterdir()] == ["allegro_uskin.pt"]


def test_layout_with_other_taxels(root):
    with pytest.raises(ValueError, match=r"purse_0\.npz': .*must have 4 taxels \(got 384\)"):
        AllegroUSkin(root, layout=grid(2, 2, pitch=0.01))
    everything(root)
    with pytest.raises(ValueError, match=r"'grid_2x2' must have 4 taxels \(got 384\)"):
        AllegroUSkin(root, layout=grid(2, 2, pitch=0.01))


def test_processed_readings_are_those_written_and_untouched_by_edits(root):
    everything(root).data.x.zero_()
    data = everything(root).data
    assert data.x[:, 0, 0].tolist() == [20.0, 20.0, 30.0, 30.0, 0.0, 0.0, 10.0, 10.0]
    assert data.x.dtype == data.joint.dtype == torch.float
    assert data.time.dtype == torch.double
