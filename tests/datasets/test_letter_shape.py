"""Letters of a generated folder."""

import json
import logging
import os
import shutil

import numpy as np
import pytest
import torch
from letter_files import LETTERS, write_letters
from sklearn.neighbors import KNeighborsClassifier
from torch_geometric.loader import DataLoader
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import LetterShape, letter_augmentation
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import biotac, grid, hexagonal, thinned
from torch_geometric_tactile.transforms import RandomNoise

THREE = ("A", "B", "C")


@pytest.fixture
def folder(tmp_path):
    return write_letters(tmp_path / "letters")


@pytest.fixture
def few(tmp_path):
    return write_letters(tmp_path / "few", THREE)


def press(path, seed=0):
    """Pressures in kPa."""
    return np.random.default_rng(seed).uniform(0, 75, (32, 32)).round(3)


def test_a_folder_of_letters(folder):
    dataset = LetterShape(folder)
    assert repr(dataset) == "LetterShape(390)"
    assert dataset.class_names == list(LETTERS)
    assert dataset.num_classes == 26
    assert dataset.y.bincount().tolist() == [15] * 26
    assert dataset.trial.equal(dataset.group)
    assert dataset.trial.bincount().tolist() == [3] * 130
    assert dataset.column("copy")[:6].tolist() == [0, 1, 2, 0, 1, 2]
    assert dataset.group_names[7] == "B/B_0000.npy, matrix 2"
    assert dataset.x.shape == (390, 1024, 1)
    assert dataset.x.dtype == torch.float32
    assert 0 <= float(dataset.x.min()) < float(dataset.x.max()) <= 1
    assert dataset.layout.name == "letter_array"
    assert dataset[0].edge_index.shape == (2, 3968)
    assert not dataset.synthetic
    assert dataset.left_out == []


def test_originals_are_the_matrices_and_copies_are_not(few):
    dataset = LetterShape(few, letters=THREE)
    raw = np.concatenate([np.load(few / name / f"{name}_0000.npy") for name in THREE])
    kept = dataset.column("copy") == 0
    expected = torch.from_numpy(raw.reshape(15, 1024, 1) / np.float32(255))
    assert dataset.x[kept].equal(expected)
    for i in (1, 2):
        other = dataset.x[dataset.column("copy") == i]
        assert all(not a.equal(b) for a, b in zip(other, expected, strict=True))
    assert dataset.x.min() >= 0
    assert dataset.x.max() <= 1


def test_images_are_views(folder):
    dataset = LetterShape(folder)
    for data in (dataset.data, dataset.batch([3, 4]), dataset[5]):
        assert data.image.data_ptr() == data.x.data_ptr()
        assert data.image.flatten().equal(data.x.flatten())
        assert "image" not in data
    assert dataset.image.data_ptr() == dataset.x.data_ptr()
    assert dataset.image.shape == (390, 1, 32, 32)
    assert dataset[5].image.shape == (1, 1, 32, 32)
    assert dataset[5:9].image.shape == (4, 1, 32, 32)
    assert dataset.copy([1, 2]).image.equal(dataset.image[1:3])
    size = os.path.getsize(dataset.processed_paths[0])
    assert size < 1.1 * 4 * dataset.x.numel()


def test_images_of_batches(few):
    dataset = LetterShape(few, letters=THREE, transform=RandomNoise(0.1))
    static = next(iter(StaticLoader(dataset, batch_size=4)))
    joined = next(iter(DataLoader(dataset, batch_size=4)))
    for batch in (static, joined, static.to_batch()):
        assert batch.image.shape == (4, 1, 32, 32)
        assert batch.image.flatten().equal(batch.x.flatten())
    assert not static.image.equal(dataset.image[:4])  # it follows the transform
    assert type(static.to_batch()) is type(joined)


class Halved(BaseTransform):
    """A transform of single samples."""

    def forward(self, data):
        data.x = data.image.view(-1, 1) / 2
        return data


def test_images_for_transforms_of_samples(few):
    plain = LetterShape(few, letters=THREE)
    once = LetterShape(few, letters=THREE, pre_transform=Halved())
    every = LetterShape(few, letters=THREE, transform=Halved())
    assert once.image.equal(plain.image / 2)
    assert every.batch([0, 1]).image.equal(plain.image[:2] / 2)
    assert every[0].image.equal(plain.image[:1] / 2)


