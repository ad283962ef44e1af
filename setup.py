r"""Makes the links of the README absolute for the package index; all else is in pyproject.toml."""

import re
from pathlib import Path

from setuptools import setup

_REPOSITORY = "torch-geometric-tactile/torch_geometric_tactile"
_PAGES = f"https://github.com/{_REPOSITORY}/blob/main/"
_INIT = Path(__file__).parent / "torch_geometric_tactile" / "__init__.py"
_VERSION = re.search(r'__version__ = "(.*)"', _INIT.read_text(encoding="utf-8"))[1]
# Of the tag: an index shows the page of a release for good, and pictures of `main` change.
_IMAGES = f"https://raw.githubusercontent.com/{_REPOSITORY}/v{_VERSION}/"


def _absolute(page: str) -> str:
    page = re.sub(r"(!\[[^\]]*\]\()(?!https?:|#)", rf"\g<1>{_IMAGES}", page)
    page = re.sub(
        r'(<(?:img|source)\b[^>]*?\b(?:src|srcset)=")(?!https?:)', rf"\g<1>{_IMAGES}", page
    )
    page = re.sub(r'(<a\b[^>]*?\bhref=")(?!https?:|#)', rf"\g<1>{_PAGES}", page)
    return re.sub(r"(?<!!)(\[[^\]]*\]\()(?!https?:|#)", rf"\g<1>{_PAGES}", page)


setup(
    long_description=_absolute((Path(__file__).parent / "README.md").read_text(encoding="utf-8")),
    long_description_content_type="text/markdown",
)
