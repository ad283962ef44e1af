"""The digits of scikit-learn, and of MNIST from a server."""

import gzip
import hashlib
import struct

import numpy as np
import pytest
import torch
from datasets_server import Server, served
from sklearn.datasets import load_digits

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import DigitImages

FILES = ("train-images-idx3-ubyte.gz", "train-labels-idx1-ubyte.gz")
FILES += tuple(name.replace("train", "t10k") for name in FILES)


def idx(array):
    sizes = struct.pack(f">{array.ndim}I", *array.shape)
    return b"\0\0\x08" + bytes([array.ndim]) + sizes + array.astype(np.uint8).tobytes()


def small_mnist():
    draw = np.random.default_rng(0)
    arrays = []
    for count in (40, 20):
        arrays.append(draw.integers(0, 256, (count, 28, 28)))
        arrays.append(np.arange(count) % 10)
    return arrays


@pytest.fixture
def mnist(monkeypatch):
    """A server of four small files, which pass for the published ones."""
    with served(monkeypatch, DigitImages) as server:
        server.files = {
            name: gzip.compress(idx(array), mtime=0)
            for name, array in zip(FILES, small_mnist(), strict=True)
        }
        publish(monkeypatch, server)
        yield server


def publish(monkeypatch, server: Server):
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in server.files.items()}
    monkeypatch.setattr(DigitImages, "_sha256", hashes)


def test_digits_of_sklearn():
    dataset = DigitImages()
    assert repr(dataset) == "DigitImages(1797)"
    assert dataset.x.shape == (1797, 1024, 1)
    assert dataset.image.data_ptr() == dataset.x.data_ptr()
    assert dataset.data.image.shape == (1797, 1, 32, 32)
    assert dataset[3].image.shape == (1, 1, 32, 32)
    assert dataset.num_classes == 10
    assert dataset.class_names == list("0123456789")
    assert dataset.trial.equal(dataset.group)
    assert len(dataset.trial.unique()) == 1797
    assert dataset[0].edge_index.shape == (2, 3968)
    digits = load_digits()
    assert dataset.y.tolist() == digits.target.tolist()
    # Blocks of four pixels have the mean of the pixel they come from, but for its neighbours'.
    small = torch.nn.functional.avg_pool2d(dataset.image, 4)[:, 0]
    given = torch.from_numpy(digits.images).float() / 16
    assert float((small - given).abs().mean()) < 0.1
    assert float(torch.corrcoef(torch.stack([small.flatten(), given.flatten()]))[0, 1]) > 0.95
    assert (dataset.x.min(), dataset.x.max()) == (0, 1)


def test_folds_of_digits():
    dataset = DigitImages()
    found = [DigitImages(fold=fold, split="test").trial for fold in range(5)]
    assert torch.cat(found).sort().values.tolist() == list(range(1797))
    part = Protocol("trial", folds=5, stratify="y").split(dataset, 0, 3)
    assert dataset.trial[part.test].equal(found[3])
    assert len(DigitImages(fold=3, split="train")) == 1797 - len(found[3])


def test_mnist_is_downloaded_once(mnist, tmp_path):
    dataset = DigitImages(tmp_path, source="mnist")
    assert sorted(mnist.asked) == sorted(FILES)
    images = small_mnist()
    assert len(dataset) == 60
    assert dataset.y.tolist() == [*images[1], *images[3]]
    inner = dataset.image[:, 0, 2:30, 2:30]
    expected = torch.from_numpy(np.concatenate([images[0], images[2]])).float() / 255
    assert inner.equal(expected)
    border = dataset.image.clone()
    border[:, :, 2:30, 2:30] = 0
    assert not border.any()
    assert dataset.session_names == ["train", "test"]
    assert DigitImages(tmp_path, source="mnist").x.equal(dataset.x)
    assert len(mnist.asked) == 4


def test_published_parts_of_mnist(mnist, tmp_path):
    dataset = DigitImages(tmp_path, source="mnist")
    assert len(DigitImages(tmp_path, split="train", source="mnist")) == 40
    test = DigitImages(tmp_path, split="test", source="mnist")
    assert test.trial.tolist() == list(range(40, 60))
    part = Protocol("given").split(dataset)
    assert [len(one) for one in part] == [40, 0, 20]
    assert len(DigitImages(tmp_path, 0, "test", source="mnist")) == 12


def test_other_files_of_mnist(mnist, tmp_path):
    DigitImages(tmp_path, source="mnist")
    path = tmp_path / "raw" / FILES[1]
    path.write_bytes(gzip.compress(idx(np.arange(40) % 10 + 1), mtime=0))
    with pytest.raises(ValueError, match=r"train-labels.* must have the SHA-256 .*checksum=False"):
        DigitImages(tmp_path, source="mnist")
    with pytest.raises(ValueError, match=r"a digit, 0 to 9, for each of 40 .*up to 10\)"):
        DigitImages(tmp_path, source="mnist", checksum=False)
    path.write_bytes(gzip.compress(idx(np.arange(39) % 10), mtime=0))
    with pytest.raises(ValueError, match=r"for each of 40 images \(got shape \(39,\), up to 9\)"):
        DigitImages(tmp_path, source="mnist", checksum=False)
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ValueError, match=r"train-labels.* cannot be read as IDX"):
        DigitImages(tmp_path, source="mnist", checksum=False)
    path.write_bytes(idx(np.arange(40) % 10))  # not packed
    assert len(DigitImages(tmp_path, source="mnist", checksum=False)) == 60
    (tmp_path / "raw" / FILES[0]).write_bytes(idx(np.zeros((40, 8, 8))))
    with pytest.raises(ValueError, match=r"images of 28 x 28 pixels \(got shape \(40, 8, 8\)\)"):
        DigitImages(tmp_path, source="mnist", checksum=False)


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"source": "usps"}, r"'source' must be one of \['sklearn', 'mnist'\] \(got 'usps'\)"),
        ({"root": "here"}, r"'root' must be None with source='sklearn' \(got 'here'\)"),
        ({"split": "test"}, r"'fold' must be given with split='test' \(got None\)"),
    ],
    ids=str,
)
def test_bad_arguments(kwargs, match):
    with pytest.raises(ValueError, match=match):
        DigitImages(**kwargs)


def test_only_mnist_has_parts():
    with pytest.raises(ValueError, match="must have a 'part' for each sample with by='given'"):
        Protocol("given").split(DigitImages())
