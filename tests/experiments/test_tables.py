from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.commands.table import _BACKENDS, _TABLES
from torch_geometric_tactile.experiments.tables import load_table, table_names
from torch_geometric_tactile.parallel import BACKENDS
from torch_geometric_tactile.training.config import expand_template


def published(name, key="accuracy"):
    return {cell.experiment: cell.published.get(key) for cell in load_table(name).cells}


def test_names_on_the_command_line_are_the_tables():
    assert tuple(table_names()) == _TABLES
    assert BACKENDS == _BACKENDS


@pytest.mark.parametrize("name", table_names())
def test_each_experiment_of_the_template_has_one_place(name):
    table = load_table(name)
    names = [cell.experiment for cell in table.cells]
    assert sorted(names) == sorted(expand_template(table.template))
    places = {(cell.section, cell.row, cell.column) for cell in table.cells}
    assert len(places) == len(names)
    classifier = expand_template(table.template)[names[0]]["model"]
    assert table.task == classifier.get("task", "multiclass")


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
    assert published("p2-table2", "spread")["x_pos"] == 1.23
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
    with pytest.raises(ValueError, match=r"'name' must be one of \['p1-table2'.*\(got 'p5'\)"):
        load_table("p5")
    with pytest.raises(ValueError, match=r"'only' must fit.*sparse, slanted.*\(got 'gcn_\*'\)"):
        load_table("p1-table3").select(["dense", "gcn_*"])


@pytest.mark.parametrize("name", table_names())
def test_list_prints_every_experiment_with_its_number(name, capsys):
    assert main(["table", name, "--list"]) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    for cell in load_table(name).cells:
        (line,) = [line for line in lines if line.startswith(f"{cell.experiment} ")]
        assert f"{cell.published['accuracy']:g}" in line
    assert "private recordings" in text


def test_unknown_table_is_refused_before_anything_is_imported(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["table", "p3-table1"])
    assert "invalid choice: 'p3-table1'" in capsys.readouterr().err


def test_data_file_is_shipped():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert '"experiments/*.yaml"' in text
