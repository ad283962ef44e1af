import csv
import json
from contextlib import nullcontext

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
import yaml

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.sensors import allegro_uskin
from torch_geometric_tactile.training import classifier_from_config
from torch_geometric_tactile.training._config import config_names, find_config, load_config
from torch_geometric_tactile.training._config_files import TEMPLATES, expand_template, merged
from torch_geometric_tactile.training._sizes import DataSizes, fill_sizes

HANDS = ["p1_table2", "p1_table3", "p2_table2"]
NAMES = [(template, name) for template in HANDS for name in expand_template(template)]
# The inputs of an experiment by its name, and what a forward pass must be given for each.
P1_INPUTS = {"t": None, "e": "edge_attr", "a": "absolute"}
P2_INPUTS = {"tac": None, "pos": "pos"}


def recordings(config):
    """The sizes of the recordings that a configuration asks for."""
    settings = config["data"]["dataset"]["init_args"]
    layout = allegro_uskin()
    return DataSizes(
        layout=layout,
        in_channels=3,
        num_outputs={"property": 6, "object": 8}[settings["task"]],
        num_edges=layout.edge_index(settings["adjacency"]).size(1),
        num_joints=16,
        channels={"tactile": 3, "edge": 4, "absolute": 4, "position": 3},
    )


@pytest.mark.parametrize(("template", "count"), [("p1_table2", 36), ("p1_table3", 4)])
def test_property_templates_have_as_many_different_models_as_the_paper(template, count):
    configs = expand_template(template)
    assert len({json.dumps(config, sort_keys=True) for config in configs.values()}) == count
    assert all(
        config["data"]["dataset"]["init_args"]["task"] == "property" for config in configs.values()
    )


def test_kinds_of_models_are_as_many_as_the_paper_counts():
    names = list(expand_template("p1_table2"))
    kinds = [name.split("_")[0] if "mt_" not in name else name[:6].rstrip("_") for name in names]
    counts = {kind: kinds.count(kind) for kind in sorted(set(kinds))}
    assert counts == {"cnn": 6, "fnn": 6, "gcn": 14, "mt_cnn": 2, "mt_gcn": 8}  # 22 GCN, 8 CNN


def test_segmentation_template_has_18_different_models():
    configs = expand_template("p2_table2")
    assert len({json.dumps(config, sort_keys=True) for config in configs.values()}) == 18
    fractions = {tuple(c["data"]["dataset"]["init_args"]["fractions"]) for c in configs.values()}
    assert fractions == {(0.6, 0.1, 0.3)}


def expected_input(template, name):
    """The printed input of the fully connected layers, and the modalities by name."""
    joint = name.endswith("_joint") or template == "p1_table3"
    stem = "mt_gcn_te" if template == "p1_table3" else name.removesuffix("_joint")
    if template == "p2_table2":
        inputs = [P2_INPUTS[key] for key in stem.split("_")[1:]]
        size = 2688
    else:
        kind, _, letters = stem.rpartition("_")
        inputs = [P1_INPUTS[key] for key in letters]
        size = 2688 * len(letters) if kind.startswith("mt_") else 2688
        if kind == "fnn":
            size = 384 * sum({"t": 3, "a": 4}[key] for key in letters)
    wanted = {key for key in inputs if key} | ({"joint"} if joint else set())
    return size + (16 if joint else 0), wanted


@pytest.mark.parametrize(("template", "name"), NAMES)
def test_experiment_builds_its_model_with_the_printed_size_and_inputs(template, name):
    config = expand_template(template)[name]
    filled = fill_sizes(config["model"], recordings(config))
    if name.startswith("fnn"):  # needs no geometry, which cannot be read on the meta device
        arguments = filled["model"]["init_args"]
        arguments.update({"layout": 384} if "layout" in arguments else {})
    # 155 million parameters of an FNN need not be there to be counted.
    with torch.device("meta") if name.startswith("fnn") else nullcontext():
        classifier = classifier_from_config(filled)
    size, modalities = expected_input(template, name)
    assert classifier.model.head.in_channels == size
    assert set(classifier.model.modalities) == modalities
    p1 = template.startswith("p1")
    assert (classifier.num_classes, classifier.task) == (
        (6, "multilabel") if p1 else (8, "multiclass")
    )
    parts = [part["class_path"].rpartition(".")[2] for part in _parts(config)]
    needed = {"edge_attr": "GeometricEdgeAttr", "absolute": "AbsoluteMorphology"}
    wanted = {needed[name] for name in modalities if name in needed}
    wanted |= {"TaxelPose"} if modalities - {"joint"} else set()
    assert set(parts) - {"ZScore"} == wanted  # nothing is computed in vain


