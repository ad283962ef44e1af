import csv
import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.plan import Plan, PlanRun
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.source import DataFacts
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.papers._table_caption import NO_NUMBER
from torch_geometric_tactile.papers._table_numbers import table_numbers
from torch_geometric_tactile.papers._table_part import selected_part
from torch_geometric_tactile.papers.write_table import (
    _runs_csv,
    csv_text,
    markdown,
    write_table,
)

CAPTION = (
    "**Simulated**, not a result of a real hand: 80 trials of `tactile simulate` (objects "
    "`paper8`, seed 1, 17 s at 100 Hz, MuJoCo 3)."
)


# Class 0 is found in one of two, class 1 in two of two.
SAID = Predictions(np.eye(2)[[0, 1, 1, 1]], np.array([0, 1, 1, 1]), np.array([0, 0, 1, 1]))


def result(metrics, memory=100.0, labels=None):
    return {
        "metrics": metrics,
        "label_names": labels,
        "predictions": SAID.to_dict(),
        "num_train": 600,
        "num_test": 300,
        "frames_per_second": 1000.0,
        "peak_memory_mb": memory,
        "measures": "resident memory of the process",
        "num_parameters": 4_488_808,
        "train_seconds": 12.0,
        "seconds": 15.0,
        "machine": "a machine, 2 cores",
    }


def run(name, entries, seeds=2, split_by=("trial", "frame")):
    """A run with results for (experiment, split, seed): result."""
    table = load_table(name)
    protocols = table.select_protocols(split_by)
    data = replace(table.data, kind="simulated", caption=CAPTION, selection={"stride": 20})
    experiments = {}
    for seed in range(seeds):
        for protocol in protocols:
            for cell in table.cells:
                config = cell.configuration
                experiments[cell.experiment, protocol.name, seed] = Experiment(
                    cell.experiment,
                    data,
                    protocol.protocol,
                    protocol.name,
                    config["model"],
                    seed=seed,
                    epochs=3,
                    batch_size=config["data"]["batch_size"],
                )
    facts = DataFacts(7000, 80, 8, 8)
    plan = Plan(table, protocols, seeds, data, facts, tuple(experiments.values()))
    results = [
        (experiments.get((cell, split, seed)) or experiments[cell, f"by {split}", seed], value)
        for (cell, split, seed), value in entries.items()
    ]
    return PlanRun(plan, results, 0, {}, len(experiments) - len(results))


@pytest.fixture
def objects():
    """Two seeds of II with touch and joint angles by trial, one by frame; X by trial once."""
    name = "ii_tac_joint"
    return run(
        "p2-table2",
        {
            (name, "trial", 0): result({"accuracy": 0.80, "f1": 0.7, "auroc": 0.9}, 60.0),
            (name, "trial", 1): result({"accuracy": 0.84, "f1": 0.8, "auroc": 0.94}, 64.0),
            (name, "frame", 0): result({"accuracy": 0.99, "f1": 0.9, "auroc": None}, 62.0),
            ("x_tac_joint", "trial", 0): result({"accuracy": 0.5, "f1": 0.5, "auroc": 0.6}, 124.0),
        },
    )


def rows_of(page, heading):
    """The cells of the lines of the first table below a heading."""
    part = page.split(f"## {heading}\n")[1].split("\n## ")[0]
    return [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in part.splitlines()
        if "|" in line
    ]


def test_markdown_by_hand(objects):
    header, _, *rows = rows_of(markdown(objects), "Accuracy in %, with joint angles")
    assert header == ["model", "", "Tac", "Pos", "Tac, Pos"]
    assert rows[0] == [
        "X",
        "published, real hand, private data",
        "88.66 (variance 0.18)",
        "85.81 (variance 0.02)",
        "91.01 (variance 0.38)",
    ]
    assert rows[1] == ["", "simulated, by trial", "50.0 (1 of 2)", NO_NUMBER, NO_NUMBER]
    assert rows[2] == ["", "simulated, by frame", NO_NUMBER, NO_NUMBER, NO_NUMBER]
    # The standard deviation of 80 and 84 is 2.83.
    assert rows[7] == ["", "simulated, by trial", "82.0 ± 2.8", NO_NUMBER, NO_NUMBER]
    assert rows[8] == ["", "simulated, by frame", "99.0 (1 of 2)", NO_NUMBER, NO_NUMBER]
    auc = rows_of(markdown(objects), "Area under the ROC curve, with joint angles")
    assert auc[12][2:] == ["0.9599", "0.9232", "0.9549"]
    assert auc[13][1:] == ["simulated, by trial: of scores", "0.920 ± 0.028", NO_NUMBER, NO_NUMBER]
    decided = "0.750 ± 0.000"  # one corner at a false-positive rate of 0 or 0.5
    assert auc[14][1:] == ["simulated, by trial: of decisions", decided, NO_NUMBER, NO_NUMBER]
    assert auc[15][2:] == [NO_NUMBER] * 3  # it was not a number
    assert "17 of 18 published areas are 1 - 0.571 · (1 - accuracy)" in markdown(objects)
    f1 = rows_of(markdown(objects), "F1 score in %, with joint angles")
    assert [row[1] for row in f1[2:4]] == ["simulated, by trial", "simulated, by frame"]
    costs = rows_of(markdown(objects), "Cost of the models")
    assert ["`p2_table2/ii_tac_joint`", "4,488,808", "1,000", "62 ± 2", "12.0"] in costs


