"""Arguments that name files: each is declared, nothing that is read is replaced, nor any file of
another kind."""

import argparse
import os
from pathlib import Path

import numpy as np
import pytest
from listed_outputs import command_modules, parser_of

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.commands import _file_kinds as kinds
from torch_geometric_tactile.commands._paths import (
    InputPath,
    OutputFile,
    OutputPath,
    check_paths,
    expand_home,
    input_path,
    input_setting,
    input_source,
    recording_file,
)
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.nn.models import TaxelNet
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.sensors import grid

MODULES = command_modules()
NOT_OURS = b"notes of a user\n"


def taking_text(module):
    return [
        action
        for action in parser_of(module)._actions
        if action.nargs != 0 and action.choices is None
    ]


def value_of(action):
    text = "x=y.yaml" if action.type is input_setting else "x.yaml"
    try:
        return action.type(text)
    except argparse.ArgumentTypeError:  # a number
        return None
    except ValueError:
        return None


def is_input(action):
    return isinstance(value_of(action), InputPath)


def is_output(action):
    return isinstance(value_of(action), OutputPath)


def words(action, text):
    return [action.option_strings[-1], text] if action.option_strings else [text]


def command_line(name, given, folder):
    """A command line with the required arguments, and those that are given by their dest."""
    line = []
    for action in sorted(parser_of(MODULES[name])._actions, key=lambda a: bool(a.option_strings)):
        if action.nargs == 0:
            continue
        if action.dest in given:
            line += words(action, given[action.dest])
        elif action.required and action.nargs != "?":
            fresh = folder / f"{action.dest}.yaml"
            if is_input(action):
                fresh.write_bytes(NOT_OURS)
            line += words(action, str(fresh))
    return [*name.split(), *line]


@pytest.mark.parametrize("name", MODULES)
def test_every_argument_says_whether_it_is_a_path(name):
    undeclared = [a.option_strings or a.metavar for a in taking_text(MODULES[name]) if not a.type]
    assert not undeclared, "give these a type of commands/_paths.py, or str if they are no paths"


@pytest.mark.parametrize(
    ("name", "source", "target"),
    [
        (name, source.dest, target.dest)
        for name, module in MODULES.items()
        for source in filter(is_input, taking_text(module))
        for target in filter(is_output, taking_text(module))
        if value_of(target).kind is not None
    ],
)
def test_no_command_replaces_what_it_reads(name, source, target, tmp_path, capsys):
    path = tmp_path / "a.yaml"
    path.write_bytes(NOT_OURS)
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    actions = {action.dest: action for action in taking_text(MODULES[name])}
    text = f"x={link}" if actions[source].type is input_setting else str(link)
    given = {source: text, target: str(path)}
    if name == "replay":
        given["file"] = str(link)
    assert main(command_line(name, given, tmp_path)) == 1
    assert "must not replace an input file: choose another name" in capsys.readouterr().err
    assert path.read_bytes() == NOT_OURS


@pytest.mark.parametrize(
    ("name", "target"),
    [
        (name, target.dest)
        for name, module in MODULES.items()
        for target in filter(is_output, taking_text(module))
        if value_of(target).kind is not None
    ],
)
def test_no_command_replaces_a_file_of_another_kind(name, target, tmp_path, capsys):
    path = tmp_path / "mine.h5"
    path.write_bytes(NOT_OURS)
    assert main(command_line(name, {target: str(path)}, tmp_path)) == 1
    error = capsys.readouterr().err
    assert "' must be a new file, or replace " in error
    assert path.read_bytes() == NOT_OURS