def test_folds_hold_out_whole_presses_of_every_letter(folder):
    tests = []
    for fold in range(5):
        train, test = (LetterShape(folder, fold, part) for part in ("train", "test"))
        assert len(train) == 4 * len(test) == 312
        assert not set(train.trial.tolist()) & set(test.trial.tolist())
        assert test.y.bincount(minlength=26).tolist() == [3] * 26
        tests += test.trial.unique().tolist()
    assert sorted(tests) == list(range(130))
    dataset = LetterShape(folder)
    part = Protocol("trial", folds=5, stratify="y").split(dataset, 0, 2)
    assert dataset.trial[part.test].equal(LetterShape(folder, 2, "test").trial)
    other = LetterShape(folder, 2, "test", split_seed=1)
    assert not other.trial.equal(LetterShape(folder, 2, "test").trial)
    assert len(LetterShape(folder, fold=1)) == 390


def test_folds_of_originals_are_the_same(folder):
    some, all_copies = LetterShape(folder, 1, "test", copies=1), LetterShape(folder, 1, "test")
    assert len(all_copies) == 3 * len(some)
    assert all_copies.trial.unique().equal(some.trial)
    kept = all_copies.column("copy") == 0
    assert all_copies.x[kept].equal(some.x)


def test_split_by_sample_leaks(tmp_path):
    """A nearest neighbour finds the other copies of a press, which are no other presses."""
    names = list("abcdefgh")
    dataset = LetterShape(write_letters(tmp_path, names, presses=20), letters=names)
    score = {}
    for by in ("frame", "trial"):
        found = []
        for fold in range(5):
            part = Protocol(by, folds=5, stratify="y").split(dataset, fold=fold)
            x, y = dataset.x.flatten(1).numpy(), dataset.y.numpy()
            nearest = KNeighborsClassifier(1).fit(x[part.train], y[part.train])
            found.append(nearest.score(x[part.test], y[part.test]))
        score[by] = sum(found) / 5
    # Measured here: 0.41 by sample, 0.26 by press, where guessing is right in 0.125.
    assert 1 / 8 < score["trial"] < 0.35
    assert score["frame"] > score["trial"] + 0.1


def test_copies_depend_on_their_file_and_the_seed_only(few, tmp_path):
    first = LetterShape(few, letters=THREE)
    again = LetterShape(few, letters=THREE, force_reload=True)
    assert first.x.equal(again.x)
    assert first.x[1].mean().item() == pytest.approx(0.0313692, abs=1e-6)  # for ever
    other = LetterShape(few, letters=THREE, augment_seed=1)
    assert not first.x.equal(other.x)
    (few / "A" / "A_0000.npy").unlink()
    np.savetxt(few / "A" / "A_0000.csv", press(few), delimiter=",")
    fewer = LetterShape(few, letters=THREE)
    assert fewer.x[3:].equal(first.x[15:])
    shutil.copy(few / "B" / "B_0000.npy", few / "C" / "C_0000.npy")
    same = LetterShape(few, letters=THREE).x[3:].view(2, 5, 3, 1024)
    assert same[0, :, 0].equal(same[1, :, 0])
    assert not same[0, :, 1].equal(same[1, :, 1])


def test_copies_leave_the_random_state_alone(few):
    torch.manual_seed(0)
    state = torch.get_rng_state()
    LetterShape(few, letters=THREE)
    assert torch.get_rng_state().equal(state)


def test_inversions_and_augmentations(few):
    plain = LetterShape(few, letters=THREE, inversion=None)
    assert float(plain.x.flatten(1).mean(1).max()) < 0.4  # nothing is inverted
    grey = LetterShape(few, letters=THREE)
    share = (grey.x.flatten(1).mean(1) > 0.5)[grey.column("copy") > 0].double().mean()
    assert 0.2 < float(share) < 0.8
    mirror = LetterShape(few, letters=THREE, inversion="mirror")
    assert not mirror.x.equal(plain.x)
    noise = LetterShape(few, letters=THREE, augment=RandomNoise(0.0), copies=2)
    assert noise.x[0::2].equal(noise.x[1::2])
    with pytest.raises(ValueError, match="'inversion' must be 'grey', 'mirror' or None"):
        letter_augmentation("negative")


@pytest.mark.parametrize(
    ("layout", "is_shifted"),
    [
        (grid(4, 6, 0.01), True),
        (grid(6, 1, 0.01), True),
        (hexagonal(4, 6, 0.01), False),
        (thinned(grid(6, 6, 0.01), 0.5, seed=0), False),
        (biotac(), False),
    ],
    ids=["grid", "column", "hexagonal", "thinned", "electrodes"],
)
def test_copies_are_shifted_on_a_grid_without_gaps_only(layout, is_shifted):
    names = [type(part).__name__ for part in letter_augmentation(layout=layout).transforms]
    assert ("RandomShift" in names) == is_shifted
    assert names[-2:] == ["RandomContrast", "RandomInversion"]


