import importlib
import importlib.metadata
import subprocess
import sys
import types
import zipfile

import pytest

from torch_geometric_tactile._sources import has_source, source_hash, user_sources

FILES = {
    "my_nets.py": "import helpers\nfrom pack import inner\nclass MyNet: pass\n",
    "helpers.py": "GAIN = 1.0\ndef helper(x):\n    import late\n    return GAIN * x\n",
    "late.py": "NUMBER = 1\n",
    "pack/__init__.py": "",
    "pack/inner.py": "from . import sibling\nfrom .deep.leaf import f\n",
    "pack/sibling.py": "import my_nets  # a cycle\n",
    "pack/deep/__init__.py": "from ..sibling import *\n",
    "pack/deep/leaf.py": "def f(): pass\n",
    "pack/unused.py": "",
    "unrelated.py": "",
}
IMPORTED = {
    *("my_nets", "helpers", "late", "pack", "pack.inner", "pack.sibling", "pack.deep"),
    "pack.deep.leaf",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name.partition(".")[0] in {"my_nets", "helpers", "late", "pack", "made"}:
            del sys.modules[name]


def sources(name="my_nets.MyNet"):
    return user_sources([name])


def test_all_modules_that_are_imported_count_and_none_is_imported(folder):
    assert sources().modules.keys() == IMPORTED
    assert sources().unknown == {}
    assert not {"my_nets", "pack"} & sys.modules.keys()


def test_same_source_has_the_same_hashes_once_it_is_imported(folder):
    before = sources()
    importlib.import_module("my_nets")
    assert sources() == before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("my_nets.py", "pass", "x = 1"),
        ("helpers.py", "GAIN * x", "GAIN + x"),  # a helper
        ("helpers.py", "GAIN = 1.0", "GAIN = 2.0"),  # a constant
        ("late.py", "1", "2"),  # imported in a function
        ("pack/__init__.py", "", "x = 1\n"),
        ("pack/sibling.py", "cycle", "comment"),
        ("pack/deep/leaf.py", "pass", "return 1"),  # of a relative import
    ],
)
def test_edited_module_has_another_hash(folder, file, old, new):
    before = sources().modules
    path = folder / file
    path.write_text(path.read_text().replace(old, new, 1) if old else new)
    name = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    after = sources().modules
    assert {key for key in before if before[key] != after[key]} == {name}


@pytest.mark.parametrize("file", ["unrelated.py", "pack/unused.py"])
def test_unrelated_module_does_not_count(folder, file):
    before = sources()
    (folder / file).write_text("x = 1\n")
    assert sources() == before


@pytest.mark.parametrize(
    "statement",
    [
        "import importlib; importlib.import_module('unrelated')",
        "__import__('unrelated')",
        "try:\n    import unrelated, missing\nexcept ImportError: pass",
        "from unrelated import *",
    ],
)
def test_forms_of_imports(folder, statement):
    (folder / "late.py").write_text(statement + "\n")
    assert "unrelated" in sources().modules


def test_names_in_all_of_a_package_may_be_modules(folder):
    (folder / "pack/__init__.py").write_text("__all__ = ['unused']\n")
    assert "pack.unused" in sources().modules


def test_module_with_a_syntax_error_counts_by_its_text(folder):
    (folder / "late.py").write_text("def (\n")
    before = sources().modules
    (folder / "late.py").write_text("def ((\n")
    assert before["late"] != sources().modules["late"]
    (folder / "late.py").write_bytes(b"\0")
    assert "late" in sources().modules


def test_a_package_without_init_is_followed(folder):
    (folder / "space").mkdir()
    (folder / "space/net.py").write_text("class Net: pass\n")
    found = sources("space.net.Net")
    assert (found.modules.keys(), found.unknown) == ({"space.net"}, {})


def test_libraries_are_told_by_version(folder):
    pytest.importorskip("yaml", reason="needs the extra 'train'")
    (folder / "late.py").write_text("import yaml\nimport json\n")
    found = sources()
    assert found.libraries == {"PyYAML": importlib.metadata.version("PyYAML")}
    assert found.modules.keys() == IMPORTED
    assert sources("sklearn.svm.SVC").libraries.keys() == {"scikit-learn"}


def test_library_of_others_that_is_installed_in_place_counts_by_its_files(folder, tmp_path):
    class Finder:  # as of 'pip install -e'
        @staticmethod
        def find_spec(name, path=None, target=None):
            file = folder / "unrelated.py"
            is_mine = name == "editable"
            return importlib.util.spec_from_file_location(name, file) if is_mine else None

    sys.meta_path.append(Finder)
    try:
        assert sources("editable.Net").modules.keys() == {"editable"}
    finally:
        sys.meta_path.remove(Finder)


@pytest.mark.parametrize("name", ["__main__.Net", "made.Net", "native.Net"])
def test_without_source_it_is_unknown(folder, name):
    sys.modules["made"] = types.ModuleType("made")
    (folder / f"native{importlib.machinery.EXTENSION_SUFFIXES[0]}").write_bytes(b"\x7fELF")
    found = sources(name)
    assert (found.modules, found.unknown.keys()) == ({}, {name.partition(".")[0]})


def test_zip_file_has_source(tmp_path, monkeypatch):
    with zipfile.ZipFile(tmp_path / "nets.zip", "w") as file:
        file.writestr("zipped_nets.py", "import json\nclass Net: pass\n")
    monkeypatch.syspath_prepend(tmp_path / "nets.zip")
    assert sources("zipped_nets.Net").modules.keys() == {"zipped_nets"}


def test_file_that_was_edited_after_its_import_is_not_what_runs(folder):
    module = importlib.import_module("late")
    before = sources("late.f")
    (folder / "late.py").write_text("NUMBER = 200\n")
    after = sources("late.f")
    assert after.modules == before.modules  # those of the code that runs
    assert "edited after it was imported" in after.unknown["late"]
    importlib.reload(module)
    assert sources("late.f").unknown == {}
    assert sources("late.f").modules != before.modules


@pytest.mark.parametrize("text", ["", "trial", "a b.c", "3.5", "grasps/a.npz", "no.such.module"])
def test_texts_that_are_no_import_paths(text):
    assert sources(text) == ({}, {}, {})


def test_mark_of_a_class_follows_its_base_classes(folder):
    base = importlib.import_module("my_nets").MyNet
    alone, child = (type("Net", bases, {"__module__": "unrelated"}) for bases in ((), (base,)))
    assert source_hash(alone) != source_hash(child)
    assert source_hash(dict) == source_hash(len) == ""


def test_what_has_source(folder):
    assert has_source(importlib.import_module("my_nets").MyNet)
    assert has_source(dict)
    assert not has_source(type("Made", (), {"__module__": "__main__"}))


def test_hashes_are_those_of_another_process(folder):
    code = "from torch_geometric_tactile._sources import user_sources as f; print(f(['my_nets.X']))"
    told = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)
    assert told.stdout.strip() == str(sources())
