import json
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.commands.table import TABLES
from torch_geometric_tactile.experiments._building import check_arguments
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.papers import load_table, table_names
from torch_geometric_tactile.papers._table_numbers import table_numbers
from torch_geometric_tactile.training._config import find_config
from torch_geometric_tactile.training._config_files import expand_template


def published(name, key="accuracy"):
    return {cell.experiment: cell.published.get(key) for cell in load_table(name).cells}


def test_names_on_the_command_line_are_the_tables():
    assert tuple(table_names()) == TABLES


PAPERS = [name for name in table_names() if name.startswith(("p1", "p2"))]
REAL = ["p2-picks", "p2-icub"]
PAPERS = [name for name in PAPERS if name not in REAL]
OF_TEMPLATES = [name for name in PAPERS if not name.endswith("-scaling")]


@pytest.mark.parametrize("name", OF_TEMPLATES)
def test_each_experiment_of_the_template_has_one_place(name):
    table = load_table(name)
    (template,) = {cell.config.partition("/")[0] for cell in table.cells}
    names = [cell.experiment for cell in table.cells]
    assert sorted(names) == sorted(expand_template(template))
    places = {(cell.section, cell.row, cell.column) for cell in table.cells}
    assert len(places) == len(names)
    assert table.task == table.cells[0].configuration["model"].get("task", "multiclass")


@pytest.mark.parametrize("name", PAPERS)
def test_data_and_fractions_are_those_of_the_configurations(name):
    table = load_table(name)
    for cell in table.cells:
        settings = cell.configuration["data"]["dataset"]
        assert settings["class_path"] == table.data.class_path
        arguments = settings["init_args"]
        assert arguments["task"] == table.data.arguments["task"]
        assert arguments["tare"] == table.data.arguments["tare"]
        assert arguments["adjacency"] == cell.data.get("adjacency", "original")
        for entry in table.protocols:
            _, val, test = arguments["fractions"]
            assert (entry.protocol.val, entry.protocol.test) == (val, test)


def test_table_of_the_demo():
    table = load_table("bts3")
    assert len(table.cells) == 14
    two = "common mode, middle + thumb"
    kinds = {model: [c.column for c in table.cells if c.row == model] for model in table.rows}
    assert kinds == {
        "TaxelNet": [two, "common mode, then session, middle + thumb", "common mode, all fingers"],
        "TaxelNet without edges": [two],
        "SVM": [two, "common mode, all fingers", "session", "raw"],
        "LSTM": [two],
        "GCN-DF": [two, "session", "raw"],
        "GCN-FF": ["session"],
        "Majority": ["raw"],
    }
    for cell in table.cells:
        if cell.config is not None:
            config = cell.configuration["data"]
            assert config["dataset"]["class_path"] == table.data.class_path
            graph = config["dataset"]["init_args"].get("pre_transform")
            expected = table.data.arguments["pre_transform"] if "gcn" in cell.config else None
            assert graph == expected
        if cell.column == two and cell.config is not None:
            assert cell.transform == config["transform"]
    protocols = {entry.name: entry.protocol.describe() for entry in table.protocols}
    assert protocols == {
        "random folds": "5 folds by frame",
        "leave objects out": "5 folds by group",
        "objects and sessions": "5 folds by group, each session tested on unseen",
        "unseen objects": "the given parts",
    }
    check_arguments(table.data.class_path, table.data.arguments)
    assert not table.is_published


POSE = "torch_geometric_tactile.transforms.TaxelPose"


def poses(content):
    """The arguments of each TaxelPose in a configuration."""
    if isinstance(content, list):
        return [found for value in content for found in poses(value)]
    if not isinstance(content, dict):
        return []
    own = [content.get("init_args", {})] if content.get("class_path") == POSE else []
    return own + [found for value in content.values() for found in poses(value)]


