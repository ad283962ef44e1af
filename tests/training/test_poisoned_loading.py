"""Loading a checkpoint imports, parses and instantiates nothing, whatever the checkpoint holds."""

import contextlib
import importlib
import os
import random
import sys

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import jsonargparse
import lightning.pytorch.cli
import yaml
from fuzz import model_bases
from fuzz.torch_mutations import mutated_torch

from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.training import TactileDataModule, TactileModule

pytestmark = pytest.mark.full

CASES = int(os.environ.get("TACTILE_CHECKPOINT_CASES", "200"))  # 10,000 in `make check`


class Reached(BaseException):
    """No loader turns it into an error of its own."""


class NoImport:
    def find_spec(self, name, path=None, target=None):
        raise Reached(name)


def refuse(*args, **kwargs):
    raise Reached(args)


def known_module(name, package=None):
    """As `importlib.import_module`, for modules that were imported before any case."""
    if package is not None or name not in sys.modules:
        raise Reached(name)
    return sys.modules[name]


def load(path):
    for read in (TactileModule.load_from_checkpoint, Predictor.from_checkpoint):
        with contextlib.suppress(ValueError, OSError):
            read(path)
    with contextlib.suppress(ValueError):
        TactileDataModule.load_from_checkpoint(path)


@pytest.fixture
def poisoned(tmp_path, monkeypatch):
    """The bytes of a checkpoint, which has been loaded once: nothing new is needed after it."""
    model_bases.checkpoint(tmp_path)
    path = tmp_path / "a.ckpt"
    for seed in range(30):  # what refusals need is imported as well
        (tmp_path / "b.ckpt").write_bytes(mutated_torch(path.read_bytes(), random.Random(-seed))[0])
        load(tmp_path / "b.ckpt")
    assert isinstance(TactileModule.load_from_checkpoint(path), TactileModule)
    monkeypatch.setattr(importlib, "import_module", known_module)
    for owner, name in (
        (jsonargparse.ArgumentParser, "instantiate_classes"),
        (jsonargparse.ArgumentParser, "parse_object"),
        (lightning.pytorch.cli, "instantiate_module"),
        (yaml, "load"),
        (yaml, "load_all"),
    ):
        monkeypatch.setattr(owner, name, refuse)
    monkeypatch.setattr(sys, "meta_path", [NoImport(), *sys.meta_path])
    return path.read_bytes()


def test_the_poison_works(poisoned):
    with pytest.raises(Reached):
        import antigravity  # noqa: F401
    with pytest.raises(Reached):
        importlib.import_module("antigravity")
    with pytest.raises(Reached):
        yaml.safe_load("a: 1")
    with pytest.raises(Reached):
        jsonargparse.ArgumentParser().instantiate_classes(None)


@pytest.mark.slow
def test_mutated_checkpoints_reach_no_parser_and_no_importer(poisoned, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "case.ckpt"
    for seed in range(CASES):
        path.write_bytes(mutated_torch(poisoned, random.Random(seed))[0])
        load(path)
    assert not (tmp_path / "MARKER").exists()
