"""Names and options of earlier versions, which tell what to use now."""

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

import torch_geometric_tactile
from torch_geometric_tactile import _removed
from torch_geometric_tactile._removed import (
    MOVED_MODULES,
    PRIVATE_NAMES,
    REPLACEMENTS,
    removed_names,
)
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.nn import GraspGCN

MIGRATION = Path(__file__).parents[1] / "docs" / "migration.md"
NAMES = [name for name in REPLACEMENTS if not name.startswith("tactile ")]
COMMANDS = [name for name in REPLACEMENTS if name.startswith("tactile ")]


@pytest.mark.parametrize("name", NAMES)
def test_removed_name_is_an_error_that_says_what_to_do(name):
    package, _, attribute = name.rpartition(".")
    if package in ("experiments", "papers", "training"):
        pytest.importorskip("lightning", reason="needs the extra 'train'")
    module = import_module(f"torch_geometric_tactile.{package}")
    message = re.escape(f"'{name}' was removed in version 0.3.0: {REPLACEMENTS[name]}")
    with pytest.raises(AttributeError, match=message):
        getattr(module, attribute)
    with pytest.raises(ImportError, match=message):
        exec(f"from {module.__name__} import {attribute}")
    assert attribute not in dir(module)


@pytest.mark.parametrize("package", sorted({name.partition(".")[0] for name in PRIVATE_NAMES}))
def test_private_name_is_an_error_with_the_line_that_imports_it(package):
    if package in ("experiments", "training"):
        pytest.importorskip("lightning", reason="needs the extra 'train'")
    if package == "sim":
        pytest.importorskip("mujoco", reason="needs the extra 'sim'")
    module = import_module(f"torch_geometric_tactile.{package}")
    for name in (name for name in PRIVATE_NAMES if name.startswith(f"{package}.")):
        attribute = name.partition(".")[2]
        assert not hasattr(module, attribute)
        with pytest.raises(ImportError, match=f"'{name}' is private since") as caught:
            exec(f"from {module.__name__} import {attribute}")
        exec(str(caught.value).partition("may change: ")[2])
        assert attribute not in module.__all__


@pytest.mark.parametrize("method", ["from_pretrained", "save_pretrained", "push_to_hub"])
def test_removed_method_of_models_is_an_error_that_says_what_to_do(method):
    for model in (GraspGCN, GraspGCN()):
        with pytest.raises(AttributeError, match=r"removed in version 0\.3\.0: .*Predictor\.save"):
            getattr(model, method)("folder")


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("value", [["x"], []])
def test_removed_option_is_an_error_that_says_what_to_do(command, value, capsys):
    argv = command.split()[1:]
    argv[-1:] = (
        [f"{argv[-1]}=x"] if not value and argv[-1].startswith("--") else [*argv[-1:], *value]
    )
    with pytest.raises(SystemExit) as stop:
        main(argv)
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert f"'{command}' was removed in version 0.3.0: {REPLACEMENTS[command]}" in error


@pytest.mark.parametrize("name", REPLACEMENTS)
def test_migration_page_has_every_removed_name(name):
    rows = [line for line in MIGRATION.read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    assert any(f"`{name}`" in row.split("|")[1] for row in rows)


@pytest.mark.parametrize(
    "earlier",
    ["io.wide_csv", "sensors.checks", "predictor.content", "papers._grasp_twin"],
)
def test_moved_module_is_imported_by_its_earlier_name(earlier, monkeypatch):
    if earlier.startswith("papers."):
        pytest.importorskip("lightning", reason="needs the extra 'train'")
    earlier = f"torch_geometric_tactile.{earlier}"
    present = import_module(MOVED_MODULES[earlier])
    monkeypatch.delitem(sys.modules, earlier, raising=False)
    with pytest.warns(DeprecationWarning, match=f"'{earlier}' is private .* '{present.__name__}'"):
        assert import_module(earlier) is present
    assert present.__spec__.name == present.__name__ == MOVED_MODULES[earlier]


def test_migration_page_has_every_private_name():
    page = MIGRATION.read_text(encoding="utf-8")
    assert [name for name in PRIVATE_NAMES if f"`{name.partition('.')[2]}`" not in page] == []


def test_names_that_never_existed_are_attribute_errors(monkeypatch):
    monkeypatch.setitem(_removed.REPLACEMENTS, "io.old_reader", "use read_recording")
    get = removed_names("torch_geometric_tactile.io")
    with pytest.raises(AttributeError, match=r"'io\.old_reader' was removed .*: use read_record"):
        get("old_reader")
    with pytest.raises(AttributeError, match=r"'torch_geometric_tactile.io' has no .*'nothing'"):
        get("nothing")
    assert removed_names("torch_geometric_tactile.io", str.upper)("nothing") == "NOTHING"


def test_errors_are_there_for_one_release():
    assert torch_geometric_tactile.__version__.split(".")[:2] <= ["0", "3"]
