"""The second wheel, of the parts that need no PyTorch, asks for what the whole package asks for."""

import tomllib
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1]


def project(folder):
    path = folder / "pyproject.toml"
    if not path.is_file():
        pytest.skip("needs the source tree")
    return tomllib.loads(path.read_text())["project"]


def test_requirements_of_the_live_wheel_are_those_of_the_whole():
    whole, live = project(SOURCE), project(SOURCE / "packaging" / "live")
    extras = whole["optional-dependencies"]
    known = {*whole["dependencies"], *extras["live"], *extras["export"]}
    assert set(extras["live"]) < set(live["dependencies"]) <= known
    # Both install `tactile`; the other name stays where the whole package is removed.
    (command,) = whole["scripts"].values()
    assert live["scripts"] == {"tactile": command, "tactile-live": command}
    assert whole["requires-python"] == live["requires-python"]
