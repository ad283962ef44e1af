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
        ("{setting: []}", r"cannot be read: .*unexpected keyword argument 'setting'"),
    ],
)
def test_wrong_choice_is_refused(choice, match, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(TEXT.replace("CHOICE", choice))
    with pytest.raises(ValueError, match=match):
        read_table(path)
