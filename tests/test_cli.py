import csv
import os
import signal
import subprocess
import sys
import time

import pytest
from fake_configs import SCALED, fake_config, fake_dataset

from torch_geometric_tactile import __version__
from torch_geometric_tactile.cli import main

pytestmark = pytest.mark.full

CONFIG = fake_config(
    "GraspGCN",
    400,
    epochs=400,
    is_logged=True,
    test_dataset=fake_dataset(100, split="test"),
    split="group",
    val=0.2,
    transform=SCALED,
    batch_size=8,
)


def tactile(*args, **kwargs):
    return subprocess.run(
        [sys.executable, "-m", "torch_geometric_tactile", *map(str, args)],
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
        **kwargs,
    )


@pytest.fixture
def config(tmp_path):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    import yaml

    path = tmp_path / "grasp.yaml"
    path.write_text(yaml.safe_dump(CONFIG))
    return path


def test_help_names_every_command_and_needs_no_torch():
    code = (
        "import sys; from torch_geometric_tactile.cli import build_parser; "
        "print(build_parser().format_help()); sys.exit('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    for command in ("demo", "fit", "validate", "test", "predict"):
        assert f"    {command} " in done.stdout


def test_version(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"tactile {__version__}\n"


def test_module_is_the_command():
    assert tactile("--version").stdout == f"tactile {__version__}\n"


def test_unknown_options_show_the_usage_of_their_command(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["compare", "touches.npz", "--modles", "gcn"])
    error = capsys.readouterr().err
    assert error.startswith("usage: tactile compare ")
    assert "tactile compare: error: unrecognized arguments: --modles gcn" in error


@pytest.mark.parametrize("flag", ["--seeds", "--folds", "--epochs", "--jobs"])
def test_demo_refuses_numbers_below_one(flag, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["demo", flag, "0"])
    assert f"argument {flag}: must be at least 1 (got 0)" in capsys.readouterr().err


def test_unknown_configuration_is_explained(capsys):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    assert main(["fit", "--config", "grasp_gcn"]) == 1
    error = capsys.readouterr().err
    assert "tactile: error: there is no file 'grasp_gcn'" in error
    assert "grasp_gcn_df" in error


def test_missing_root_is_explained(tmp_path, capsys):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    assert main(["demo", "--root", str(tmp_path / "nowhere"), "--out", str(tmp_path)]) == 1
    assert "'--root' must be a folder" in capsys.readouterr().err


def test_missing_extra_is_named(monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("torch_geometric_tactile.tr")]:
        if "training" in name:
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "lightning", None)
    assert main(["fit", "--config", "grasp_gcn_df"]) == 1
    assert 'pip install "torch-geometric-tactile[train]"' in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["demo", "compare touches.npz", "table bts3"])
def test_missing_extras_of_a_verb_are_named(verb, monkeypatch, capsys):
    for name in ("training", "experiments", "reports"):
        for module in [m for m in sys.modules if m.startswith(f"torch_geometric_tactile.{name}")]:
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "yaml", None)
    assert main(verb.split()) == 1
    error = capsys.readouterr().err
    assert f"'tactile {verb.split()[0]}' needs the package '" in error
    assert 'pip install "torch-geometric-tactile[train,viz]"' in error


@pytest.mark.parametrize("verb", ["fit", "validate", "test"])
def test_help_of_lightning_verbs_fits_on_two_screens(verb, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "lightning", None)  # it needs no extra
    assert main([verb, "--config", "grasp_gcn_df", "--help"]) == 0
    shown = capsys.readouterr().out
    assert len(shown.splitlines()) < 48
    for option in ("--config", "--model.model", "--data.dataset.init_args.root", "--help-all"):
        assert f"\n  {option} " in shown
    for option in ("--data.batch_size", "--seed_everything", "--ckpt_path", "--trainer.devices"):
        assert f"\n  {option} " in shown
    assert "\n  --out DIR " in shown
    assert ("--trainer.max_epochs" in shown) == (verb == "fit")
    assert shown.count(f"\n  tactile {verb} ") == 3


@pytest.mark.parametrize("flag", ["--help-all", "--help=all"])
def test_full_help_has_every_option(flag, capsys):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    with pytest.raises(SystemExit, match="0"):
        main(["fit", flag])
    shown = capsys.readouterr().out
    for option in ("--trainer.max_epochs", "--model.label_smoothing", "--data.train_transform"):
        assert option in shown


