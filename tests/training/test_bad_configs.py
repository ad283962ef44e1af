"""Configurations, tables and checkpoints that cannot be read end in an error that names them."""

from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
import yaml
from fake_configs import fake_config
from hostile_settings import small_checkpoint

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.training import TactileModule, _config_files
from torch_geometric_tactile.training._config import load_config
from torch_geometric_tactile.training._config_files import read_yaml

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join(['*' + chr(97 + i)] * 10)}]\n" for i in range(9)
)
BAD = {
    "open bracket": b"data: [1, 2",
    "object": b"!!python/object/apply:os.mkdir ['attacked']",
    "cycle": b"data: &a\n  b: *a\n",
    "control character": b"a: \x01",
    "key twice": b"a:\n  b: 1\n  c: 2\n  b: 1\n",
    "no text": b"data: \xff\xfe",
    "date": b"seed_everything: 2020-99-99",
    "long number": b"a: " + b"1" * 6000,
    "brackets": b"data: " + b"[" * 200_000,
    "mappings": b"data: " + b"{a: " * 3000,
    "blocks": "\n".join(" " * i + "a:" for i in range(400)).encode(),
    "billion laughs": LAUGHS.encode(),
    "large": b"# " + b"x" * 2**21,
}


@pytest.mark.parametrize("name", BAD)
def test_yaml_that_cannot_be_read_names_the_file(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_bytes(BAD[name])
    for read in (read_yaml, lambda path: load_config(str(path))):
        with pytest.raises(ValueError, match=r"'bad\.yaml' cannot be read as YAML"):
            read(Path("bad.yaml"))
    assert not Path("attacked").exists()


def test_yaml_of_many_values_names_the_limit(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(LAUGHS)
    with pytest.raises(ValueError, match=r"\(more than 100000 values, or more than 50 levels\)"):
        read_yaml(path)


def test_plain_yaml_is_read(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: &a {b: [1, 2.5, null, yes, text]}\nc: *a\n", encoding="utf-8")
    inner = {"b": [1, 2.5, None, True, "text"]}
    assert read_yaml(path) == {"a": inner, "c": inner}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", r"'bad\.yaml' cannot be read as YAML"),
        ("[1]", r"configuration 'bad\.yaml' must be a mapping with the keys"),
        ("model: 3", r"'model' of configuration 'bad\.yaml' must be a mapping \(got 3\)"),
        ("trainer: [1]", r"'trainer' of configuration 'bad\.yaml' must be a mapping"),
        ("data: bad.yaml", "the section 'data' cannot be read"),
        ("data: {dataset: {class_path: nowhere.A}}", "the section 'data' cannot be read"),
        ("data: {bogus: 1}", "the section 'data' cannot be read"),
        ("data: {a: 1}\nseed_everything: [1]", r"'seed_everything' must be a number \(got \[1\]\)"),
        (
            "data: {dataset: {class_path: torch_geometric_tactile.datasets.FakeTactileDataset, "
            "init_args: {num_samples: null}}}",
            "the configuration cannot be used: TypeError|cannot be read",
        ),
    ],
)
def test_fit_shows_no_traceback_for_a_bad_configuration(
    tmp_path, monkeypatch, capsys, text, message
):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(text)
    try:
        status = main(["fit", "--config", "bad.yaml"])
    except SystemExit as stop:  # of the parser, which has explained it
        status = stop.code
    assert status in (1, 2)
    said = capsys.readouterr().err
    assert "error: " in said
    with pytest.raises(ValueError, match=message):
        raise ValueError(said)


@pytest.mark.parametrize(
    "text", ["a: [", "[1]", "data: 3", "data: {}", "data: text\nprotocols: 3", "data: [[1, 2, 3]]"]
)
def test_table_shows_no_traceback_for_a_bad_file(tmp_path, monkeypatch, capsys, text):
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text(text)
    assert main(["table", "bad.yaml"]) == 1
    assert "'bad.yaml'" in capsys.readouterr().err


@pytest.fixture
def checkpoint(tmp_path):
    return small_checkpoint(), tmp_path / "a.ckpt"


def test_checkpoint_is_loaded(checkpoint):
    content, path = checkpoint
    torch.save(content, path)
    assert isinstance(TactileModule.load_from_checkpoint(path).model, TactileFNN)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"state_dict": None}, "is not a checkpoint: it must hold 'state_dict'"),
        ({"state_dict": {}}, "RuntimeError: .*Missing key"),
        ({"state_dict": {"model.weight": 3}}, "a TactileModule cannot be built from"),
        ({"state_dict": {"model.weight": torch.zeros(3)}}, "a TactileModule cannot be built from"),
        ({"module": None}, r"Predictor\.from_checkpoint\(path\)"),
        ({"module": 3}, "until version 0.2.0"),
        ({"module": {}}, "KeyError: 'tensors'"),
        ({"layout": 3}, "a TactileModule cannot be built from"),
    ],
)
def test_checkpoint_with_other_contents_names_the_file(checkpoint, change, message):
    content, path = checkpoint
    torch.save({**content, **change}, path)
    with pytest.raises(ValueError, match=rf"(?s)a\.ckpt'.*{message}|{message}.*a\.ckpt"):
        TactileModule.load_from_checkpoint(path)
    torch.save([content], path)
    with pytest.raises(ValueError, match=r"a\.ckpt' is not a checkpoint"):
        TactileModule.load_from_checkpoint(path)