@pytest.mark.parametrize("name", [n for n, m in MODULES.items() if hasattr(m, "list_outputs")])
def test_no_file_of_another_kind_is_replaced_within_a_folder(name, tmp_path, monkeypatch, capsys):
    if name == "table":
        pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    monkeypatch.chdir(tmp_path)
    module, out = MODULES[name], tmp_path / "out"
    out.mkdir()
    given = {"out": str(out)} if name not in ("predict", "inspect") else {}
    for action in taking_text(module):
        if action.dest == "recordings":
            (tmp_path / "r.csv").write_bytes(NOT_OURS)
            given["recordings"] = "r.csv"
        if action.dest == "name":
            given["name"] = "bts3"
        if action.dest == "sources":
            (tmp_path / "in").mkdir()
            (tmp_path / "in" / "cup_1.h5").write_bytes(NOT_OURS)
            given["sources"] = str(tmp_path / "in")
    line = command_line(name, given, tmp_path)
    parsed = parser_of(module).parse_args(line[len(name.split()) :])
    outputs = module.list_outputs(parsed)
    assert outputs
    for output in outputs:
        path = Path(output)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(NOT_OURS)
        assert main(line) == 1
        assert f"(got '{path}', which is a file of another kind)" in capsys.readouterr().err
        assert path.read_bytes() == NOT_OURS
        path.unlink()


@pytest.mark.parametrize(
    "name", [n for n, m in MODULES.items() if any(map(is_output, taking_text(m)))]
)
def test_outputs_that_cannot_be_written_are_errors_before_the_run(name, tmp_path, capsys):
    if name == "table":
        pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    file = tmp_path / "file"
    file.write_bytes(NOT_OURS)
    for action in filter(is_output, taking_text(MODULES[name])):
        is_folder = value_of(action).kind is None
        places = (file, file / "below") if is_folder else (tmp_path, file / "x.yaml")
        for place in places:
            given = {action.dest: str(place)}
            if name == "table":
                given["name"] = "bts3"
            assert main(command_line(name, given, tmp_path)) == 1
            error = capsys.readouterr().err
            assert "' must be a f" in error or "' must be in a writable folder" in error, name
    assert file.read_bytes() == NOT_OURS


def outputs_of(inputs, output, kind=kinds.PREDICTOR):
    arguments = argparse.Namespace(
        inputs=[input_path(str(path)) for path in inputs],
        save=OutputFile("--save", kind)(str(output)),
    )
    return check_paths(arguments)


@pytest.mark.parametrize("way", ["same", "dots", "relative", "symlink", "hard link", "folder link"])
def test_one_file_by_several_names(way, tmp_path, monkeypatch):
    path = tmp_path / "data" / "a.npz"
    path.parent.mkdir()
    path.write_bytes(NOT_OURS)
    monkeypatch.chdir(tmp_path)
    os.symlink(path, tmp_path / "s.npz")
    os.link(path, tmp_path / "h.npz")
    os.symlink(path.parent, tmp_path / "other")
    output = {
        "same": path,
        "dots": tmp_path / "data" / ".." / "data" / "a.npz",
        "relative": "./data/a.npz",
        "symlink": tmp_path / "s.npz",
        "hard link": tmp_path / "h.npz",
        "folder link": "other/a.npz",
    }[way]
    with pytest.raises(ValueError, match="'--save' must not replace an input file"):
        outputs_of([path], output)


def test_what_a_configuration_names_is_read(tmp_path, monkeypatch):
    pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    monkeypatch.chdir(tmp_path)
    Path("a.npz").write_bytes(NOT_OURS)
    Path("data").mkdir()
    Path("run.yaml").write_text("data: {path: [a.npz], root: data}\nlog: runs\n")
    with pytest.raises(ValueError, match="must not replace an input file"):
        outputs_of(["run.yaml"], "a.npz")
    with pytest.raises(ValueError, match="must not replace an input file"):
        outputs_of(["run.yaml"], "run.yaml")
    with pytest.raises(ValueError, match="must lie outside of the folder 'data'"):
        outputs_of(["run.yaml"], "data/x.csv")
    run = Path("runs", "version_0")
    (run / "checkpoints").mkdir(parents=True)
    checkpoint = run / "checkpoints" / "last.ckpt"
    checkpoint.write_bytes(NOT_OURS)
    (run / "config.yaml").write_text("data: {path: a.npz}")
    with pytest.raises(ValueError, match="must not replace an input file"):
        outputs_of([checkpoint], "a.npz")


