"""Refuses to build distributions of a version that is older than CHANGELOG.md."""

import re
import sys
from pathlib import Path

from packaging.version import Version

ROOT = Path(__file__).parents[1]


def problems(version, changelog):
    """Yields why this version must not be built with this changelog."""
    newest = Version(re.search(r"^## (\d\S*)", changelog, re.MULTILINE)[1])
    unreleased = re.search(r"^## Unreleased\n(.*?)(?=^## )", changelog, re.MULTILINE | re.DOTALL)
    if Version(version) < newest:
        yield (
            f"'__version__' must be at least '{newest}', the newest version in CHANGELOG.md "
            f"(got '{version}')"
        )
    elif unreleased and unreleased[1].strip() and Version(version) == newest:
        yield (
            f"'__version__' must be newer than '{newest}', since CHANGELOG.md has unreleased "
            f"changes (got '{version}'); set the next development version, "
            f"'{newest.major}.{newest.minor + 1}.0.dev0', or move the changes to their release"
        )


if __name__ == "__main__":
    init = (ROOT / "torch_geometric_tactile" / "__init__.py").read_text(encoding="utf-8")
    version = re.search(r'__version__ = "(.*)"', init)[1]
    found = list(problems(version, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")))
    print("\n".join(found) or f"version {version} is not older than CHANGELOG.md")
    sys.exit(bool(found))
