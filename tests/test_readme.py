"""The README runs as it stands, and says what its example downloads and scores."""

import os
import re
import shutil
import subprocess
import sys
import tomllib

import pytest
import torch
from conftest import BTS3_NAMES
from markdown_pages import ROOT, blocks_of, run_page

from torch_geometric_tactile._files import file_sha256
from torch_geometric_tactile.datasets import BioTacSP

README = ROOT / "README.md"
_PRINTED = re.compile(r"slip or not, on new objects: ([\d.]+)%\n")


def text():
    return README.read_text(encoding="utf-8")


def test_page_runs_on_small_files(write_bts3, tmp_path, monkeypatch, capsys):
    folder = write_bts3(tmp_path / "BioTacSP" / "raw")
    monkeypatch.setattr(BioTacSP, "_sha256", {n: file_sha256(folder / n) for n in BTS3_NAMES})
    monkeypatch.setenv("TACTILE_DATA", str(tmp_path))
    names = {}
    run_page(README, names)
    assert _PRINTED.fullmatch(capsys.readouterr().out)
    train, test = names["train"], names["test"]
    assert (len(train), len(test)) == (24, 24)
    assert not torch.isin(train.data.group, test.data.group).any()  # the split is by object


@pytest.mark.full
@pytest.mark.slow
def test_example_scores_as_stated_in_an_empty_folder(bts3_recordings, tmp_path):
    (code,) = [block.code for block in blocks_of(README) if block.language == "python"]
    work, raw = tmp_path / "empty", tmp_path / "data" / "BioTacSP" / "raw"
    work.mkdir()
    raw.mkdir(parents=True)
    for name in BTS3_NAMES:
        shutil.copyfile(bts3_recordings / name, raw / name)
    environment = {**os.environ, "TACTILE_DATA": str(tmp_path / "data")}
    done = subprocess.run(
        [sys.executable, "-c", f"import torch; torch.manual_seed(0)\n{code}"],
        cwd=work, env=environment, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "arning" not in done.stderr
    mean, deviation = map(float, re.search(r"prints ([\d.]+) ± ([\d.]+) %", text()).groups())
    score = float(_PRINTED.search(done.stdout)[1])
    assert score == pytest.approx(mean, abs=2 * deviation)
    assert not list(work.iterdir())


def test_example_names_grasps_objects_and_size_of_the_download(bts3_recordings, bts3_root):
    for split in ("train", "test"):
        dataset = BioTacSP(bts3_root, split=split)
        num_objects = dataset.data.group.unique().numel()
        assert re.search(rf"# {len(dataset):,} grasps of {num_objects} ", text())
    size = sum((bts3_recordings / name).stat().st_size for name in BTS3_NAMES)
    assert f"downloads {size / 1e6:.0f} MB" in text()


def test_readme_names_the_pythons_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pythons = [
        line.rpartition(" ")[2]
        for line in project["classifiers"]
        if re.search(r"Python :: 3\.\d+$", line)
    ]
    assert f"Python {pythons[0]} to {pythons[-1]}" in text()
    assert f"You need Python {pythons[0]} or later" in text()
