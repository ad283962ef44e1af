import json
import re

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.datasets import BioTacSP, default_root
from torch_geometric_tactile.experiments.evaluation import MODELS
from torch_geometric_tactile.reports import grasp as demo
from torch_geometric_tactile.training import TactileClassifier

PICTURES = ("confusion.png", "grasps.png", "protocols.png", "roc.png")


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "report"
    content = demo.main(out=out, seeds=2, folds=2, epochs=1, generated=True)
    return out, content


def test_demo_writes_every_file_whole(report):
    out, _ = report
    assert {path.name for path in out.iterdir()} == {
        "report.html",
        "metrics.json",
        "grasp_gcn_df.ckpt",
        *PICTURES,
    }
    for name in PICTURES:
        assert (out / name).read_bytes().startswith(b"\x89PNG")


def test_demo_says_first_that_the_data_is_generated(report):
    out, _ = report
    page = (out / "report.html").read_text()
    body = page[page.index("<body") :]
    first = next(line for line in re.sub(r"<[^>]*>", "\n", body).splitlines() if line.strip())
    assert first.strip().startswith("Data: GENERATED, not measured")


def test_demo_page_needs_no_other_file(report):
    out, _ = report
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(PICTURES)
    assert not re.search(r'(src|href)="(?!data:|#)', page)


def test_demo_metrics_cover_models_protocols_scalings_and_seeds(report):
    out, content = report
    saved = json.loads((out / "metrics.json").read_text())
    assert saved == json.loads(json.dumps(content))
    keys = {(r["model"], r["protocol"], r["scaling"], r["seed"]) for r in saved["results"]}
    assert len(keys) == len(saved["results"]) == len(MODELS) * 6 * 2 * 2
    assert saved["data"]["generated"] is True
    assert all(0 <= record["accuracy"] <= 1 for record in saved["results"])


def test_demo_keeps_the_model_that_it_judged(report):
    out, content = report
    (record,) = (
        r
        for r in content["results"]
        if (r["model"], r["protocol"], r["scaling"], r["seed"])
        == ("GCN-DF", "unseen objects", "session", 0)
    )
    assert content["checkpoint"]["accuracy"] == record["accuracy"]
    path = out / "grasp_gcn_df.ckpt"
    classifier = TactileClassifier.load_from_checkpoint(path, weights_only=True)
    assert classifier.layout.name == "biotac_sp"


def test_demo_refuses_one_fold(tmp_path):
    with pytest.raises(ValueError, match=r"'folds' must be at least 2 \(got 1\)"):
        demo.main(out=tmp_path, folds=1, generated=True)


def test_data_is_generated_where_there_is_no_network(monkeypatch):
    monkeypatch.setattr(BioTacSP, "url", "http://127.0.0.1:9")  # nobody listens there
    data = demo.open_data(None)
    assert data.generated
    assert data.notice.startswith("Data: GENERATED")
    assert "could not be downloaded" in data.notice
    assert len(data.train)
    assert len(data.test)


def test_data_is_found_loose_in_a_folder_which_is_left_as_it_was(bts3_recordings, tmp_path):
    before = sorted(path.name for path in bts3_recordings.iterdir())
    for folder in (bts3_recordings, bts3_recordings.parent):
        data = demo.open_data(folder)
        assert not data.generated
        assert len(data.train) == 4682
        assert len(data.test) == 1149
    assert sorted(path.name for path in bts3_recordings.iterdir()) == before
    assert data.train.root == str(default_root("BioTacSP"))


def test_data_is_found_in_the_root_of_the_data_set(bts3_root):
    assert demo.open_data(bts3_root).train.root == str(bts3_root)


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"'--root' must be a folder \(got '.*nowhere'\)"):
        demo.open_data(tmp_path / "nowhere")


def test_damaged_data_is_an_error_and_not_replaced_by_generated(write_bts3, tmp_path):
    write_bts3(tmp_path / "set" / "raw")
    with pytest.raises(ValueError, match="must have the SHA-256 checksum"):
        demo.open_data(tmp_path / "set")
