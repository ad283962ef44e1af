import csv
import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.experiments._building import check_arguments
from torch_geometric_tactile.experiments._sample_draws import Draws
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.nn.models import MSCNN, TactileFNN, TaxelNet
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.sensors import allegro_uskin_240
from torch_geometric_tactile.training import classifier_from_config
from torch_geometric_tactile.training._config import load_config
from torch_geometric_tactile.training._config_files import expand_template
from torch_geometric_tactile.training._sizes import DataSizes, fill_sizes

PATTERNS = ["I", "II", "III", "IV", "V", "VI", "VII"]
ONE, THREE, SHARED = "1-D", "3-D, different filters", "3-D, shared filters"


def table():
    return load_table("p4")


def published(row, key):
    cells = [cell for cell in table().cells if cell.row == row]
    return [cell.published[key] for cell in cells]


def test_rows_are_the_tables_of_the_paper():
    assert table().columns("") == PATTERNS
    rows = [
        "1-D, printed after 8,300 epochs",
        "1-D, printed after 20,000 epochs",
        "3-D, different filters, printed after 1,300 epochs",
        "3-D, shared filters, printed after 1,300 epochs",
        "3-D, different filters, printed after 10,000 epochs",
    ]
    assert [row for row in table().rows if "printed" in row] == rows
    assert published(rows[0], "accuracy") == [80.38, 79.80, 86.17, 82.86, 85.48, 85.57, 84.27]
    assert published(rows[1], "variance") == [3.41, 5.15, 6.67, 5.23, 1.28, 6.34, 2.73]
    assert published(rows[2], "accuracy") == [81.95, 89.76, 87.33, 89.45, 89.09, 88.69, 81.69]
    assert published(rows[3], "accuracy") == [81.95, 88.50, 79.85, 81.02, 84.28, 79.50, 74.30]
    assert published(rows[4], "accuracy") == [93.46, 94.03, 95.59, 94.01, 94.13]
    assert published(rows[4], "variance") == [1.26, 1.71, 0.86, 0.78, 2.47]
    assert sum(map(sum, (published(row, "accuracy") for row in rows))) == pytest.approx(2855.72)
    assert sum(map(sum, (published(row, "variance") for row in rows))) == pytest.approx(150.98)
    assert not any(c.published for c in table().cells if c.row not in rows)


def test_every_model_of_the_template_is_in_the_table_and_trained_once():
    used = [cell.config for cell in table().cells if cell.config]
    assert set(used) == {f"p4_tables/{name}" for name in expand_template("p4_tables")}
    configs = expand_template("p4_tables").values()
    assert len({json.dumps(config, sort_keys=True) for config in configs}) == 7 + 7 + 6 + 3


def sizes():
    layout = allegro_uskin_240()
    return DataSizes(layout, 3, 20, None, 16, channels={"tactile": 3})


def model_of(name):
    config = load_config(f"p4_tables/{name}")["model"]
    return classifier_from_config(fill_sizes(config, sizes())).model


CELLS = [cell for cell in load_table("p4").cells if cell.config]


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.experiment)
def test_models_are_those_of_their_place(cell):
    model = model_of(cell.config.partition("/")[2])
    if cell.section:
        kinds = {"fnn": TactileFNN, "taxel_net": TaxelNet, "three_iv_recipe": MSCNN}
        assert isinstance(model, kinds[cell.experiment])
        assert model.num_joints == 16
        return
    assert isinstance(model, MSCNN)
    assert (model.pattern, model.num_joints, model.out_channels) == (cell.column, 16, 20)
    assert model.num_channels == (1 if cell.row.startswith(ONE) else 3)
    # Pattern I has one map: there is nothing to share.
    assert model.share_weights == (cell.row.startswith(SHARED) and cell.column != "I")


def test_fnn_has_what_the_ms_cnn_has_behind_its_convolutions():
    fnn = model_of("fnn")
    assert (fnn.head.in_channels, fnn.head.widths) == (736, model_of("three_iv").head.widths)


def test_training_is_that_of_the_paper_but_for_the_epochs():
    for cell in table().cells:
        if cell.config is None or cell.experiment in ("taxel_net", "three_iv_recipe"):
            continue
        config = cell.configuration
        optimizer = config["model"]["optimizer"]
        assert optimizer["class_path"] == "torch.optim.Adam"
        assert config["data"]["batch_size"] == 100
        recordings, selection = config["data"]["dataset"]["init_args"], table().data.selection
        assert {key: recordings[key] for key in selection} == selection
        given = {key: recordings[key] for key in ("layout", "task", "tare")}
        assert given.items() <= table().data.arguments.items()
    ours = load_config("p4_tables/taxel_net")
    scheduler = ours["model"]["lr_scheduler"]
    assert scheduler == {"class_path": "torch_geometric_tactile.training.CosineAnnealing"}
    same = load_config("p4_tables/three_iv_recipe")
    without = {key: value for key, value in ours["model"].items() if key != "model"}
    assert same["model"] == {**load_config("p4_tables/three_iv")["model"], **without}
    assert (same["data"], same["trainer"]) == (ours["data"], ours["trainer"])