def _parts(config):
    return config["data"]["transform"]["init_args"]["transforms"]


@pytest.mark.parametrize(("template", "name"), NAMES)
def test_touch_is_tared_and_scaled_and_geometry_is_in_metres(template, name):
    config = expand_template(template)[name]
    for key in ("dataset", "val_dataset", "test_dataset"):
        assert config["data"][key]["init_args"]["tare"] == "hover"
    scales = [part.get("init_args", {}) for part in _parts(config) if "ZScore" in str(part)]
    per = {scale.get("attr", "x"): scale.get("per", "taxel") for scale in scales}
    assert per.pop("x", "channel") == "channel"
    assert per.pop("joint", "taxel") == "taxel"  # each joint has a range of its own
    assert not per  # edge features and positions are in metres, as the papers print them


@pytest.mark.parametrize(
    ("name", "edges"), [("sparse", 1000), ("slanted", 1184), ("original", 1401), ("dense", 2488)]
)
def test_encoder_has_the_edges_of_the_adjacency(name, edges):
    config = expand_template("p1_table3")[name]
    parts = [config["data"][key]["init_args"] for key in ("dataset", "val_dataset", "test_dataset")]
    assert [part["adjacency"] for part in parts] == [name] * 3
    assert [part["split"] for part in parts] == ["train", "val", "test"]
    filled = fill_sizes(config["model"], recordings(config))
    assert filled["model"]["init_args"]["num_edges"] == edges


@pytest.mark.parametrize("template", TEMPLATES)
def test_templates_type_no_size(template):
    text = json.dumps(expand_template(template))
    for name in ("num_edges", "num_nodes", "out_channels", "num_classes", "in_channels"):
        assert name not in text


def test_original_adjacency_is_the_model_of_the_other_table():
    assert (
        expand_template("p1_table3")["original"] == expand_template("p1_table2")["mt_gcn_te_joint"]
    )


def test_expansion_can_be_changed_without_harm():
    expand_template("p2_table2")["x_tac"]["trainer"]["max_epochs"] = 3
    assert expand_template("p2_table2")["x_tac"]["trainer"]["max_epochs"] == 50


def test_lists_are_replaced_and_mappings_joined():
    base = {"a": {"b": 1, "c": [1, 2]}, "d": None}
    assert merged(base, {"a": {"c": [3]}, "d": {"e": 2}}) == {
        "a": {"b": 1, "c": [3]},
        "d": {"e": 2},
    }
    assert base == {"a": {"b": 1, "c": [1, 2]}, "d": None}


def test_experiment_is_found_by_name():
    path = find_config("p1_table2/gcn_te")
    assert path.name == "gcn_te.yaml"
    assert find_config("p1_table2/gcn_te") == path
    assert "&" not in path.read_text().partition("\n")[2]  # no aliases: to be read and edited
    assert yaml.safe_load(path.read_text()) == load_config("p1_table2/gcn_te")
    assert load_config("p1_table2/gcn_te") == expand_template("p1_table2")["gcn_te"]


def test_templates_are_the_files_with_experiments():
    assert not set(TEMPLATES) & set(config_names())
    assert all("experiments" not in load_config(name) for name in config_names())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("p1_table2/gcn_x", r"'p1_table2' has no 'gcn_x'; choose p1_table2/NAME.*gcn_tea_joint"),
        ("p1_table3", r"'p1_table3' is a template; choose p1_table3/NAME with one of: sparse"),
        ("p9/x", r"no file 'p9/x'.*templates p1_table2, p1_table3, p2_table2"),
    ],
)
def test_unknown_experiment_lists_what_there_is(name, message):
    with pytest.raises(FileNotFoundError, match=message):
        find_config(name)


def test_unknown_template():
    with pytest.raises(ValueError, match=r"'template' must be one of .* \(got 'p3'\)"):
        expand_template("p3")


@pytest.mark.full
def test_experiment_trains_by_fit(grasps, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    keys = ("dataset", "val_dataset", "test_dataset")
    roots = [f"--data.{key}.init_args.root={grasps}" for key in keys]
    short = ["--trainer.max_epochs=1", "--trainer.accelerator=cpu"]
    short += ["--trainer.enable_progress_bar=false", "--trainer.enable_model_summary=false"]
    assert main(["fit", "--config", "p2_table2/ii_tac_pos_joint", *roots, *short]) == 0
    log = tmp_path / "runs" / "ii_tac_pos_joint" / "version_0" / "metrics.csv"
    with log.open() as file:
        rows = list(csv.DictReader(file))
    assert any(row["val/accuracy"] for row in rows)
