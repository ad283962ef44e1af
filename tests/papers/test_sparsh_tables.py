"""P1's and P2's models on made-up files in the form of the Sparsh-skin data set."""

import csv

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from published_files import sparsh_skin

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.experiments.plan import Settings, make_plan
from torch_geometric_tactile.papers import load_table


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "only"),
    [
        ("sparsh-p1", ["mt_gcn_te_joint", "fnn_ta_joint", "cnn_ta", "mt_cnn_ta", "gcn_te"]),
        ("sparsh-p2", ["ii_tac_pos_joint", "x_tac", "i_pos"]),
    ],
)
def test_models_learn_the_objects_of_another_layout(tmp_path, capsys, name, only):
    root, out = sparsh_skin(tmp_path / "data"), tmp_path / "out"
    short = ["--epochs", "1", "--seeds", "1", "--only", *only]
    assert main(["table", name, "--root", str(root), "--out", str(out), *short]) == 0
    assert f"{name}: {len(only)} of" in capsys.readouterr().out
    page = (out / f"{name}.md").read_text()
    assert "**Measured** by others: the Sparsh-skin recordings" in page
    assert "24 in all; 12 to train and 6 to test by trial. The mean of the baseline rea" in page
    assert "Published" not in page
    assert "private" not in page
    rows = list(csv.DictReader((out / f"{name}-runs.csv").read_text().splitlines()))
    assert {row["experiment"] for row in rows} == set(only)
    assert not any("label" in column for column in rows[0])  # objects, and no six labels


def test_plan_is_of_objects_at_ten_frames_a_second(tmp_path):
    root = str(sparsh_skin(tmp_path))
    plan = make_plan(load_table("sparsh-p1"), Settings(seeds=2), data={"root": root})
    assert (plan.facts.num_samples, plan.facts.num_trials, plan.facts.num_classes) == (24, 8, 2)
    assert plan.facts.class_names == ("corn", "cup")
    assert len(plan.experiments) == 2 * 36
    assert {experiment.model["task"] for experiment in plan.experiments} == {"multiclass"}


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--tare", "hover"], r"'--tare' must be 'baseline' or None (got 'hover')"),
        (["--stride", "2"], "'--stride' must be an argument of SparshSkin"),
        (["--protocols", "frame"], "'--protocols' must be some of ['by trial'] (got 'frame')"),
        (["--root", "nowhere"], "huggingface-cli download facebook/sparsh-skin-dataset"),
    ],
)
def test_wrong_arguments_are_explained(tmp_path, monkeypatch, capsys, flags, message):
    monkeypatch.chdir(tmp_path)
    root = ["--root", str(sparsh_skin(tmp_path / "data", episodes=1))]
    assert main(["table", "sparsh-p2", *root, "--only", "x_tac", *flags]) == 1
    assert message in capsys.readouterr().err