def test_forest_is_built_as_the_table_says():
    (cell,) = [cell for cell in table().cells if cell.estimator]
    for part in (cell.estimator, cell.transform):
        check_arguments(part["class_path"], part["init_args"])


def test_draws_and_protocol_are_those_of_the_paper():
    assert table().draws == Draws(10, 0.6)
    (entry,) = table().protocols
    assert (entry.protocol.by, entry.protocol.stratify, entry.protocol.val) == ("trial", "group", 0)
    assert 30 * entry.protocol.test == 5


def test_a_choice_of_channels_is_no_size():
    chosen = {"class_path": "MSCNN", "init_args": {"channels": 1}}
    assert fill_sizes({"model": chosen}, sizes())["model"]["init_args"]["channels"] == 1
    left_out = {"class_path": "MSCNN"}
    one = replace(sizes(), in_channels=1, channels={"tactile": 1})
    assert fill_sizes({"model": left_out}, one)["model"]["init_args"]["channels"] == 1


@pytest.fixture(scope="module")
def squeezes(tmp_path_factory):
    """Six trials of each of two objects, which press with other patches."""
    root = tmp_path_factory.mktemp("squeezes")
    rng = np.random.default_rng(0)
    for i, name in enumerate(("ball", "can")):
        for trial in range(6):
            tactile = rng.normal(0.0, 1.0, (60, 240, 3))
            tactile[20:, 20 * i : 20 * i + 16, 2] += 20.0
            recording = Recording(
                time=np.arange(60) / 50,
                tactile=tactile,
                joint=rng.normal(0.0, 1.0, (60, 16)),
                label=name,
                meta={
                    "object": name,
                    "trial": trial,
                    "unit": "count",
                    "phase_names": ["hover", "squeeze"],
                },
                privileged={"phase": (np.arange(60) >= 20).astype(np.int64)},
            )
            write_recording(recording, root / f"{name}_{trial:03d}.npz")
    return root


def test_table_is_trained_goes_on_and_tells_of_draws(squeezes, tmp_path, capsys):
    arguments = ["table", "p4", "--root", str(squeezes), "--out", str(tmp_path), "--seeds", "1"]
    only = ["--only", "one_i_*", "one_v_*", "fnn"]
    assert main([*arguments, "--epochs", "1", *only]) == 0
    # Five places of three models: those after 20,000 epochs are the same runs.
    assert "p4: 5 of 37 runs finished, 32 missing" in capsys.readouterr().out
    assert len(list((tmp_path / "runs").glob("*.json"))) == 3
    assert main([*arguments, "--epochs", "1", "--no-train"]) == 0
    assert "(5 kept from before)" in capsys.readouterr().out
    page = (tmp_path / "p4.md").read_text()
    # 0.8 s of squeezes have 24 ticks of 30 Hz, fewer than 25.
    drawn = "25 of each trial, drawn from every frame at 30 Hz of the phases squeeze: 288 in all"
    assert f"{drawn}; 240 to train and 48 to test" in page
    assert "For 29 of 48 samples, the variance is p(1 - p)/29 · 19/47 on average" in page
    assert (
        "The published variances are 0.78 to 9.87. This is 0.1 to 0.6 times the average for draws"
        in page
    )
    assert "There must be a further source" not in page
    rows = list(csv.DictReader((tmp_path / "p4.csv").read_text().splitlines()))
    mine = {(r["source"], r["metric"]): float(r["mean"]) for r in rows if r["experiment"] == "fnn"}
    (path,) = (tmp_path / "runs").glob("fnn_*.json")
    result = json.loads(path.read_text())["result"]
    predicted = Predictions.from_dict(result["predictions"])
    expected = Draws().metrics(predicted)
    assert mine["by trial", "draws_accuracy"] == pytest.approx(100 * expected["draws_accuracy"])
    assert mine["by trial", "draws_variance"] == pytest.approx(1e4 * expected["draws_variance"])
    printed = next(r for r in rows if r["experiment"] == "one_i" and r["source"] == "published")
    assert (printed["metric"], printed["mean"]) == ("accuracy", "86.47")
    costs = page.split("## Cost of the models")[1]
    assert costs.count("`p4_tables/one_i`") == 1
    assert "one_i_8300" not in costs


def test_help_and_list_name_the_table(capsys):
    assert main(["table", "p4", "--list"]) == 0
    text = capsys.readouterr().out
    assert "37 experiments; published numbers (Tables II, III and IV)" in text
    assert "variance (%²)" in text
    assert "tactile fit --config p4_tables/one_i" in text
    with pytest.raises(SystemExit, match="0"):
        main(["table", "--help"])
    text = capsys.readouterr().out
    assert "tactile table p4 --root twenty" in text
    assert "--objects twenty --motion squeeze --trials 30" in text
