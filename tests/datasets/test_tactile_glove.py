import numpy as np
import pytest
import torch
from published_files import cell, glove, glove_mat

from torch_geometric_tactile.data import Protocol, Trials
from torch_geometric_tactile.datasets import TactileGlove

pytest.importorskip("scipy.io")
FILE = "metadata.mat"
OBJECTS = ["mug", "tennis_ball", "empty_hand"]


@pytest.mark.parametrize("inner", [".", "raw", "classification_lite"])
@pytest.mark.parametrize("packed", [True, False])
def test_frames_by_hand(tmp_path, inner, packed):
    glove_mat(tmp_path / inner / FILE, packed=packed)
    dataset = TactileGlove(tmp_path)
    assert repr(dataset) == "TactileGlove(11)"  # frame 1 has no valid label
    assert dataset.class_names == dataset.group_names == OBJECTS
    assert dataset.session_names == dataset.trial_names == [f"recording {i} é" for i in range(6)]
    order = [0, 6, 7, 2, 8, 3, 9, 4, 10, 5, 11]
    assert dataset.session.tolist() == dataset.trial.tolist() == [i % 6 for i in order]
    assert dataset.y.tolist() == dataset.group.tolist() == [i % 3 for i in order]
    assert dataset.part.tolist() == [2 * (i % 6 // 3) for i in order]
    assert dataset.balanced.tolist() == [int(i % 2 == 0) for i in order]
    assert dataset.time.tolist() == pytest.approx([0, 0.84, 0, *[0, 0.84] * 4], abs=1e-6)
    assert dataset.x.shape == (11, 1024, 1)
    assert dataset.x[:, 3 * 32 + 4, 0].tolist() == [500 + 10 * i for i in order]
    assert (dataset.x.view(11, 32, 32)[:, 4, 3] == 500).all()
    assert dataset[0].edge_index.shape == (2, 3968)
    assert len(Trials(dataset, ragged="pad")) == 6


def test_frames_without_a_valid_label(tmp_path):
    glove_mat(tmp_path / FILE)
    assert len(TactileGlove(tmp_path, invalid=True)) == 12
    assert len(TactileGlove(tmp_path)) == 11


def test_recordings_are_held_out_and_given_parts_taken(tmp_path):
    glove_mat(tmp_path / FILE)
    dataset = TactileGlove(tmp_path)
    train, _, test = Protocol("given").split(dataset)
    assert (len(train), len(test)) == (5, 6)
    split = Protocol("session", folds=2, stratify="y").split(dataset)
    assert not {*dataset.session[split.test].tolist()} & {*dataset.session[split.train].tolist()}


def test_cells_that_change_are_taken(tmp_path):
    glove_mat(tmp_path / FILE)
    dataset = TactileGlove(tmp_path)
    changing = (dataset.x != dataset.x[0]).any(dim=0).view(-1)
    for taxels in (changing, [3 * 32 + 4]):
        chosen = TactileGlove(tmp_path, taxels=taxels)
        assert chosen.layout.num_taxels == 1
        assert chosen.layout.image_map.tolist() == [[3, 4]]
        assert torch.equal(chosen.x, dataset.x[:, changing])
    # Other cells, as many.
    assert (TactileGlove(tmp_path, taxels=[7]).x == 500).all()
    with pytest.raises(ValueError, match="1024"):
        TactileGlove(tmp_path, taxels=[1024])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"pressure": None}, "it must have one array 'pressure' of numbers or strings"),
        ({"pressure": np.zeros((12, 31, 32))}, r"frames of 32 x 32 \(got shape \(12, 31, 32\)\)"),
        ({"objects": np.zeros((1, 3))}, "'objects' must be a cell array of names"),
        ({"objectId": np.full((1, 12), 3)}, r"'objectId' must be .* one of 3 'objects' \(got 3"),
        ({"recordingId": np.full((1, 12), 0.5)}, r"'recordingId' must be .* one of 6 .* \(got 0.5"),
        ({"splitId": np.full((1, 12), -1)}, r"'splitId' must be .* one of 2 'splits' \(got -1"),
        ({"ts": np.zeros((1, 11))}, r"'ts' must have a number for each of 12 frames \(got shape"),
        ({"ts": np.full((1, 12), np.nan)}, "'ts' must be finite"),
        ({"isBalanced": cell("a")}, "'isBalanced' must have a number for each of 12 frames"),
        ({"splits": cell("train", "eval")}, r"'splits' must be 'train' and 'test' \(got 'eval'\)"),
        ({"hasValidLabel": np.zeros((1, 12))}, "must have frames with a valid label"),
    ],
)
def test_refused(tmp_path, more, message):
    glove_mat(tmp_path / FILE, glove(**more))
    with pytest.raises(ValueError, match=rf"{FILE}'.*{message}"):
        TactileGlove(tmp_path)
    assert not list((tmp_path / "processed").glob("*.pt"))
