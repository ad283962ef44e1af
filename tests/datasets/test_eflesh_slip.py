import hashlib

import pytest
import torch
from datasets_server import served

from torch_geometric_tactile.data import Protocol, Trials
from torch_geometric_tactile.datasets import EFleshSlip

LABELS = "110000100"[:7]  # two slip, four hold, one slip


def write(folder, labels=LABELS, frames=3):
    """Reading c of magnetometer n in frame t of sequence i is 1000 i + 100 t + 3 n + c."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "labels").write_text("".join(f"{label}\n" for label in labels))
    for i in range(len(labels)):
        x = 1000.0 * i + 100 * torch.arange(frames)[:, None] + torch.arange(30)
        torch.save(x, folder / f"seq_{i}.pt")
    return folder


@pytest.fixture
def raw(tmp_path, monkeypatch):
    folder = write(tmp_path / "raw")
    names = ["labels", *(f"seq_{i}.pt" for i in range(len(LABELS)))]
    codes = {n: hashlib.sha256((folder / n).read_bytes()).hexdigest() for n in names}
    monkeypatch.setattr(EFleshSlip, "_sha256", codes)
    return folder


def test_small_files_by_hand(raw):
    dataset = EFleshSlip(raw.parent)
    assert repr(dataset) == "EFleshSlip(21)"
    assert dataset.num_classes == 2
    assert dataset.class_names == ["hold", "slip"]
    assert dataset.layout.digit_names == ("first", "second")
    assert dataset[4].x.tolist()[1] == [1103.0, 1104.0, 1105.0]
    assert dataset.y.tolist() == [int(label) for label in LABELS for _ in range(3)]
    assert dataset.step.tolist() == 7 * [0, 1, 2]
    assert dataset.time[:3].tolist() == pytest.approx([0.0, 0.01, 0.02])
    assert dataset.session_names == ["1_slip", "2_hold", "3_slip"]
    assert dataset.session[::3].tolist() == [0, 0, 1, 1, 1, 1, 2]
    assert dataset.trial_names == [f"seq_{i}" for i in range(7)]
    assert dataset[0].edge_index.shape == (2, 16)


def test_given_parts_share_no_run_of_slip(raw):
    trials = Trials(EFleshSlip(raw.parent))
    split = Protocol("given").split(trials)
    assert split.train.tolist() == [0, 1, 2, 3]
    assert split.test.tolist() == [4, 5, 6]
    assert trials[0].x.shape == (10, 9)


def test_files_may_be_in_the_root_itself(raw):
    assert len(EFleshSlip(raw)) == 21
    assert not (raw / "raw").exists()


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (
            torch.zeros(4, 29),
            r"seq_3\.pt' must hold a dense .* \(num_frames, 30\) \(got .*\(4, 29\)",
        ),
        (torch.zeros(0, 30), r"\(got shape \(0, 30\) of float32\)"),
        (torch.zeros(120), r"\(got shape \(120,\) of float32\)"),
        ({"x": torch.zeros(4, 30)}, r"must hold a dense tensor .* \(got dict\)"),
        (torch.zeros(4, 30).to_sparse(), r"seq_3\.pt' .* \(got a sparse_coo tensor\)"),
        (torch.zeros(4, 30).to_sparse_csr(), r"seq_3\.pt' .* \(got a sparse_csr tensor\)"),
        (torch.zeros(4, 30).to_sparse_bsr((2, 2)), r"\(got a sparse_bsr tensor\)"),
        (torch.nested.nested_tensor([torch.zeros(4, 30)]), r"seq_3\.pt' .* \(got a nested tensor"),
        (
            torch.nested.nested_tensor([torch.zeros(4, 30)], layout=torch.jagged),
            r"\(got a nested tensor",
        ),
        (
            torch.quantize_per_tensor(torch.zeros(4, 30), 0.1, 0, torch.quint8),
            r"seq_3\.pt' .* \(got a quantized tensor of quint8\)",
        ),
        (torch.zeros(4, 30, dtype=torch.complex64), r"real numbers .* of complex64\)"),
        (torch.full((4, 30), 1e300, dtype=torch.double), r"seq_3\.pt' must hold finite readings"),
        (torch.full((4, 30), torch.nan), r"seq_3\.pt' must hold finite readings"),
    ],
)
def test_other_sequences_are_refused(raw, content, match):
    torch.save(content, raw / "seq_3.pt")
    with pytest.raises(ValueError, match=match):
        EFleshSlip(raw.parent, checksum=False)


def test_readings_of_a_parameter_have_no_gradient(raw):
    torch.save(torch.nn.Parameter(torch.ones(3, 30)), raw / "seq_3.pt")
    dataset = EFleshSlip(raw.parent, checksum=False)
    assert dataset[9].x.tolist() == torch.ones(10, 3).tolist()
    assert not dataset.data.x.requires_grad


@pytest.mark.parametrize("labels", ["110000", "11000x1", "1100001\n0"])
def test_other_labels_are_refused(raw, labels):
    (raw / "labels").write_text("\n".join(labels))
    with pytest.raises(ValueError, match="labels' must hold 7 labels, 0 or 1 \\(got"):
        EFleshSlip(raw.parent, checksum=False)


def test_changed_file_is_refused(raw):
    torch.save(torch.zeros(3, 30), raw / "seq_1.pt")
    with pytest.raises(ValueError, match=r"seq_1\.pt' must have the SHA-256 checksum"):
        EFleshSlip(raw.parent)
    assert len(EFleshSlip(raw.parent, checksum=False)) == 21


def test_download_with_wrong_and_cut_files(raw, tmp_path, monkeypatch):
    with served(monkeypatch, EFleshSlip) as server:
        server.files = {path.name: path.read_bytes() for path in raw.iterdir()}
        whole = dict(server.files)
        server.files["seq_2.pt"] = b"<html>404</html>"
        with pytest.raises(ValueError, match=r"hash of downloaded file 'seq_2\.pt'"):
            EFleshSlip(tmp_path / "new")
        server.files = whole
        server.broken = {"seq_4.pt"}
        with pytest.raises(ConnectionError, match=r"seq_4\.pt"):
            EFleshSlip(tmp_path / "new")
        server.broken = set()
        assert len(EFleshSlip(tmp_path / "new")) == 21
        assert server.asked.count("seq_1.pt") == 1
        assert server.asked.count("seq_4.pt") == 2


def test_published_files(published_root):
    dataset = EFleshSlip(published_root("eflesh_slip"))
    assert len(dataset) == 41_100
    trials = Trials(dataset)
    assert trials.y.bincount().tolist() == [34, 103]
    split = Protocol("given").split(trials)
    assert trials.y[split.train].bincount().tolist() == [17, 86]
    assert trials.y[split.test].bincount().tolist() == [17, 17]
