import json
import re

import pytest
from listed_outputs import check_listed

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.datasets import BioTacSP
from torch_geometric_tactile.datasets._root import default_root
from torch_geometric_tactile.experiments import _demo
from torch_geometric_tactile.experiments._demo import demo_data, demo_plans

pytestmark = pytest.mark.slow

PICTURES = ("confusion.png", "grasps.png", "protocols.png")
SHORT = ["demo", "--generated", "--folds", "2", "--epochs", "1", "--jobs", "1"]
MODELS = ["taxel_net", "svm_rbf", "svm_linear", "constant"]
HELD_OUT = ["random grasps", "new objects", "new session", "official test"]
READINGS = ["raw, all fingers", "common mode, middle + thumb"]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A demo on few generated grasps: its folder, and the comparisons that it wrote."""
    out = tmp_path_factory.mktemp("demo") / "report"
    with pytest.MonkeyPatch.context() as patch:
        few = {"num_samples": 240, "num_test": 90, "num_objects": 6}
        patch.setattr(_demo, "_GENERATED_ARGUMENTS", few)
        assert main([*SHORT, "--out", str(out)]) == 0
        yield out, json.loads((out / "comparisons.json").read_text())


@pytest.mark.full
def test_demo_writes_every_file_whole(demo):
    out, _ = demo
    names = {"report.html", "comparisons.json", "runs", *PICTURES}
    assert {path.name for path in out.iterdir()} == names
    check_listed([*SHORT, "--out", out], out)
    for name in PICTURES:
        assert (out / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.full
def test_demo_compares_models_by_readings_and_held_out_parts(demo):
    _, comparisons = demo
    keys = [(comparison["readings"], comparison["held_out"]) for comparison in comparisons]
    assert keys == [(readings, held_out) for readings in READINGS for held_out in HELD_OUT]
    for comparison in comparisons:
        assert [model["name"] for model in comparison["models"]] == MODELS
        num_splits = {"new session": 3, "official test": 1}.get(comparison["held_out"], 2)
        assert comparison["num_splits"] == num_splits
        assert num_splits > 1 or comparison["num_seeds"] == 2
    protocols = [comparison["protocol"] for comparison in comparisons[:4]]
    assert [protocol.split(",")[0] for protocol in protocols] == [
        "2 folds by frame",
        "2 folds by group",
        "3 folds by session",
        "the given parts",
    ]
    samples = [comparison["data"]["num_samples"] for comparison in comparisons[:4]]
    assert samples == [240, 240, 240, 330]


@pytest.mark.full
def test_scores_of_the_page_are_those_of_the_comparisons(demo, capsys):
    out, comparisons = demo
    assert main([*SHORT, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    (line,) = [x for x in text.splitlines() if re.match(r"\*?svm_rbf +raw", x)]
    scores = [comparison["models"][1]["scores"]["accuracy"] for comparison in comparisons[:4]]
    assert re.findall(r"[\d.]+ ± [\d.]+", line) == [
        f"{100 * score['mean']:.1f} ± {100 * score['sd']:.1f}" for score in scores
    ]
    page = (out / "report.html").read_text()
    for score in scores:
        assert f"{100 * score['mean']:.1f} ± {100 * score['sd']:.1f}" in page
    assert comparisons[-1]["advice"] in " ".join(text.split())


@pytest.mark.full
def test_report_says_first_that_the_data_is_generated(demo):
    out, _ = demo
    page = (out / "report.html").read_text()
    body = page[page.index("<body") :]
    first = next(line for line in re.sub(r"<[^>]*>", "\n", body).splitlines() if line.strip())
    assert first.strip().startswith("Data: GENERATED, not measured")
    (conclusion,) = re.findall(r'<p class="verdict">([^<]*)</p>', page)
    assert conclusion.startswith(
        "The data is generated: the numbers only show that everything runs"
    )
    assert "sessions, the readings of whole fingers shift" not in conclusion


@pytest.mark.full
def test_report_needs_no_other_file(demo):
    page = (demo[0] / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(PICTURES)
    assert not re.search(r'(src|href)="(?!data:|#)', page)


@pytest.mark.full
def test_demo_resumes(demo):
    out, comparisons = demo
    runs = sorted((out / "runs").iterdir())
    before = {path: path.stat().st_mtime_ns for path in runs}
    runs[0].unlink()
    assert main([*SHORT, "--out", str(out)]) == 0
    assert [path for path in runs if path.stat().st_mtime_ns != before[path]] == runs[:1]
    again = json.loads((out / "comparisons.json").read_text())
    for first, second in zip(comparisons, again, strict=True):
        assert [m["scores"] for m in first["models"]] == [m["scores"] for m in second["models"]]


def test_official_test_has_as_many_trainings_as_the_others_have_folds():
    plans = {(p.readings, p.held_out): p.plan for p in demo_plans(demo_data(None, True), 2, 1, 1)}
    official = plans[READINGS[0], "official test"].experiments
    assert {(e.seed, e.fold) for e in official} == {(0, 0), (1, 0)}
    random = plans[READINGS[0], "random grasps"].experiments
    assert {(e.seed, e.fold) for e in random} == {(0, 0), (0, 1)}


@pytest.mark.full
def test_demo_refuses_one_fold(tmp_path, capsys):
    assert main(["demo", "--generated", "--folds", "1", "--out", str(tmp_path)]) == 1
    assert "'--folds' must be at least 2 (got 1)" in capsys.readouterr().err


def test_data_is_generated_without_a_network(monkeypatch, caplog):
    monkeypatch.setattr(BioTacSP, "url", "http://127.0.0.1:9")  # nobody listens there
    data = demo_data()
    assert data.kind == "generated"
    assert data.caption.startswith("Data: GENERATED")
    assert len(data.caption) < 90  # one line of the report
    assert "could not be downloaded" in caplog.text
    assert len(data.load()) == _demo._GENERATED_ARGUMENTS["num_samples"]


def test_loose_files_are_found_and_their_folder_is_left_unchanged(bts3_recordings):
    before = sorted(path.name for path in bts3_recordings.iterdir())
    for folder in (bts3_recordings, bts3_recordings.parent):
        data = demo_data(folder)
        assert data.kind == "measured"
        assert len(data.load()) == 4682
        train, test = data.with_arguments({"split": "all"}).parts(Protocol("given"), 0, 0)
        assert (len(train), len(test)) == (4682, 1149)
    assert sorted(path.name for path in bts3_recordings.iterdir()) == before
    assert data.arguments["root"] == str(default_root("BioTacSP"))


def test_root_of_the_data_set_is_found(bts3_root):
    assert demo_data(bts3_root).arguments["root"] == str(bts3_root)


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"'--root' must be a folder \(got '.*nowhere'\)"):
        demo_data(tmp_path / "nowhere")


def test_damaged_data_is_an_error_and_not_replaced_by_generated_data(write_bts3, tmp_path):
    write_bts3(tmp_path / "set" / "raw")
    with pytest.raises(ValueError, match="must have the SHA-256 checksum"):
        demo_data(tmp_path / "set")