def test_formats_are_mixed(few, caplog):
    image = pytest.importorskip("PIL.Image", reason="needs the extra 'io'")
    savemat = pytest.importorskip("scipy.io").savemat
    for name in THREE:
        shutil.rmtree(few / name)
        (few / name).mkdir()
    kilopascal = press(few)
    np.savetxt(few / "A" / "1.csv", kilopascal, delimiter=",")
    np.save(few / "A" / "2.npy", kilopascal)
    savemat(few / "A" / "3.MAT", {"press": kilopascal[None].repeat(2, 0)}, do_compression=True)
    grey = (kilopascal / 100 * 255).round().astype(np.uint8)
    image.fromarray(grey).save(few / "B" / "1.png")
    np.save(few / "B" / "2.npy", grey)
    image.fromarray((kilopascal / 100 * 65535).round().astype(np.uint16)).save(few / "B" / "3.png")
    np.save(few / "C" / "1.npy", kilopascal.astype(np.float32))
    np.save(few / "C" / "2.npy", kilopascal.round().astype(np.int64))
    dataset = LetterShape(few, letters=THREE, copies=1)
    assert dataset.y.tolist() == [0, 0, 0, 0, 1, 1, 1, 2, 2]
    expected = torch.from_numpy(kilopascal).float().view(-1, 1) / 100
    for i, steps in enumerate([1e9, 1e9, 1e9, 1e9, 255, 255, 65535, 1e6, 100]):
        assert float((dataset.x[i] - expected).abs().max()) < 0.51 / steps + 1e-7
    assert dataset.group_names[:3] == ["A/1.csv", "A/2.npy", "A/3.MAT, matrix 0"]
    assert not caplog.records


@pytest.mark.parametrize(
    ("pressure", "full_scale", "part"), [(25.0, 50, 0.5), (25.0, 25, 1.0), (50.00004, 50, 1.0)]
)
def test_full_scale(few, pressure, full_scale, part):
    for name in THREE:
        np.save(few / name / f"{name}_0000.npy", np.full((32, 32), pressure))
    dataset = LetterShape(few, letters=THREE, full_scale=full_scale, copies=1)
    assert dataset.x.unique().tolist() == [part]
    with pytest.raises(ValueError, match=r"is above the full scale of 24\.9999"):
        LetterShape(few, letters=THREE, full_scale=24.9999)


def bad_files(folder):
    matrix = press(folder)
    (folder / "A" / "cut.npy").write_bytes((folder / "A" / "A_0000.npy").read_bytes()[:-1])
    (folder / "A" / "text.csv").write_text("this is no matrix\n")
    (folder / "A" / "notes.txt").write_text("pressed on Monday")
    np.savetxt(folder / "B" / "small.csv", matrix[:31], delimiter=",")
    stack = np.stack([matrix] * 4)
    stack[1, 3, 4] = np.nan
    stack[2, 0, 31] = -0.25
    stack[3, 31, 0] = 100.5
    np.save(folder / "B" / "stack.npy", stack)
    np.save(folder / "C" / "infinite.npy", np.full((32, 32), np.inf))
    (folder / "C" / "gone.csv").symlink_to(folder / "nowhere.csv")
    (folder / "C" / "folder.csv").mkdir()
    (folder / "C" / ".hidden.csv").write_text("")


def test_what_cannot_be_used_is_left_out(few, caplog):
    bad_files(few)
    with caplog.at_level(logging.WARNING):
        dataset = LetterShape(few, letters=THREE)
    assert dataset.y.bincount().tolist() == [15, 18, 15]
    (record,) = caplog.records
    assert "10 files or matrices are left out" in record.getMessage()
    reasons = [
        r"'A/cut.npy' must have 5248 bytes .* \(got 5247\): is it truncated",
        r"'A/notes.txt' must have one of the suffixes .csv, .mat, .npy, .png",
        r"'A/text.csv', line 1 must have 32 cells \(got 1\)",
        r"'B/small.csv' must have 32 lines \(got 31\): is the file truncated",
        r"'B/stack.npy', matrix 1: row 3, column 4 has no reading \(NaN\)",
        r"'B/stack.npy', matrix 2: row 0, column 31 has a negative pressure \(-0.25\)",
        r"'B/stack.npy', matrix 3: row 31, column 0 is above the full scale of 100 \(got 100.5\)",
        r"'C/folder.csv' does not exist",
        r"'C/gone.csv' does not exist",
        r"'C/infinite.npy': row 0, column 0 is above the full scale of 100 \(got inf\)",
    ]
    assert len(dataset.left_out) == len(reasons)
    for text, reason in zip(dataset.left_out, reasons, strict=True):
        with pytest.raises(ValueError, match=reason):
            raise ValueError(text)
    assert "B/stack.npy, matrix 0" in dataset.group_names
    assert LetterShape(few, letters=THREE).left_out == dataset.left_out  # of the processed file