@pytest.mark.parametrize(("name", "like"), [("sparsh-p1", "p1-table2"), ("sparsh-p2", "p2-table2")])
def test_a_table_like_another_has_its_models_on_other_data(name, like):
    table, other = load_table(name), load_table(like)
    places = [(c.section, c.row, c.column, c.experiment) for c in table.cells]
    assert places == [(c.section, c.row, c.column, c.experiment) for c in other.cells]
    assert table.orderings == other.orderings
    assert (table.paper, table.place, table.is_published) == ("", "", False)
    assert other.is_published
    assert (table.task, other.task) == ("multiclass", load_table(like).task)
    (protocol,) = table.protocols
    assert protocol.protocol.describe().startswith("by trial, 10 % for validation, 20 % for the")
    check_arguments(table.data.class_path, table.data.arguments)
    for cell, known in zip(table.cells, other.cells, strict=True):
        config, before = cell.configuration, known.configuration
        assert config["model"] == {**before["model"], "task": "multiclass"}
        assert config["trainer"] == before["trainer"]
        assert poses(config) == [{"layout": "allegro_uskin_368"}] * len(poses(before))
        assert not any(poses(before))
        assert bool(poses(config)) == (set(cell.column) & {"E", "A", "P"} != set())


def scaled(cell):
    parts = cell.configuration["data"]["transform"]["init_args"]["transforms"]
    scalers = [part.get("init_args", {}) for part in parts if part["class_path"].endswith("ZScore")]
    return {one["attr"]: one.get("scale_per") for one in scalers if one.get("attr") in GEOMETRY}


GEOMETRY = ("edge_attr", "absolute", "pos")


@pytest.mark.parametrize(
    ("name", "like", "letters"),
    [("p1-scaling", "p1-table2", "EA"), ("p2-scaling", "p2-table2", "P")],
)
def test_variants_of_a_table_scale_what_is_in_metres(name, like, letters):
    table, other = load_table(name), load_table(like)
    assert (table.paper, table.place, table.task) == (other.paper, other.place, other.task)
    by_name = {cell.experiment: cell for cell in table.cells}
    for cell in other.cells:
        first = by_name.pop(cell.experiment)
        assert (first.row, first.column) == (f"{cell.row}, {cell.column}", "in metres")
        assert (first.published, scaled(first)) == (cell.published, {})
        assert first.configuration == cell.configuration  # so that finished runs are used again
        num_geometric = len(set(cell.column) & set(letters))
        for suffix, scale_per in (("each", None), ("one", "all")) if num_geometric else ():
            variant = by_name.pop(f"{cell.experiment}_{suffix}")
            assert variant.row == first.row
            assert not variant.published
            assert set(scaled(variant).values()) == {scale_per}
            assert len(scaled(variant)) == num_geometric
            assert variant.configuration["model"] == first.configuration["model"]
    assert not by_name


@pytest.mark.parametrize("name", REAL)
def test_real_fingers_are_tared_and_segmented(name):
    table = load_table(name)
    assert not table.is_published
    check_arguments(table.data.class_path, table.data.arguments)
    names = list(expand_template("p2_pads"))
    if name == "p2-icub":  # its fingertips have no edge features
        names = [experiment for experiment in names if not experiment.endswith("_edge")]
    assert [cell.experiment for cell in table.cells] == names
    for cell in table.cells:
        config = cell.configuration
        tare, *_, last = config["data"]["transform"]["init_args"]["transforms"]
        assert tare["init_args"] == {"key": "trial", "first": 3}
        model = config["model"]["model"]["init_args"]
        assert model.get("segments") == ("digit" if cell.row == "I" else None)
        with_edges = cell.section == "with edge features"
        assert (model["inputs"] == ["tactile", "edge"]) == with_edges
        assert last["class_path"].endswith("GeometricEdgeAttr") == with_edges  # not scaled
        assert ("num_joints" in model) == (cell.section == "with joint angles")