@pytest.mark.parametrize(
    ("entry", "change", "message"),
    [
        ("arguments", {"bogus": 3}, "TypeError: .*bogus"),
        ("arguments", {1: 3}, "TypeError: .*"),
        ("arguments", {"task": "torch.load"}, "'task' must be one of"),
        ("arguments", {"num_classes": 10**12}, "a TactileModule cannot be built"),
        ("description", {"class": "torch.nn.Linear"}, "there is no model 'torch.nn.Linear' in"),
        ("description", {"class": ["GraspGCN"]}, "a TactileModule cannot be built"),
        (
            "description",
            {"own": "OwnNet"},
            "'model' must be given: .* 'OwnNet' cannot be built",
        ),
    ],
)
def test_description_that_does_not_fit_names_the_file(checkpoint, entry, change, message):
    content, path = checkpoint
    content["module"][entry].update(change)
    torch.save(content, path)
    with pytest.raises(ValueError, match=rf"(?s)a\.ckpt'.*{message}|{message}.*a\.ckpt"):
        TactileModule.load_from_checkpoint(path)


def test_checkpoint_with_flipped_bits_is_refused_or_the_same(checkpoint):
    content, path = checkpoint
    torch.save(content, path)
    text = path.read_bytes()
    refused = 0
    for place in range(0, 8 * len(text), 397):
        flipped = bytearray(text)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        try:
            module = TactileModule.load_from_checkpoint(path)
        except ValueError:
            refused += 1
        else:
            for name, value in module.state_dict().items():
                assert torch.equal(value, content["state_dict"][name]), place
    assert refused > 20


def test_damaged_checkpoint_on_the_command_line(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    monkeypatch.chdir(tmp_path)
    config = fake_config("GraspGCN", 40, test=0.2, split="frame")
    Path("a.yaml").write_text(yaml.safe_dump(config))
    Path("cut.ckpt").write_bytes(b"PK\x03\x04" + bytes(100))
    for verb in (
        ["test", "--config", "a.yaml", "--ckpt_path", "cut.ckpt"],
        ["predict", "cut.ckpt"],
        ["analyze", "cut.ckpt", "--out", "out"],
    ):
        assert main(verb) == 1
        assert "cut.ckpt' is damaged or truncated" in capsys.readouterr().err
    torch.save({"state_dict": {}, "config": {}}, "other.ckpt")
    assert main(["test", "--config", "a.yaml", "--ckpt_path", "other.ckpt"]) == 1
    assert "checkpoint 'other.ckpt' cannot be used here" in capsys.readouterr().err


def test_limits_of_a_yaml_file(tmp_path, monkeypatch):
    path = tmp_path / "a.yaml"
    monkeypatch.setattr(_config_files, "_MAX_VALUES", 6)
    monkeypatch.setattr(_config_files, "_MAX_DEPTH", 2)
    path.write_text("a: [1, 2]\nb: 3\n")  # the mapping, the list and three numbers
    assert read_yaml(path) == {"a": [1, 2], "b": 3}
    path.write_text("a: [1, 2]\nb: 3\nc: 4\n")
    assert read_yaml(path) == {"a": [1, 2], "b": 3, "c": 4}
    path.write_text("a: [1, 2]\nb: 3\nc: 4\nd: 5\n")
    with pytest.raises(ValueError, match="more than 6 values, or more than 2 levels"):
        read_yaml(path)
    path.write_text("a: [[1]]\n")
    with pytest.raises(ValueError, match="more than 6 values, or more than 2 levels"):
        read_yaml(path)