def test_caption_tells_what_the_numbers_are(objects):
    caption = markdown(objects).splitlines()[2]
    for fact in (
        "Published: Tables II and III of *Multifingered Object Recognition",
        "its recordings are private",
        "**Simulated**, not a result of a real hand: 80 trials of `tactile simulate`",
        "objects `paper8`, seed 1, 17 s at 100 Hz, MuJoCo 3",
        "Seeds 0 to 1 of split and training",
        "Split: 60 % training, 10 % validation (unused), 30 % test. Tested once, after 3 epochs",
        "Adam, learning rate 0.001, batches of 32",
        "Every 20th frame: 7,000 in all; 600 to train and 300 to test by trial;",
        ". The mean of each trial's readings in the phase hover is subtracted.",
        "Hardware: a machine, 2 cores.",
        "**68 of 72 runs are missing**",
    ):
        assert fact in caption


def test_caption_names_each_library_once(objects, monkeypatch):
    versions = {
        "ii_tac_joint": {"torch": "2.13", "numpy": "2.1"},
        "x_tac_joint": {"lightning": "2.6", "torch": "2.13"},
    }
    monkeypatch.setattr(Experiment, "identity", lambda e: {"versions": versions.get(e.name, {})})
    assert " lightning 2.6, numpy 2.1, torch 2.13. " in markdown(objects).splitlines()[2]


def test_page_points_to_the_same_models_on_real_grasps():
    lines = markdown(run("p3-k", {}, split_by=["random"])).splitlines()
    assert load_table("p3").see_also == load_table("p3-k").see_also
    (line,) = (line for line in lines if line.startswith("See also: "))
    assert "`tactile table bts3` trains SVM, LSTM and GCN-DF on real grasps, with one frame" in line
    assert {"SVM", "LSTM", "GCN-DF"} <= set(load_table("bts3").rows)
    assert lines.index(line) < lines.index("## Accuracy in %")


def test_rank_correlation_with_the_published_accuracies():
    models = ("x_pos", "i_pos", "x_tac", "i_tac", "ii_tac")  # in the order of the paper
    for ranks, shown in ((range(5), "1.00"), (range(5, 0, -1), "-1.00"), ([1] * 5, None)):
        entries = {
            (name, "trial", 0): result({"accuracy": rank / 10})
            for name, rank in zip(models, ranks, strict=True)
        }
        page = markdown(run("p2-table2", entries, split_by=("trial",), seeds=1))
        if shown is None:
            assert "Rank correlation" not in page
        else:
            assert f"no relation): {shown} over 5 models (by trial)." in page
        del entries["x_tac", "trial", 0]
        assert "Rank correlation" not in markdown(run("p2-table2", entries, seeds=1))


def test_rank_correlation_with_the_columns():
    entries = {(f"df_k{k}", "random", 0): result({"accuracy": 0.9 - 0.01 * k}) for k in range(1, 7)}
    entries |= {(f"ff_k{k}", "random", 0): result({"accuracy": 0.8}) for k in range(1, 5)}
    page = markdown(run("p3-k", entries, split_by=("random",), seeds=1))
    assert "neighbours k of each electrode: GCN-DF -1.00 (random).\n" in page


def test_page_of_a_table_that_points_nowhere(objects):
    assert "See also" not in markdown(objects)


