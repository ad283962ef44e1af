import csv
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from fake_configs import SCALED, fake_config, fake_dataset
from listed_outputs import listed_outputs

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import (
    ContactRule,
    FrameInfo,
    Recording,
    StaticData,
    Windows,
)
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.io import read_recording, write_recording
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.predictor._preparation import Preparation
from torch_geometric_tactile.reports import _predictions
from torch_geometric_tactile.reports._recording_truth import recording_truth
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import KNNGraph, SessionZScore, Tare

LAYOUT = grid(2, 2, pitch=0.01)
X = torch.randn(5, 4, 3, generator=torch.Generator().manual_seed(0))


def predictor(**kwargs):
    torch.manual_seed(0)
    model = TactileFNN(4, 2, widths=(5,), pools=(1,))
    return Predictor(model, LAYOUT, class_names=("soft", "hard"), num_channels=3, **kwargs)


def rows(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    predictor().save("a.predictor")
    for i in range(2):
        recording = Recording(time=10 + np.arange(5) / 10, tactile=X.numpy() + i)
        write_recording(recording, f"trial_{i}.npz")
    return tmp_path


def test_recordings_are_predicted_frame_by_frame(folder, capsys):
    assert main(["predict", "a.predictor", "trial_0.npz", "trial_1.npz", "--out", "b.csv"]) == 0
    assert capsys.readouterr().out.startswith("b.csv: 10 frames: ")
    found = rows("b.csv")
    assert list(found[0]) == ["recording", "frame", "time", "prediction", "p_soft", "p_hard"]
    assert [row["recording"] for row in found] == ["trial_0.npz"] * 5 + ["trial_1.npz"] * 5
    assert [int(row["frame"]) for row in found] == 2 * [0, 1, 2, 3, 4]
    assert found[6]["time"] == "10.100000"
    expected = torch.cat([predictor()(X), predictor()(X + 1)])
    for row, probability in zip(found, expected, strict=True):
        assert float(row["p_hard"]) == pytest.approx(float(probability[1]), abs=1e-6)
        assert row["prediction"] == ("hard" if probability[1] > 0.5 else "soft")


@pytest.mark.parametrize("task", ["multilabel", "regression"])
def test_tables_of_labels_and_of_numbers(folder, task, capsys):
    made = predictor(task=task)
    made.save("b.predictor")
    assert main(["predict", "b.predictor", "trial_0.npz", "--no-picture"]) == 0
    found = rows("predictions.csv")
    values = made(X)
    if task == "regression":
        assert list(found[0]) == ["recording", "frame", "time", "soft", "hard"]
        assert float(found[3]["hard"]) == pytest.approx(float(values[3, 1]), abs=1e-6)
        assert capsys.readouterr().out == "predictions.csv: 5 frames\n"
    else:
        assert [row["prediction"] for row in found] == [
            ";".join(labels) for labels in made.labels(values)
        ]


@pytest.mark.parametrize("task", ["multiclass", "multilabel", "regression"])
def test_frames_without_contact_are_written_as_such(folder, task, capsys):
    made = predictor(task=task)
    made.save("b.predictor")
    tactile = np.zeros((6, 4, 3), np.float32)
    tactile[3:5, :2, 2] = 30
    tactile[5, 0, 0] = 11  # one taxel only
    write_recording(Recording(time=np.arange(6) / 10, tactile=tactile), "c.npz")
    arguments = ["predict", "b.predictor", "c.npz", "--rest", "0.25"]
    assert main([*arguments, "--contact", "10"]) == 0
    assert "no contact 4" in capsys.readouterr().out
    found = rows("predictions.csv")
    said = [row.pop("prediction") for row in found]
    assert [text == "no contact" for text in said] == [True] * 3 + [False] * 2 + [True]
    names = ["soft", "hard"] if task == "regression" else ["p_soft", "p_hard"]
    assert [row[names[0]] == "nan" for row in found] == [text == "no contact" for text in said]
    if task == "regression":
        assert said[3:5] == ["", ""]
    # Without the option as ever, and saved with the predictor.
    assert main(["predict", "b.predictor", "c.npz", "--no-picture"]) == 0
    before = rows("predictions.csv")
    assert ("prediction" in before[0]) == (task != "regression")
    for i in (3, 4):
        assert {key: before[i][key] for key in names} == {key: found[i][key] for key in names}
    assert main(["predict", "b.predictor", "--save", "c.predictor", "--contact", "10"]) == 0
    assert Predictor.load("c.predictor").contact == ContactRule(10.0)
    arguments[1] = "c.predictor"
    assert main([*arguments, "--no-picture"]) == 0
    assert [row["prediction"] for row in rows("predictions.csv")] == said


def test_the_error_tells_how_long_the_training_was_at_rest(folder, capsys):
    predictor(info=FrameInfo(rest=0.4)).save("b.predictor")
    assert main(["predict", "b.predictor", "trial_0.npz", "--contact"]) == 1
    assert "add '--rest 0.4' if nothing touches the sensor" in capsys.readouterr().err


def test_sessions_of_recordings_are_measured_if_asked_for(folder, capsys):
    scaler = SessionZScore().fit(StaticData(x=X, session=torch.zeros(5)))
    made = predictor(transform=scaler)
    made.save("b.predictor")
    assert main(["predict", "b.predictor", "trial_1.npz"]) == 1
    assert "'trial_1.npz': 'session' must be given" in capsys.readouterr().err
    assert not (folder / "predictions.csv").exists()
    assert main(["predict", "--adapt", "b.predictor", "trial_1.npz"]) == 0
    made.adapt(X + 1)
    for row, probability in zip(rows("predictions.csv"), made(X + 1), strict=True):
        assert float(row["p_hard"]) == pytest.approx(float(probability[1]), abs=1e-6)


def test_rest_is_measured_at_the_beginning_of_a_recording(folder, capsys):
    tare = Tare().fit(StaticData(x=X, session=torch.zeros(5)))
    made = predictor(transform=tare)
    made.save("c.predictor")
    time = read_recording("trial_1.npz").time
    rest = float(time[2] - time[0])  # two frames
    assert main(["predict", "--rest", str(rest), "--no-picture", "c.predictor", "trial_1.npz"]) == 0
    made.adapt(X[:2] + 1)
    for row, probability in zip(rows("predictions.csv"), made(X + 1), strict=True):
        assert float(row["p_hard"]) == pytest.approx(float(probability[1]), abs=1e-6)
    assert capsys.readouterr().err == ""
    assert main(["predict", "--adapt", "c.predictor", "trial_1.npz"]) == 0
    assert "note: --adapt uses the mean of the whole recording" in capsys.readouterr().err
    both = ["--adapt", "--rest", str(rest), "--no-picture"]
    assert main(["predict", *both, "c.predictor", "trial_1.npz"]) == 0
    assert capsys.readouterr().err == ""
    assert float(rows("predictions.csv")[-1]["p_hard"]) == float(row["p_hard"])
    made.adapt(X + 1)
    assert float(row["p_hard"]) != pytest.approx(float(made(X + 1)[-1, 1]), abs=1e-6)


def test_mistakes_are_one_line(folder, capsys):
    recording = Recording(time=np.arange(2.0), tactile=np.zeros((2, 3, 3)))
    write_recording(recording, "three.npz")
    (folder / "notes.txt.zip").write_text("no recording")
    for arguments, text in (
        (["nothing", "trial_0.npz"], "there is no predictor or checkpoint 'nothing'"),
        (["trial_0.npz", "trial_0.npz"], "'trial_0.npz' cannot be read as a checkpoint"),
        (["a.predictor", "nothing.h5"], "nothing.h5"),
        (["a.predictor", "notes.txt.zip"], "must end in one of"),
        (["a.predictor", "three.npz"], "'three.npz': a recording on layout .* 4 taxels"),
        (["a.predictor"], "pass it with '--config'"),
        (
            ["a.predictor", "trial_0.npz", "--root", "b"],
            "'--root' must be left out with recordings",
        ),
        (["a.predictor", "--adapt"], "'--adapt' must be left out without recordings"),
        (["a.predictor", "--rest", "1"], "'--rest' must be left out without recordings"),
        (["a.predictor", "--contact"], "'--contact' must be left out without recordings and"),
        (["a.predictor", "trial_0.npz", "--contact"], "add '--rest SECONDS' if nothing touches"),
        (["a.predictor", "trial_0.npz", "--adapt", "--contact"], "add '--rest SECONDS' if"),
        (["a.predictor", "trial_0.npz", "--rest", "0.1", "--contact"], "at least 10 frames"),
    ):
        assert main(["predict", *arguments]) == 1
        error = capsys.readouterr().err
        assert error.startswith("tactile: error: ")
        assert len(error.splitlines()) == 2  # and where it came from
        assert re.search(text, error)
    assert not (folder / "predictions.csv").exists()


@pytest.mark.filterwarnings("ignore")
def test_the_test_part_of_a_run_is_predicted(tmp_path, monkeypatch, capsys):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    import yaml

    monkeypatch.chdir(tmp_path)
    parts = {"test_dataset": fake_dataset(50, split="test"), "transform": SCALED}
    config = fake_config("GraspGCN", 100, is_logged=True, **parts)
    (tmp_path / "grasp.yaml").write_text(yaml.safe_dump(config))
    assert main(["fit", "--config", "grasp.yaml"]) == 0
    checkpoint = "runs/grasp/version_0/checkpoints/last.ckpt"
    assert main(["predict", checkpoint]) == 0
    found = rows("predictions.csv")
    assert list(found[0]) == ["index", "prediction", "p_stable", "p_slip"]
    assert [int(row["index"]) for row in found] == list(range(50))

    from torch_geometric_tactile.datasets import FakeTactileDataset

    # Without Lightning: readings of the test sessions, which the checkpoint has measured.
    data = FakeTactileDataset(50, split="test").data
    made = Predictor.from_checkpoint(checkpoint)
    for i in range(0, 50, 7):
        slip = float(made(data.x[i], session=int(data.session[i]))[1])
        assert float(found[i]["p_slip"]) == pytest.approx(slip, abs=1e-5)
        assert found[i]["prediction"] == ("slip" if slip > 0.5 else "stable")

    # The same from one file, with the data of a configuration.
    assert main(["predict", checkpoint, "--save", "one.predictor"]) == 0
    assert "wrote one.predictor: Predictor(GraspGCN" in capsys.readouterr().out
    assert main(["predict", "one.predictor", "--config", "grasp.yaml", "--out", "b.csv"]) == 0
    assert rows("b.csv") == found


def glove(path, names, frames=(0, 1, 2)):
    """A CSV file in which a cell tells its column and frame."""
    cells = {name: 10.0 + 3 * i for i, name in enumerate(PADS)}
    lines = [f"stamp,{','.join(names)}"]
    lines += [f"{t},{','.join(str(cells.get(n, 0) + t * len(n)) for n in names)}" for t in frames]
    path.write_text("\n".join(lines) + "\n")


PADS = [f"pad_{axis}{i}" for i in (2, 10, 1, 3) for axis in "xyz"]
OPTIONS = {"tactile": "pad_.*", "joint": "q", "num_channels": 3, "time": "stamp"}


def test_a_predictor_knows_the_columns_of_its_training(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "grasps").mkdir()
    for name in ("cup_0", "mug_0"):
        glove(tmp_path / "grasps" / f"{name}.csv", [*PADS, "q"])
    dataset = RecordingFrames("grasps", layout=LAYOUT, read_options=OPTIONS)
    torch.manual_seed(0)
    made = Predictor.from_dataset(TactileFNN(4, 2, widths=(5,), pools=(1,)), dataset)
    made.save("a.predictor")
    expected = made(dataset.data.x[:3])
    loaded = Predictor.load("a.predictor")
    assert loaded.read_options == {**OPTIONS, "tactile": PADS, "joint": ["q"]}
    assert loaded.with_tare().read_options == loaded.read_options
    windows = Preparation.from_dataset(Windows(dataset, 2))
    assert windows.read_options == loaded.read_options
    glove(tmp_path / "new.csv", ["q", "note", *PADS[::-1]])
    assert loaded.recording(read_recording("new.csv", **loaded.read_options)).allclose(expected)
    # Others' order, by an expression for the same names, or converted with their names.
    declared = ["--tactile", "pad_.*", "--joint", "q", "--num-channels", "3", "--time", "stamp"]
    write_recording(read_recording("new.csv", **OPTIONS), "new.npz")
    for arguments in (["new.csv"], ["new.csv", *declared], ["new.npz"]):
        assert main(["predict", "a.predictor", *arguments]) == 0
        found = [float(row["p_mug"]) for row in rows("predictions.csv")]
        assert found == pytest.approx(expected[:, 1].tolist(), abs=1e-6)
    capsys.readouterr()
    glove(tmp_path / "new.csv", ["q", *PADS[:-1], "pad_t"])
    assert main(["predict", "a.predictor", "new.csv"]) == 1
    error = capsys.readouterr().err
    assert "'new.csv' must have the column 'pad_z3' (got stamp, q," in error
    assert "; name the columns of this file that match the training data with '--tactile'" in error
    assert main(["predict", "a.predictor", "new.csv", *declared]) == 1
    assert "(got 'pad_t' in place of 'pad_z3')" in capsys.readouterr().err


def test_columns_of_a_file_are_asked_for_where_they_are_unknown(folder, capsys):
    glove(folder / "new.csv", [*PADS, "q"])
    assert main(["predict", "a.predictor", "new.csv", "--time", "stamp"]) == 1
    error = capsys.readouterr().err
    assert "4 taxels (got 13); name the columns of this file that match" in error
    glove(folder / "more.csv", [*PADS[::-1], "q"])
    declared = ["--tactile", "pad_.*", "--num-channels", "3", "--time", "stamp"]
    assert main(["predict", "a.predictor", "new.csv", "more.csv", *declared]) == 0
    found = [row["p_hard"] for row in rows("predictions.csv")]
    assert found[:3] == found[3:]  # in the order of the first file
    assert main(["predict", "a.predictor", "--tactile", "pad_.*"]) == 1
    assert "the options ['tactile'] must be left out" in capsys.readouterr().err


PNG = b"\x89PNG"


def test_a_picture_is_drawn_beside_the_table(folder, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    (folder / "out").mkdir()
    assert main(["predict", "a.predictor", "trial_0.npz", "--out", "out/a.csv"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.replace("\\", "/") == "out/a.png: picture"
    assert (folder / "out" / "a.png").read_bytes().startswith(PNG)
    assert sorted(path.name for path in (folder / "out").iterdir()) == ["a.csv", "a.png"]
    # Its name is never that of the table.
    assert main(["predict", "a.predictor", "trial_0.npz", "--out", "b.png"]) == 0
    assert rows("b.png")[0]["frame"] == "0"
    assert (folder / "b.png.png").read_bytes().startswith(PNG)


def test_several_recordings_have_a_picture_each_and_no_more_than_twenty(
    folder, capsys, monkeypatch
):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    from torch_geometric_tactile.reports import _prediction_pictures as pictures

    monkeypatch.setattr(pictures, "MAX_PICTURES", 3)
    (folder / "other").mkdir()
    (folder / "other" / "trial_0.npz").write_bytes((folder / "trial_0.npz").read_bytes())
    names = ["trial_0.npz", "other/trial_0.npz", "trial_1.npz", "trial_0.npz", "trial_1.npz"]
    assert main(["predict", "a.predictor", *names, "--out", "a.csv"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[1:] == [
        "a-trial_0.png: picture",
        "a-trial_0-2.png: picture",
        "a-trial_1.png: picture",
        "2 more recordings: no picture",
    ]
    assert len(rows("a.csv")) == 25
    listed = {*map(str, listed_outputs(["predict", "a.predictor", *names, "--out", "a.csv"]))}
    assert {path.name for path in folder.glob("a*.png")} <= listed
    same = (folder / "a-trial_0.png").read_bytes()
    assert (
        same == (folder / "a-trial_0-2.png").read_bytes() != (folder / "a-trial_1.png").read_bytes()
    )
    assert same.startswith(PNG)


def test_a_name_of_a_file_tells_the_true_class(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    from torch_geometric_tactile.reports import _prediction_pictures as pictures

    monkeypatch.chdir(tmp_path)
    recording = Recording(time=np.arange(5.0), tactile=X.numpy())
    kept = pictures.PredictionPictures("a.csv")
    for name in ("hard_003.npz", "soft.npz", "mug_1.npz"):
        truth = recording_truth(predictor(), name, recording, predictor().class_names)
        kept.add(predictor(), name, recording, predictor()(X), range(5), truth)
    first, *others = (trial.truth for _, trial in kept._trials)
    assert first.source == "file name"
    assert first.value.tolist() == ["hard"] * 5
    assert others == [None, None]


def test_form_of_the_names_of_the_training_files_tells_the_true_class(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    from torch_geometric_tactile.reports import _prediction_pictures as pictures

    monkeypatch.chdir(tmp_path)
    for name in ("p1_soft_1", "p1_hard_1"):
        write_recording(Recording(time=np.arange(5.0), tactile=X.numpy()), f"{name}.npz")
    dataset = RecordingFrames(".", layout=LAYOUT, pattern="{person}_{object}_{trial}")
    model = TactileFNN(4, 2, widths=(5,), pools=(1,))
    Predictor.from_dataset(model, dataset).save("b.predictor")
    loaded = Predictor.load("b.predictor")
    kept = pictures.PredictionPictures("a.csv")
    for name in ("p2_soft_7.npz", "p2_mug_7.npz"):
        recording = Recording(time=np.arange(5.0), tactile=X.numpy())
        truth = recording_truth(loaded, name, recording, loaded.class_names)
        kept.add(loaded, name, recording, loaded(X), range(5), truth)
        write_recording(recording, name)
    first, second = (trial.truth for _, trial in kept._trials)
    assert (first.value.tolist(), first.source) == (["soft"] * 5, "file name")
    assert second is None
    assert main(["predict", "b.predictor", "p2_mug_7.npz", "p2_soft_7.npz", "--no-picture"]) == 0
    assert [row["label"] for row in rows("predictions.csv")] == 5 * [""] + 5 * ["soft"]


def test_no_picture_is_drawn_where_none_is_asked_for_or_matplotlib_is_missing(
    folder, capsys, monkeypatch
):
    from torch_geometric_tactile.commands import predict

    assert main(["predict", "a.predictor", "trial_0.npz", "--no-picture"]) == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(predict, "find_spec", lambda name: None)
    assert main(["predict", "a.predictor", "trial_0.npz", "trial_1.npz"]) == 0
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 1
    assert err.startswith("note: no picture, because matplotlib is missing: pip install ")
    assert len(err.splitlines()) == 1
    assert len(rows("predictions.csv")) == 10
    assert not list(folder.glob("*.png"))


def test_recordings_that_cannot_be_predicted_are_listed_and_lose_no_others(folder, capsys):
    recording = Recording(time=np.arange(2.0), tactile=np.zeros((2, 3, 3)))
    write_recording(recording, "three.npz")
    files = ["three.npz", "trial_0.npz", "nothing.npz", "trial_1.npz"]
    assert main(["predict", "a.predictor", *files, "--no-picture"]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("predictions.csv: 10 frames: ")
    summary, *problems, _ = err.splitlines()
    assert summary == "tactile: error: 2 of 4 recordings have no predictions:"
    assert re.match("- 'three.npz': a recording on layout .* 4 taxels", problems[0])
    assert problems[1].startswith("- 'nothing.npz'")
    assert len(problems) == 2
    table = rows("predictions.csv")
    assert main(["predict", "a.predictor", "trial_0.npz", "trial_1.npz", "--no-picture"]) == 0
    assert rows("predictions.csv") == table


def test_no_table_is_left_if_no_recording_has_predictions(folder, capsys):
    assert main(["predict", "a.predictor", "none.npz", "nothing.npz"]) == 1
    assert not list(folder.glob("predictions*"))
    assert "error: 2 of 2 recordings have no predictions:\n" in capsys.readouterr().err
    error = _predictions.UnpredictedRecordingsError
    with pytest.raises(error, match=r"1 of 2 recordings .*predictions: .*none\.npz") as failure:
        _predictions.write_recordings(predictor(), ["none.npz", "trial_0.npz"], "b.csv")
    assert failure.value.count.total() == len(rows("b.csv")) == 5


def test_network_of_pyg_needs_a_configuration_with_its_class_alone(tmp_path, monkeypatch, capsys):
    pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    monkeypatch.chdir(tmp_path)
    Path("my_gat.py").write_text(
        "import torch\n"
        "from torch_geometric.nn import GATv2Conv, global_mean_pool\n\n\n"
        "class Net(torch.nn.Module):\n"
        "    def __init__(self, in_channels, out_channels):\n"
        "        super().__init__()\n"
        "        self.conv = GATv2Conv(in_channels, 4, heads=2)\n"
        "        self.lin = torch.nn.Linear(8, out_channels)\n\n"
        "    def forward(self, x, edge_index, batch):\n"
        "        h = self.conv(x, edge_index).relu()\n"
        "        return self.lin(global_mean_pool(h, batch))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from my_gat import Net

    layout = grid(2, 3, 0.004)
    net = Predictor(
        Net(1, 2), layout, class_names=("a", "b"), num_channels=1, pre_transform=KNNGraph(2)
    )
    net.save("net.predictor")
    x = torch.rand(5, 6, generator=torch.Generator().manual_seed(0))
    header = "time," + ",".join(f"s{i}" for i in range(6))
    lines = [",".join(map(str, [i / 100, *row])) for i, row in enumerate(x.tolist())]
    Path("a.csv").write_text("\n".join([header, *lines, ""]))
    arguments = ["predict", "net.predictor", "a.csv", "--no-picture"]
    assert main(arguments) == 1
    assert "--config" in capsys.readouterr().err
    Path("c.yaml").write_text(
        "model: {model: {class_path: my_gat.Net, init_args: {in_channels: 1, out_channels: 2}}}"
    )
    assert main([*arguments, "--config", "c.yaml"]) == 0
    expected = net(x.unsqueeze(-1)).tolist()
    found = [[float(row[f"p_{name}"]) for name in "ab"] for row in rows("predictions.csv")]
    assert np.allclose(found, expected, atol=1e-4)
    capsys.readouterr()
    Path("empty.yaml").write_text("seed_everything: 0")
    assert main([*arguments, "--config", "empty.yaml"]) == 1
    assert "configuration 'empty.yaml' must hold 'model' (got none)" in capsys.readouterr().err
