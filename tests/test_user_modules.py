"""Modules of the working directory are found by name and never take the place of installed ones,
here and in the processes that are started."""

import subprocess
import sys

import pytest

SHADOWS = ("joblib", "json", "numpy", "random", "scipy", "sklearn", "tabulate", "torch", "yaml")


@pytest.fixture
def folder(tmp_path):
    """A folder with files that tell when they are imported, and with a module of a user."""
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text(f"open('RAN', 'a').write('{name} ')\n")
    (tmp_path / "my_things.py").write_text("NUMBER = 7\ndef double(x): return 2 * x\n")
    return tmp_path


def run(folder, code):
    # The search path of an installed command: without the working directory.
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert not (folder / "RAN").exists(), (folder / "RAN").read_text()
    return done.stdout.strip()


def test_own_module_is_found_behind_all_others(folder):
    for name in ("tabulate", "yaml"):
        pytest.importorskip(name, reason="needs the extra 'train'")
    code = (
        "import sys; from torch_geometric_tactile._user_modules import import_user_module\n"
        "before = list(sys.path); import_user_module('json'); assert sys.path == before\n"
        "print(import_user_module('my_things').NUMBER, sys.path[-1], sys.path[:-1] == before)\n"
        "import tabulate, yaml, scipy\n"
        "try: import_user_module('my_other_things')\n"
        "except ModuleNotFoundError as error: print(error)"
    )
    assert run(folder, code).splitlines() == [
        f"7 {folder} True",
        "No module named 'my_other_things'",
    ]


def test_workers_of_joblib_import_nothing_of_the_working_directory(folder):
    pytest.importorskip("joblib", reason="needs the extra 'train'")
    code = (
        "from torch_geometric_tactile._parallel import run_parallel\n"
        "print(sorted(run_parallel(abs, [-1, 2, -3], 2)))"
    )
    assert run(folder, code) == "[1, 2, 3]"


@pytest.mark.full
def test_measuring_worker_imports_nothing_of_the_working_directory_but_own_models(folder):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    code = (
        "from torch_geometric_tactile.experiments import _worker as worker\n"
        "worker._START = worker._START.replace('run_worker()', '"
        "from torch_geometric_tactile.experiments._building import find_class; "
        'print(find_class("my_things.double")(4))\')\n'
        "print(worker._Process(1)._popen.communicate(timeout=200)[0].decode())"
    )
    assert run(folder, code) == "8"
