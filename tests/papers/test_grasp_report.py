import json
import re

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.papers._grasp_report import write_grasp_report
from torch_geometric_tactile.papers._grasp_table import grasp_table
from torch_geometric_tactile.training import TactileModule

PICTURES = ("confusion.png", "grasps.png", "protocols.png", "roc.png")
SHORT = ["demo", "--generated", "--seeds", "2", "--folds", "2", "--epochs", "1", "--jobs", "1"]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "report"
    assert main([*SHORT, "--out", str(out)]) == 0
    return out, json.loads((out / "metrics.json").read_text())


def test_demo_writes_every_file_whole(report):
    out, _ = report
    assert {path.name for path in out.iterdir()} == {
        "report.html",
        "metrics.json",
        "grasp_common_mode.ckpt",
        "runs",
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


def test_demo_says_what_to_conclude(report):
    out, content = report
    page = (out / "report.html").read_text()
    (verdict,) = re.findall(r'<p class="verdict">([^<]*)</p>', page)
    scores = [
        record["accuracy"]
        for record in content["results"]
        if (record["model"], record["protocol"], record["readings"])
        == ("TaxelNet", "unseen objects", "common mode, middle + thumb")
    ]
    assert verdict.startswith("The data is generated: the numbers show that everything runs")
    assert f"in {100 * sum(scores) / len(scores):.1f} % of the grasps" in verdict
    assert "600 grasps of" in page
    assert "unseen objects&#39;" not in page


def test_demo_page_needs_no_other_file(report):
    out, _ = report
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(PICTURES)
    assert not re.search(r'(src|href)="(?!data:|#)', page)


def test_demo_metrics_cover_models_protocols_readings_and_seeds(report):
    _, content = report
    keys = {(r["model"], r["protocol"], r["readings"], r["seed"]) for r in content["results"]}
    assert len(keys) == len(content["results"]) == 13 * (4 + 3) * 2
    assert content["data"]["generated"] is True
    assert (content["data"]["train_samples"], content["data"]["test_samples"]) == (2000, 600)
    assert (content["folds"], content["epochs"]) == (2, 1)
    by_key = {(r["model"], r["protocol"], r["readings"], r["seed"]): r for r in content["results"]}
    assert by_key["SVM", "random folds", "raw", 1]["num_samples"] == 2000  # the folds together
    palms = [f"palm {palm}" for palm in ("down", "side", "45")]
    assert sum(by_key["SVM", palm, "raw", 0]["num_samples"] for palm in palms) == 600
    assert all(0 <= record["f1_positive"] <= 1 for record in content["results"])


def test_demo_goes_on_where_it_was_stopped(report, capsys):
    out, content = report
    runs = sorted((out / "runs").iterdir())
    assert len(runs) == 13 * 2 * (2 + 2 + 2 * 3 + 1)
    before = {path: path.stat().st_mtime_ns for path in runs}
    runs[0].unlink()
    assert main([*SHORT, "--out", str(out)]) == 0
    assert sorted((out / "runs").iterdir()) == runs
    changed = [path for path in runs if path.stat().st_mtime_ns != before[path]]
    assert changed == runs[:1]
    assert json.loads((out / "metrics.json").read_text())["results"] == content["results"]
    text = capsys.readouterr().out
    assert "TaxelNet" in text
    assert "Edges: accuracy of TaxelNet with edges less that without" in text


def test_report_of_a_part_is_refused(tmp_path):
    plan = make_plan(grasp_table(generated=True), Settings(seeds=1))
    run = PlanRun(plan, [], 0, {}, len(plan.experiments))
    with pytest.raises(ValueError, match=r"'run' must be complete \(got 338 runs missing\)"):
        write_grasp_report(run, {}, tmp_path, 0.0)


def test_demo_keeps_the_model_that_it_judged(report):
    out, content = report
    (record,) = (
        r
        for r in content["results"]
        if (r["model"], r["protocol"], r["readings"], r["seed"])
        == ("TaxelNet", "unseen objects", "common mode, middle + thumb", 0)
    )
    assert content["checkpoint"]["accuracy"] == record["accuracy"]
    path = out / "grasp_common_mode.ckpt"
    classifier = TactileModule.load_from_checkpoint(path, weights_only=True)
    assert classifier.layout.name == "biotac_sp"
    assert isinstance(classifier.model, TaxelNet)


def test_demo_says_whether_edges_help(report):
    out, content = report
    accuracy = {}
    for record in content["results"]:
        if record["readings"] == "common mode, middle + thumb":
            accuracy.setdefault((record["model"], record["protocol"]), []).append(
                record["accuracy"]
            )
    assert list(content["edges"]) == [
        "random folds",
        "leave objects out",
        "objects and sessions",
        "unseen objects",
    ]
    for protocol, gain in content["edges"].items():
        with_edges = accuracy["TaxelNet", protocol]
        without = accuracy["TaxelNet without edges", protocol]
        # Of splits, which are not all of one size.
        assert gain["accuracy"] == pytest.approx((sum(with_edges) - sum(without)) / 2, abs=0.02)
    assert content["edges"]["unseen objects"]["verdict"] == "too few splits"  # two seeds
    page = (out / "report.html").read_text()
    assert "no verdict on fewer than 3 splits" in page
    assert "and edges change this" not in page  # nothing follows from generated data


def test_demo_refuses_one_fold(tmp_path, capsys):
    assert main(["demo", "--generated", "--folds", "1", "--out", str(tmp_path)]) == 1
    assert "'--folds' must be at least 2 (got 1)" in capsys.readouterr().err