def test_fit_without_arguments_asks_for_a_configuration(capsys):
    assert main(["fit"]) == 1
    assert "'--config' must name a configuration" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--nonsense"], "unrecognized arguments: --nonsense"),
        (["--data.batch_size", "x"], "data.batch_size"),
        (["--out"], "'--out' must be a folder (got '')"),
        (["--out", "--config"], "'--out' must be a folder (got '--config')"),
    ],
)
def test_fit_explains_wrong_arguments_on_one_line(arguments, message, config, capsys):
    assert main(["fit", "--config", str(config), *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 2  # and how to see the traceback


def test_out_is_the_folder_of_the_runs_and_no_adverts_are_shown(config, tmp_path):
    once = ["--trainer.max_epochs", "1", "--out", "elsewhere"]
    done = tactile("fit", "--config", config, *once, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    run = tmp_path / "elsewhere/grasp/version_0"
    assert (run / "checkpoints/last.ckpt").is_file()
    assert not (tmp_path / "runs").exists()
    assert "Seed set to 0" in done.stderr  # what Lightning reports of the run is kept
    assert "Tip" not in done.stderr

    checkpoint = ["--ckpt_path", run / "checkpoints/last.ckpt"]
    done = tactile(
        "test", "--config", run / "config.yaml", *checkpoint, "--out", "tests", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "tests/grasp").is_dir()
    assert "Warn" not in done.stderr
    assert "dirpath" not in done.stderr


def test_fit_is_killed_resumed_tested_and_predicts(config, tmp_path, monkeypatch, capsys):
    command = [sys.executable, "-m", "torch_geometric_tactile", "fit", "--config", str(config)]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    last = tmp_path / "runs/grasp/version_0/checkpoints/last.ckpt"
    deadline = time.monotonic() + 120
    while not last.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "the training ended before it was killed"

    import torch

    epoch = torch.load(last, weights_only=True)["epoch"]
    monkeypatch.chdir(tmp_path)
    stop = ["--trainer.max_epochs", str(epoch + 3), "--ckpt_path", str(last)]
    assert main(["fit", "--config", str(config), *stop]) == 0
    resumed = tmp_path / "runs/grasp/version_1"
    with (resumed / "metrics.csv").open() as file:
        epochs = [int(row["epoch"]) for row in csv.DictReader(file)]
    assert min(epochs) == epoch + 1
    assert max(epochs) == epoch + 2
    assert (resumed / "config.yaml").is_file()
    assert list((tmp_path / "runs/grasp/tensorboard").rglob("events.out.tfevents.*"))

    checkpoint = str(resumed / "checkpoints/last.ckpt")
    assert main(["test", "--config", str(config), "--ckpt_path", checkpoint]) == 0
    assert "test/accuracy_palm_side_test" in capsys.readouterr().out

    assert main(["predict", checkpoint]) == 0
    with (tmp_path / "predictions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["index"]) for row in rows] == list(range(100))
    for row in rows:
        slip = float(row["p_slip"])
        assert slip + float(row["p_stable"]) == pytest.approx(1, abs=1e-5)
        assert row["prediction"] == ("slip" if slip > 0.5 else "stable")


def test_two_processes_train_and_test_together(config, tmp_path):
    ddp = ["--trainer.strategy", "ddp", "--trainer.devices", 2, "--trainer.max_epochs", 1]
    done = tactile("fit", "--config", config, *ddp, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "MEMBER: 2/2" in done.stdout + done.stderr
    last = tmp_path / "runs/grasp/version_0/checkpoints/last.ckpt"

    import torch

    # 8 of 10 objects are for training: 320 grasps, of which each process takes 160 in eights.
    assert torch.load(last, weights_only=True)["global_step"] == 20
    done = tactile("test", "--config", config, *ddp, "--ckpt_path", last, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "test/accuracy_palm_45_test" in done.stdout


def test_checkpoint_with_pickled_objects_is_refused(config, tmp_path, monkeypatch, capsys):
    import torch

    class Payload:
        def __reduce__(self):
            return (os.system, ("true",))

    path = tmp_path / "evil.ckpt"
    torch.save({"state_dict": Payload()}, path)
    monkeypatch.chdir(tmp_path)
    assert main(["test", "--config", str(config), "--ckpt_path", str(path)]) == 1
    assert "evil.ckpt' must hold plain data and tensors only" in capsys.readouterr().err