def test_property_table_counts_labels_two_ways():
    names = ["light", "heavy"]
    metrics = {"accuracy": 0.25, "label_accuracy": 0.5, "label_accuracy_0": 0.75}
    entries = {("gcn_t", "trial", 0): result({**metrics, "f1": 0.5, "auroc": 0.5}, labels=names)}
    page = markdown(run("p1-table2", entries, split_by=("trial",), seeds=1))
    rows = rows_of(page, "Accuracy in %, without joint angles")
    gcn = next(i for i, row in enumerate(rows) if row[0] == "GCN")
    assert "batches of 32 or 128" in page  # fewer steps of the FNNs
    assert rows[gcn][2] == "79.47"
    assert rows[gcn + 1][1:4] == ["simulated, by trial: all labels right", "25.0", NO_NUMBER]
    assert rows[gcn + 2][1:4] == ["simulated, by trial: mean of the labels", "50.0", NO_NUMBER]
    assert rows[2][:5] == ["FNN", "published, real hand, private data", "73.52", "", "75.44"]
    numbers = {n.metric: n.mean for n in table_numbers(run("p1-table2", {}))}
    assert numbers == {"accuracy": pytest.approx(85.57)}  # of the last cell
    assert "label_accuracy: light,75" in csv_text(run("p1-table2", entries)).replace(".0,", ",")


def test_memory_table_has_ratios():
    entries = {
        ("x_tac_joint", "trial", 0): result({}, 124.0),
        ("ii_tac_joint", "trial", 0): result({}, 60.0),
        ("ii_tac_joint", "frame", 0): result({}, 64.0),
    }
    page = markdown(run("p2-table4", entries))
    memory = rows_of(page, "Peak memory in MB, with joint angles")
    assert memory[2][2:] == ["1,531", "1,537", "1,488"]
    assert memory[3][1:] == [
        "simulated, resident memory of the process",
        "124",
        NO_NUMBER,
        NO_NUMBER,
    ]
    assert memory[7][2] == "62 ± 3"
    ratio = rows_of(page, "Memory relative to X, with joint angles")
    assert [row[2] for row in ratio[2:]] == ["1.00", "1.00", "0.49", NO_NUMBER, "0.46", "0.50"]


def test_csv_by_hand(objects):
    rows = list(csv.DictReader(csv_text(objects).splitlines()))
    mine = [row for row in rows if row["experiment"] == "ii_tac_joint"]
    values = {(row["source"], row["metric"]): row for row in mine}
    published = values["published", "accuracy"]
    assert (published["mean"], published["sd"], published["runs"]) == ("92.92", "", "")
    assert values["published", "variance"]["mean"] == "0.09"
    assert published["data"] == "real hand, private"
    assert values["published", "peak_memory_mb"]["mean"] == "697"
    ours = values["by trial", "accuracy"]
    assert (float(ours["mean"]), ours["runs"], ours["data"]) == (82.0, "2", "simulated")
    assert float(ours["sd"]) == pytest.approx(math.sqrt(8), rel=1e-5)
    assert values["by frame", "accuracy"]["sd"] == ""
    assert ("by frame", "auroc") not in values
    assert (ours["section"], ours["row"]) == ("with joint angles", "II")


def test_names_of_others_are_shown_and_are_nothing_else(objects):
    evil = "=a|<b>\n`c`\x1b"
    cells = [replace(cell, row=evil) for cell in objects.plan.table.cells]
    table = replace(objects.plan.table, cells=tuple(cells), title="Of\n# others")
    named = objects._replace(plan=replace(objects.plan, table=table))
    page = markdown(named)
    assert page.startswith("# Of\\n# others\n")
    assert all(line.isprintable() for line in page.split("\n"))
    assert r"| =a\|\<b\>\\n\`c\`\\x1b | published, " in page
    rows = list(csv.DictReader(csv_text(named).split("\n")))
    assert rows[0]["row"].startswith("'=a|<b>")


def test_own_recordings_are_not_called_simulated(objects):
    data = replace(objects.plan.data, kind="measured", caption="Recordings of your own: 80 trials.")
    page = markdown(objects._replace(plan=replace(objects.plan, data=data)))
    assert "Recordings of your own: 80 trials." in page
    assert "measured, by trial" in page
    assert "imulated" not in page


def test_each_run_has_a_line(objects):
    rows = list(csv.DictReader(_runs_csv(objects).splitlines()))
    shown = [(r["experiment"], r["protocol"], r["seed"], r["accuracy"], r["auroc"]) for r in rows]
    assert shown == [
        ("x_tac_joint", "by trial", "0", "50", "0.6"),
        ("ii_tac_joint", "by trial", "0", "80", "0.9"),
        ("ii_tac_joint", "by trial", "1", "84", "0.94"),
        ("ii_tac_joint", "by frame", "0", "99", ""),
    ]
    assert [row["peak_memory_mb"] for row in rows] == ["124", "60", "64", "62"]


def test_table_without_any_run_is_written(tmp_path):
    nothing = run("p1-table3", {})
    paths = write_table(nothing, tmp_path)
    suffixes = (".md", ".csv", ".png", "-runs.csv", "-orderings.csv")
    assert [path.name for path in paths] == [f"p1-table3{suffix}" for suffix in suffixes]
    assert "**16 of 16 runs are missing**" in paths[0].read_text()
    assert "Hardware: none yet." in paths[0].read_text()
    assert paths[2].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["p1-table2", "p2-table2", "p2-table4"])
