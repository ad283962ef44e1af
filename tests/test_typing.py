import os
import subprocess
import sys
from pathlib import Path

import pytest

import torch_geometric_tactile

pytestmark = pytest.mark.full

ROOT = Path(torch_geometric_tactile.__file__).parents[1]
CONFIG = """
[mypy]
follow_imports = silent
[mypy-torch.*,torch_geometric.*,numpy.*,scipy.*,sklearn.*,lazy_loader.*,umap.*]
follow_imports = skip
ignore_missing_imports = True
"""
CODE = """
import torch_geometric_tactile
from torch_geometric_tactile import Predictor

reveal_type(Predictor.load("a.predictor"))
reveal_type(torch_geometric_tactile.nn)
torch_geometric_tactile.nothing
"""


@pytest.mark.slow
def test_type_checker_knows_what_loads_on_first_use(tmp_path):
    pytest.importorskip("mypy", reason="needs the extra 'dev'")
    (tmp_path / "mypy.ini").write_text(CONFIG)
    (tmp_path / "code.py").write_text(CODE)
    found = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"), "code.py"],
        cwd=tmp_path,
        env={**os.environ, "MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert 'type is "torch_geometric_tactile.predictor.predictor.Predictor"' in found.stdout
    assert 'type is "types.ModuleType"' in found.stdout
    assert 'Module has no attribute "nothing"' in found.stdout


def test_names_are_listed_for_completion():
    names = set(dir(torch_geometric_tactile))
    assert {"Predictor", "nn", "data", "datasets", "transforms", "live"} <= names
