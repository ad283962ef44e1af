"""Tables that users write."""

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.experiments import read_table
from torch_geometric_tactile.experiments._experiment import Choice

TEXT = """
title: mine
data: {class_path: my_glove.Gloves}
protocols: {by trial: {by: trial, folds: 3}}
cells:
  - row: SVM
    estimator: {class_path: torch_geometric_tactile.baselines.linear_svm}
    choice: CHOICE
"""


def test_settings_of_a_cell_are_chosen(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(TEXT.replace("CHOICE", "{settings: [{init_args: {C: 0.1}}, {}], members: 2}"))
    (cell,) = read_table(path).cells
    assert isinstance(cell.choice, Choice)
    assert cell.choice.settings == [{"init_args": {"C": 0.1}}, {}]
    assert cell.choice.members == 2


@pytest.mark.parametrize(
    ("choice", "match"),
    [
        ("{metric: f1}", r"own.yaml': table 'own' cannot be read: 'metric' must be one of"),
        ("{setting: []}", r"a key of a 'choice' must be one of settings, .*got 'setting'"),
    ],
)
def test_wrong_choice_is_refused(choice, match, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(TEXT.replace("CHOICE", choice))
    with pytest.raises(ValueError, match=match):
        read_table(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("epochs: 5", r"a table must not have 'epochs' \(got 5\): .*'max_epochs' .*'--epochs'"),
        ("seed: 5", r"a key of a table must be one of title, .*seeds.*\(got 'seed'\)"),
        ("orderings: A above B", "an entry of 'orderings' must have a 'name' and 'pairs'"),
        ("orderings: [{name: a, pair: [A, B]}]", r"'pairs' of experiments.*got .*'pair'"),
        ("orderings: [{name: a, pairs: [A, B]}]", r"'pairs' of experiments.*got .*'A'"),
        ("orderings: [{name: a, pairs: []}]", r"'pairs' of 'a' must hold at least one pair"),
    ],
)
def test_keys_of_a_table_are_named_in_errors(tmp_path, line, message):
    path = tmp_path / "own.yaml"
    path.write_text(
        "title: A\ndata: {class_path: torch_geometric_tactile.datasets.FakeTactileDataset}\n"
        "protocols: {by trial: {by: trial}}\n"
        "cells: [{row: A, estimator: {class_path: sklearn.svm.SVC}}]\n" + line
    )
    with pytest.raises(ValueError, match=message):
        read_table(path)


def test_epochs_of_a_cell_are_those_of_its_configuration(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(
        "title: A\ndata: {class_path: torch_geometric_tactile.datasets.FakeTactileDataset}\n"
        "protocols: {by trial: {by: trial}}\ncells: [{row: A, config: gcn.yaml, epochs: 3}]\n"
    )
    with pytest.raises(ValueError, match=r"a cell must not have 'epochs' \(got 3\)"):
        read_table(path)
