import logging

import pytest
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


def test_edges_of_another_layout_are_processed_again_for_a_pre_transform(root, caplog):
    layout = allegro_uskin(symmetric=True)
    assert everything(root, pre_transform=_unchanged)[0].num_edges == 1401
    assert everything(root, pre_transform=_unchanged, layout=layout)[0].num_edges == 1400
    assert "again: layout: TaxelLayout('allegro_uskin'" in caplog.text


def _unchanged(data):
    return data


def test_layout_with_other_taxels(root):
    with pytest.raises(ValueError, match=r"purse_0\.npz': .*must have 4 taxels \(got 384\)"):
        AllegroUSkin(root, layout=grid(2, 2, pitch=0.01))
    everything(root)
    with pytest.raises(ValueError, match=r"'grid_2x2' must have 4 taxels \(got 384\)"):
        AllegroUSkin(root, layout=grid(2, 2, pitch=0.01))
