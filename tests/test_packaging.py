"""Requirements of the second wheel, and the check of the version before a build."""

import runpy
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


def version_problems(version, changelog):
    path = SOURCE / ".ci" / "check_version.py"
    if not path.is_file():
        pytest.skip("needs the source tree")
    return list(runpy.run_path(str(path))["problems"](version, changelog))


@pytest.mark.parametrize("version", ["0.3.0", "0.4.0.dev0", "0.10.0"])
def test_version_of_the_newest_release_or_later_is_built(version):
    changelog = "# Changelog\n\n## Unreleased\n\n## 0.3.0 (2026-11-29)\n\n- A line.\n"
    assert version_problems(version, changelog) == []


def test_version_older_than_the_changelog_is_refused():
    changelog = "# Changelog\n\n## 0.10.0 (2026-11-29)\n\n- A line.\n\n## 0.9.0 (2026-11-01)\n"
    (problem,) = version_problems("0.9.0", changelog)
    assert "must be at least '0.10.0'" in problem
    assert "(got '0.9.0')" in problem


def test_released_version_with_unreleased_changes_is_refused():
    changelog = "# Changelog\n\n## Unreleased\n\n- A line.\n\n## 0.3.0 (2026-11-29)\n\n- Older.\n"
    (problem,) = version_problems("0.3.0", changelog)
    assert "must be newer than '0.3.0', since CHANGELOG.md has unreleased changes" in problem
    assert version_problems("0.4.0.dev0", changelog) == []