def test_no_recording_is_added_to_a_folder_that_is_read(tmp_path):
    folder = tmp_path / "grasps"
    folder.mkdir()
    with pytest.raises(ValueError, match=r"'--save' must lie outside of the folder '.*grasps'"):
        outputs_of([folder], folder / "new.CSV")
    outputs_of([folder], folder / "best.predictor")
    outputs_of([folder], folder / "results" / "new.csv")


def test_files_of_the_same_kind_are_replaced(tmp_path):
    pytest.importorskip("h5py", reason="needs the extra 'io'")
    recording = Recording(time=np.arange(3) / 100, tactile=np.ones((3, 4, 3)))
    for suffix in (".h5", ".npz", ".mcap", ".csv", ".jsonl"):
        path = tmp_path / f"a{suffix}"
        write_recording(recording, path)
        assert kinds.RECORDING.matches(path), suffix
        other = tmp_path / f"{suffix[1:]}.predictor"
        other.write_bytes(path.read_bytes())
        for kind in (kinds.PREDICTOR, kinds.CALIBRATION, kinds.PICTURE, kinds.ONNX_MODEL):
            assert not kind.matches(other), (suffix, kind.name)
    layout = grid(2, 2, 0.004)
    model = tmp_path / "a.predictor"
    Predictor(TaxelNet(layout, in_channels=1, out_channels=2), layout, num_channels=1).save(model)
    assert kinds.PREDICTOR.matches(model)
    assert not kinds.PREDICTIONS.matches(model)
    outputs_of([], model)
    empty = tmp_path / "empty"
    empty.touch()
    outputs_of([], empty)


def test_foreign_files_of_our_suffixes_are_no_recordings(tmp_path):
    h5py = pytest.importorskip("h5py", reason="needs the extra 'io'")
    np.savez(tmp_path / "a.npz", x=np.ones(3))
    (tmp_path / "a.csv").write_text("name,phone\n")
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (tmp_path / "a.jsonl").write_text('{"name": 1}\n')
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["weights"] = 1
    for path in tmp_path.iterdir():
        assert not kinds.RECORDING.matches(path), path


def test_the_home_folder_is_expanded(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert OutputFile("--save", kinds.PREDICTOR)("~/x") == f"{tmp_path}/x"
    assert input_setting("root=~/x") == f"root={tmp_path}/x"
    assert input_setting("root=~/x").path == f"{tmp_path}/x"
    source = input_source("file:~/a%20b.h5?speed=2")
    assert (source, source.path) == (f"file:{tmp_path}/a%20b.h5?speed=2", f"{tmp_path}/a b.h5")
    assert input_source("ws://127.0.0.1:5000") == "ws://127.0.0.1:5000"
    for word, expanded in (
        ("--out=~/runs", f"--out={tmp_path}/runs"),
        ("~/a.yaml", f"{tmp_path}/a.yaml"),
        ("--data.x", "--data.x"),
        ("--x=a~b", "--x=a~b"),
    ):
        assert expand_home(word) == expanded
    recording = Recording(time=np.arange(3) / 100, tactile=np.ones((3, 4, 3)))
    write_recording(recording, tmp_path / "a.npz")
    assert main(["convert", "~/a.npz", "~/b.npz"]) == 0
    assert (tmp_path / "b.npz").is_file()


def test_commands_get_plain_texts(tmp_path):
    arguments = argparse.Namespace(
        data=input_path("a"), init=[input_setting("x=y")], out=recording_file("--out")("b"), n=3
    )
    plain = check_paths(arguments)
    assert vars(plain) == {"data": "a", "init": ["x=y"], "out": "b", "n": 3}
    assert {type(plain.data), type(plain.init[0]), type(plain.out)} == {str}