def test_many_left_out_are_counted(few, caplog):
    for i in range(30):
        (few / "A" / f"bad_{i:02}.csv").write_text("")
    with caplog.at_level(logging.WARNING):
        assert len(LetterShape(few, letters=THREE).left_out) == 30
    assert "30 files" in caplog.text
    assert "bad_09" in caplog.text
    assert "bad_10" not in caplog.text
    assert "and 20 more" in caplog.text


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda root: shutil.rmtree(root / "Q"), r"26 letters.* \(got 25 folders; missing: 'Q'\)"),
        (lambda root: (root / "Ä").mkdir(), r"26 letters.* \(got 27 folders; unknown: 'Ä'\)"),
        (lambda root: (root / "Q").rename(root / "q"), r"missing: 'Q'; unknown: 'q'\): add or"),
        (
            lambda root: [shutil.rmtree(root / name) for name in LETTERS[2:]],
            r"missing: 'C', 'D', .*'L', ... and 14 more\)",
        ),
        (lambda root: (root / "Q" / "Q_0000.npy").unlink(), r"got none of 'Q' .*is empty"),
        (
            lambda root: np.save(root / "Q" / "Q_0000.npy", np.zeros((28, 28))),
            r"got none of 'Q' .*: 'Q/Q_0000.npy' must hold a matrix of 32 x 32 .*\(28, 28\)",
        ),
        (lambda root: (root / "simulation.json").write_text("{"), r"simulation.json' cannot be"),
        (lambda root: (root / "simulation.json").write_text("[1]"), r"must hold an object"),
        (
            lambda root: (root / "simulation.json").write_text('{"synthetic": "yes"}'),
            r"'synthetic' must be true or false \(got 'yes'\)",
        ),
    ],
    ids=["25", "27", "renamed", "2", "empty", "unusable", "cut json", "no object", "no boolean"],
)
def test_bad_folders(folder, spoil, match):
    spoil(folder)
    with pytest.raises(ValueError, match=match):
        LetterShape(folder)
    assert not list((folder / "processed").glob("*.pt"))


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"split": "val"}, r"'split' must be 'train', 'test' or None \(got 'val'\)"),
        ({"split": "train"}, r"'fold' must be given with split='train' \(got None\)"),
        ({"fold": 5, "split": "test"}, r"'fold' must be between 0 and 4 \(got 5\)"),
        ({"fold": -1}, r"'fold' must be between 0 and 4 \(got -1\)"),
        ({"folds": 1}, r"'folds' must be at least 2 \(got 1\)"),
        ({"folds": 9, "fold": 0, "split": "test"}, r"'folds' must be at most 5"),
        ({"copies": 0}, r"'copies' must be an integer, at least 1 \(got 0\)"),
        ({"copies": 1.5}, r"'copies' must be an integer, at least 1 \(got 1.5\)"),
        ({"full_scale": 0}, r"'full_scale' must be a positive pressure \(got 0\)"),
        ({"full_scale": float("nan")}, r"'full_scale' must be a positive pressure \(got nan\)"),
        ({"letters": []}, r"'letters' must be different names of folders"),
        ({"letters": ["A", "A"]}, r"'letters' must be different names of folders"),
        ({"letters": ["A", "../B"]}, r"'letters' must be different names of folders"),
        ({"letters": "AB"}, r"each of the 2 letters.* \(got 26 folders; unknown: 'C', 'D'"),
        ({"adjacency": "triangles"}, r"triangles"),
        ({"inversion": "grau"}, r"'inversion' must be 'grey', 'mirror' or None \(got 'grau'\)"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_bad_arguments(folder, kwargs, match):
    with pytest.raises(ValueError, match=match):
        LetterShape(folder, **kwargs)


def test_other_classes_and_edges(tmp_path):
    digits = [str(i) for i in range(10)]
    write_letters(tmp_path / "raw", digits)
    dataset = LetterShape(tmp_path, letters=digits, adjacency="dense")
    assert dataset.class_names == digits
    assert dataset[0].edge_index.shape == (2, 7812)
    before = os.stat(dataset.processed_paths[0]).st_mtime_ns
    assert LetterShape(tmp_path, letters=digits, adjacency=None)[0].edge_index is None
    assert os.stat(dataset.processed_paths[0]).st_mtime_ns == before
    assert dataset.raw_dir == str(tmp_path / "raw")


def test_simulated_presses_say_so(few):
    (few / "simulation.json").write_text(json.dumps({"synthetic": True, "presses": 5}))
    dataset = LetterShape(few, letters=THREE)
    assert dataset.synthetic
    assert "15 simulated presses" in str(dataset.get_summary())
    for made in ({"synthetic": False}, {"presses": 5}):
        (few / "simulation.json").write_text(json.dumps(made))
        assert not LetterShape(few, letters=THREE).synthetic  # processed again


def test_taxels_of_another_sensor(few, caplog):
    biotac().save(few / "layout.json")
    draw = np.random.default_rng(0)
    for name in THREE:
        np.save(few / name / f"{name}_0000.npy", draw.uniform(0, 60, (4, 19)))
    np.save(few / "A" / "one.npy", draw.uniform(0, 60, 19))
    np.save(few / "A" / "nan.npy", np.full(19, np.nan))
    np.savetxt(few / "A" / "matrix.csv", press(few), delimiter=",")
    with caplog.at_level(logging.WARNING):
        dataset = LetterShape(few, letters=THREE, adjacency=None, inversion=None)
    assert dataset.layout.name == "biotac"
    assert dataset.x.shape == (39, 19, 1)
    assert dataset.left_out == [
        "'A/matrix.csv' must have one of the suffixes .npy",
        "'A/nan.npy': taxel 0 has no reading (NaN)",
    ]
    with pytest.raises(ValueError, match=r"'image' needs the taxels of letter_array\(\)"):
        dataset.image
    assert not hasattr(dataset[0], "image")
    given = LetterShape(few, letters=THREE, adjacency=None, inversion=None, layout=biotac())
    assert given.x.equal(dataset.x)
    with pytest.raises(ValueError, match="an adjacency of layout 'biotac': none"):
        LetterShape(few, letters=THREE, inversion=None)


def test_square_layouts_that_are_no_image_are_rows(few):
    for name in THREE:
        np.save(few / name / f"{name}_0000.npy", np.zeros((2, 1024)))
    dataset = LetterShape(few, letters=THREE, layout=grid(16, 64, 1e-3))
    assert dataset.x.shape == (18, 1024, 1)
    assert not hasattr(dataset[0], "image")


def test_changes_are_processed_again(few, caplog):
    first = LetterShape(few, letters=THREE)
    np.save(few / "B" / "more.npy", press(few))
    with caplog.at_level(logging.WARNING):
        second = LetterShape(few, letters=THREE)
    assert len(second) == len(first) + 3
    assert "B/more.npy" in caplog.text
    (few / "D").mkdir()
    with pytest.raises(ValueError, match="unknown: 'D'"):
        LetterShape(few, letters=THREE)


def test_processed_file_outlives_the_raw_ones(few):
    first = LetterShape(few, letters=THREE)
    for name in THREE:
        shutil.rmtree(few / name)
    assert LetterShape(few, letters=THREE).x.equal(first.x)
    with pytest.raises(FileNotFoundError, match="no letters in"):
        LetterShape(few, letters=THREE, force_reload=True)


def test_summary_counts_letters_presses_and_faults(few):
    bad_files(few)
    summary = LetterShape(few, letters=THREE).get_summary()
    assert summary.num_presses == 16
    assert summary.num_graphs == 48
    assert summary.copies == 3
    assert summary.num_samples_per_letter == {"A": 15, "B": 18, "C": 15}
    assert summary.num_presses_per_letter == {"A": 5, "B": 6, "C": 5}
    assert len(summary.left_out) == 10
    assert summary.num_nodes.mean == summary.num_nodes.max == 1024
    assert summary.num_edges.min == 3968
    assert str(summary) == (
        "LetterShape (#graphs=48): 16 recorded presses, stored 3 times\n"
        "#nodes=1024, #edges=3968\n"
        "samples (presses) of each letter: A 15 (5), B 18 (6), C 15 (5)\n"
        "files or matrices left out: 10"
    )
    test = LetterShape(few, 0, "test", letters=THREE).get_summary()
    assert sum(test.num_presses_per_letter.values()) == test.num_presses


def test_a_filter_sees_edges_and_images(few):
    dataset = LetterShape(
        few,
        letters=THREE,
        pre_filter=lambda data: bool(data.y != 1) and data.edge_index.size(1) == 3968,
    )
    assert dataset.y.bincount().tolist() == [15, 0, 15]
    assert dataset.num_classes == 3