def test_published_numbers_of_the_property_paper():
    values = published("p1-table2")
    assert values["mt_gcn_te_joint"] == max(values.values()) == 86.08
    assert values["cnn_a"] == min(values.values()) == 64.98
    assert (values["fnn_ta_joint"], values["gcn_tea"], values["gcn_ea_joint"]) == (
        79.15,
        85.09,
        81.56,
    )
    assert sum(values.values()) == pytest.approx(2916.2)
    assert published("p1-table3") == {
        "sparse": 84.79,
        "slanted": 85.23,
        "original": 86.08,
        "dense": 85.9,
    }


def test_published_numbers_of_the_segmentation_paper():
    assert published("p2-table2")["ii_tac_joint"] == 92.92
    assert published("p2-table2", "variance")["x_pos"] == 1.23
    assert published("p2-table2", "auc")["i_tac_pos_joint"] == 0.9523
    assert sum(published("p2-table2").values()) == pytest.approx(1562.39)
    assert sum(published("p2-table2", "auc").values()) == pytest.approx(16.6586)
    memory = published("p2-table4", "memory")
    tac_joint = [memory[name] for name in ("x_tac_joint", "i_tac_joint", "ii_tac_joint")]
    assert tac_joint == [1531, 752, 697]
    assert sum(memory.values()) == 17817


def test_columns_stand_in_the_order_of_the_paper():
    table = load_table("p1-table2")
    for section in table.sections:
        assert table.columns(section) == ["T", "E", "A", "T + E", "T + A", "E + A", "T + E + A"]
    assert table.rows == ["FNN", "CNN", "MT-CNN", "GCN", "MT-GCN"]


def test_selection_by_patterns():
    table = load_table("p1-table2")
    names = [cell.experiment for cell in table.select(["mt_*_joint", "fnn_t"])]
    assert names == ["fnn_t", "mt_cnn_ta_joint"] + [
        f"mt_gcn_{inputs}_joint" for inputs in ("te", "ta", "ea", "tea")
    ]
    assert table.select(None) == table.cells


def test_wrong_names_list_the_right_ones():
    with pytest.raises(ValueError, match=r"'name' must be one of \['p1-table2'.*\(got 'p9'\)"):
        load_table("p9")
    with pytest.raises(ValueError, match=r"'protocols' must be some of \['by trial', 'by frame'\]"):
        load_table("p1-table3").select_protocols(["frame", "object"])
    with pytest.raises(ValueError, match=r"'only' must match.*sparse, slanted.*\(got 'gcn_\*'\)"):
        load_table("p1-table3").select(["dense", "gcn_*"])


@pytest.mark.parametrize("name", table_names())
def test_list_prints_every_experiment_with_its_number(name, capsys):
    assert main(["table", name, "--list"]) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    for cell in load_table(name).cells:
        (line,) = [line for line in lines if line.startswith(f"{cell.experiment} ")]
        if cell.published:
            assert f"{cell.published['accuracy']:g}" in line
    table = load_table(name)
    assert (f"{table.recordings} recordings" in text) == table.is_published
    assert "Held out: " in text


def test_list_names_only_configurations_that_can_be_given(capsys):
    for name, there in (("p2-table2", True), ("sparsh-p2", False)):
        main(["table", name, "--list"])
        assert ("tactile fit --config" in capsys.readouterr().out) == there


def test_protocols_by_their_names():
    table = load_table("p1-table2")
    assert [entry.name for entry in table.select_protocols(["frame"])] == ["by frame"]
    assert table.select_protocols(["by frame", "trial"]) == table.protocols
    assert table.select_protocols(None) == table.protocols


def test_unknown_table_is_refused_before_anything_is_imported(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["table", "p3-table1"])
    assert "invalid choice: 'p3-table1'" in capsys.readouterr().err


OWN = """
title: Mine
data:
  class_path: torch_geometric_tactile.datasets.FakeTactileDataset
  init_args:
    num_samples: 40
    num_objects: 4
    pre_transform: {class_path: torch_geometric_tactile.transforms.KNNGraph, init_args: {k: 2}}
protocols:
  four folds: {by: frame, folds: 4, stratify: y}
seeds: 2
measure_memory: false
cells:
  - row: GCN
    config: mine/gcn.yaml
  - row: SVM
    estimator: {class_path: torch_geometric_tactile.baselines.GraspSVM}
    transform: {class_path: torch_geometric_tactile.transforms.ZScore}
"""