def test_pictures_are_drawn_of_all_kinds(name, tmp_path):
    metrics = {"accuracy": 0.9, "label_accuracy": 0.95, "f1": 0.9, "auroc": 0.97}
    entries = {
        (cell.experiment, split, seed): result(
            {**metrics, "accuracy": 0.9 - 0.1 * seed}, 100 + seed
        )
        for cell in load_table(name).cells
        for split in ("trial", "frame")
        for seed in range(2)
    }
    paths = write_table(run(name, entries), tmp_path)
    assert paths[2].stat().st_size > 20_000
    assert NO_NUMBER not in paths[0].read_text()


def with_data(whole, of_cell, **of_table):
    """The run with arguments of the table's data set, and others for some cells."""
    plan, renamed = whole.plan, {}
    data = replace(plan.data, selection={}, arguments={**plan.data.arguments, **of_table})
    cells = tuple(replace(c, data=of_cell.get(c.experiment, {})) for c in plan.table.cells)
    for e in plan.experiments:
        own = {**data.arguments, **of_cell.get(e.name, {})}
        renamed[e.code] = replace(e, data=replace(data, arguments=own))
    table = replace(plan.table, data=data, cells=cells)
    plan = replace(plan, table=table, data=data, experiments=tuple(renamed.values()))
    return whole._replace(plan=plan, results=[(renamed[e.code], r) for e, r in whole.results])


def test_caption_tells_of_arguments_of_the_table(objects):
    given = {"stride": 10, "phases": ["lift", "hold"], "rate": 30.0, "samples_per_trial": 25}
    caption = markdown(with_data(objects, {}, **given)).splitlines()[2]
    assert (
        "25 of each trial, drawn from every 10th frame at 30 Hz of the phases lift, hold: 7,000 in "
        "all; 600 to train and 300 to test by trial" in caption
    )


def test_caption_tells_of_arguments_of_a_shown_data_set(objects):
    inner = {"class_path": "a.B", "init_args": {"stride": 3, "root": "x"}}
    caption = markdown(with_data(objects, {}, dataset=inner)).splitlines()[2]
    assert "Every 3rd frame: 7,000 in all" in caption


def test_caption_and_costs_tell_of_data_of_a_cell(objects):
    page = markdown(with_data(objects, {"x_tac_joint": {"stride": 5}}))
    assert (
        "Every frame: 7,000 in all; 600 to train and 300 to test by trial; 600 to train and 300 to "
        "test by frame. Every 5th frame for x_tac_joint: 600 to train and 300 to test by trial."
        in page.splitlines()[2]
    )
    names = [row[0] for row in rows_of(page, "Cost of the models")]
    assert "`x_tac_joint`" in names
    assert "`p2_table2/ii_tac_joint`" in names


def test_two_models_of_one_configuration_have_a_row_of_costs_each(objects):
    plan = objects.plan
    first = next(c for c in plan.table.cells if c.experiment == "x_tac_joint")
    cells = tuple(
        replace(c, config=first.config) if c.experiment == "ii_tac_joint" else c
        for c in plan.table.cells
    )
    whole = objects._replace(plan=replace(plan, table=replace(plan.table, cells=cells)))
    costs = {row[0]: row[1:] for row in rows_of(markdown(whole), "Cost of the models")}
    assert costs["`ii_tac_joint`"][2] == "62 ± 2"
    assert costs["`x_tac_joint`"][2] == "124"
    # The same code is one model: two places of it share a row.
    mine = next(e for e in plan.experiments if e.name == "x_tac_joint")
    same = tuple(
        replace(e, model=mine.model) if e.name == "ii_tac_joint" else e for e in plan.experiments
    )
    whole = whole._replace(plan=replace(whole.plan, experiments=same))
    names = [row[0] for row in rows_of(markdown(whole), "Cost of the models")]
    assert names.count("`p2_table2/x_tac_joint`") == 1
    assert "`ii_tac_joint`" not in names


def test_table_of_the_models_that_were_asked_for(objects):
    part = selected_part(objects, ["i_*"])
    rows = rows_of(markdown(part), "Cost of the models")
    names = {row[0].strip("`").rpartition("/")[2] for row in rows[2:]}
    asked = {c.experiment for c in objects.plan.table.cells if c.experiment.startswith("i_")}
    assert names == asked | {"ii_tac_joint", "x_tac_joint"}  # and those with runs
    total = 4 * len(names)
    assert f"**{total - 4} of {total} runs are missing**" in markdown(part)
    assert selected_part(objects, None) is objects