@pytest.fixture
def own_table(tmp_path):
    """The file of a table that a user wrote, beside the configuration of a model."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "gcn.yaml").write_text(find_config("grasp_gcn_df").read_text())
    (tmp_path / "mine.yaml").write_text(OWN)
    return tmp_path / "mine.yaml"


def test_own_table_is_run_and_written(own_table, tmp_path, capsys):
    arguments = ["table", str(own_table), "--out", str(tmp_path / "out"), "--epochs", "1"]
    assert main(arguments) == 0
    assert "mine: 16 of 16 runs finished" in capsys.readouterr().out
    page = (tmp_path / "out" / "mine.md").read_text()
    assert page.startswith("# Mine\n\nYour own recordings: 40 ")
    assert "Held out: four folds: 4 folds by frame, stratified by y, pooled" in page
    assert "after 1 epoch (Adam, learning rate 0.01, batches of 256" in page
    assert "Published" not in page
    assert main([*arguments, "--no-train"]) == 0
    assert "(16 kept from before)" in capsys.readouterr().out


def test_a_configuration_may_be_in_the_table(own_table):
    by_name = load_table(str(own_table)).cells[0]
    own_table.write_text(OWN.replace("mine/gcn.yaml", json.dumps(by_name.configuration)))
    inside = load_table(str(own_table)).cells[0]
    assert isinstance(inside.config, dict)
    assert inside.configuration == by_name.configuration


def test_folds_are_pooled_before_they_are_scored(own_table, tmp_path):
    plan = make_plan(load_table(str(own_table)), Settings(seeds=1))
    run = run_plan(plan, tmp_path, only=["SVM"])
    (accuracy,) = [n for n in table_numbers(run) if (n.experiment, n.metric) == ("SVM", "accuracy")]
    parts = [result["metrics"]["accuracy"] * result["num_test"] for _, result in run.results]
    assert accuracy.runs == 1
    assert accuracy.mean == pytest.approx(100 * sum(parts) / 40)
    one_missing = run._replace(results=run.results[1:])
    assert not [n for n in table_numbers(one_missing) if n.metric == "accuracy"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("title: Mine", "shows: speed\ntitle: Mine", "'shows' must be one of"),
        ("title: Mine", "see_also: 3\ntitle: Mine", r"'see_also' of table .* a text \(got 3\)"),
        (
            "title: Mine",
            "titel: Mine",
            r"table 'mine' cannot be read: a key of a table must .*got 'titel'",
        ),
        ("protocols:", "protocolls:", "table 'mine' must have 'protocols'"),
        ("row: SVM", "row: GCN", "'cells' of table 'mine' must have different names"),
        ("    config: mine/gcn.yaml", "", "'GCN' must have either a 'config' or an 'estimator'"),
        ("by: frame", "bye: frame", r"a protocol must have keys of .*\(got 'bye'\)"),
    ],
)
def test_wrong_files_are_explained(own_table, old, new, message):
    own_table.write_text(OWN.replace(old, new))
    with pytest.raises(ValueError, match=message):
        load_table(str(own_table))


def test_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match="none"):
        load_table(str(tmp_path / "none.yaml"))


def test_data_file_is_shipped():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert '"papers/*.yaml"' in text


def test_list_of_an_own_table_names_no_training_on_other_data(own_table, capsys):
    assert main(["table", str(own_table), "--list"]) == 0  # the configuration is for BioTacSP
    assert "tactile fit" not in capsys.readouterr().out
    text = OWN.replace("FakeTactileDataset", "BioTacSP").replace("num_samples: 40", "split: null")
    own_table.write_text(text.replace("num_objects: 4", "root: null"))
    assert main(["table", str(own_table), "--list"]) == 0
    assert "tactile fit --config" in capsys.readouterr().out
