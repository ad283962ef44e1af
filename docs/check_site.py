"""Checks the built site.

Every public name has a page, every local link leads somewhere, and nothing comes from another host.
A search for common words finds the page about them. Pages of results have at most 1,500 words
outside their tables.

python docs/check_site.py docs/build/html
"""

import argparse
import json
import re
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "_ext")]

from api_pages import PACKAGE, PublicName, all_public_names  # noqa: E402
from sphinx.search.en import SearchEnglish  # noqa: E402

# What a browser loads by itself, by tag and attribute. A link (`a`) is followed by the reader.
_LOADED = {
    ("script", "src"),
    ("img", "src"),
    ("img", "srcset"),
    ("source", "src"),
    ("source", "srcset"),
    ("iframe", "src"),
    ("embed", "src"),
    ("object", "data"),
    ("video", "src"),
    ("audio", "src"),
    ("use", "href"),
    ("image", "href"),
}
# What newcomers type into the search, and a page that has all the words, one of them in a heading.
SEARCHES = {
    "license": "licence",
    "licence": "licence",
    "cite": "citation",
    "gpu": "install",
    "csv": "your_own_data",
    "my own layout": "your_own_data",
    "quick start": "quick_start",
    "TaxelNet": "generated/api/torch_geometric_tactile.nn.models.TaxelNet",
}
MAX_RESULT_WORDS = 1500
# Tables, code, comments and pictures with their captions are not counted as words of a page.
_NOT_PROSE = re.compile(
    r"^(?P<fence>`{3,}).*?^(?P=fence) *$|<!--.*?-->|^\|.*?$|!\[[^\]]*\]\([^)]*\)",
    re.DOTALL | re.MULTILINE,
)
_LOADED_LINKS = {"stylesheet", "icon", "shortcut icon", "preload", "prefetch", "preconnect"}


class Page(HTMLParser):
    """What a page holds: anchors, links, and resources that a browser loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.resources: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Notes the anchor, the link or the resource of a tag."""
        values = {name: value or "" for name, value in attributes}
        self.anchors |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and values.get("href"):
            self.links.append(values["href"])
        if tag == "link" and values.get("rel") in _LOADED_LINKS:
            self.resources.append(values["href"])
        self.resources += [values[name] for name in values if (tag, name) in _LOADED]


@cache
def read_page(path: Path) -> Page:
    """Returns what a page holds."""
    return Page(path.read_text("utf-8"))


def check_names(site: Path, names: list[PublicName]) -> list[str]:
    """Returns the public names without a page or a link to their source, and pages of no name."""
    problems = []
    folder = site / "generated" / "api"
    for one in names:
        path = folder / f"{one.full}.html"
        if not path.is_file():
            problems.append(f"{one.full} has no page")
            continue
        page = read_page(path)
        if one.full not in page.anchors:
            problems.append(f"the page of {one.full} does not describe it")
        if not any("_modules/" in link or "/blob/main/" in link for link in page.links):
            problems.append(f"the page of {one.full} has no link to the source")
    known = {one.full for one in names}
    strays = sorted(path.stem for path in folder.glob("*.html") if path.stem not in known)
    return problems + [f"the page {name} is of no public name" for name in strays]


def check_summaries(site: Path, names: list[PublicName]) -> list[str]:
    """Returns the public names whose row in the table of their package has no summary."""
    problems = []
    for module in sorted({one.module for one in names}):
        path = site / "generated" / f"{module.removeprefix(f'{PACKAGE}.')}.html"
        text = path.read_text("utf-8")
        for one in names:
            if one.module != module or one.kind == "alias":
                continue
            link = rf'<td><p><a [^>]*title="{re.escape(one.full)}">'
            row = re.search(rf"{link}.*?</td>\s*<td><p>(.*?)</p>", text, re.DOTALL)
            if row is None or not row[1]:
                problems.append(f"{one.full} has no summary in {path.name}")
    return problems


def check_pages(site: Path) -> list[str]:
    """Returns the local links that lead nowhere, and what is loaded from another host."""
    problems = []
    for path in sorted(site.rglob("*.html")):
        name = path.relative_to(site)
        if name.parts[0] == "_static":  # templates of the theme
            continue
        page = read_page(path)
        problems += [
            f"{name} loads {address}"
            for address in page.resources
            if urlsplit(address).scheme not in ("", "data") or address.startswith("//")
        ]
        for address in {*page.links, *page.resources}:
            if not _exists(path, address, site):
                problems.append(f"{name} links to {address}, which does not exist")
    for path in [*site.rglob("*.css"), *site.rglob("*.svg")]:
        text = path.read_text("utf-8", errors="replace")
        if any(f"{start}{host}" in text for start in ("url(", "url('", 'url("', "@import '")
               for host in ("http:", "https:", "//")):  # fmt: skip
            problems.append(f"{path.relative_to(site)} loads from another host")
    return problems


def check_search(site: Path) -> list[str]:
    """Returns the searches of newcomers that do not find their page by a heading."""
    script = (site / "searchindex.js").read_text("utf-8")
    index = json.loads(script.removeprefix("Search.setIndex(").removesuffix(")"))
    language = SearchEnglish({})
    problems = []
    for query, page in SEARCHES.items():
        words = {
            language.stem(word.lower())
            for word in query.split()
            if word.lower() not in language.stopwords
        }
        in_headings = {word for word in words if _has_word(index, "titleterms", word, page)}
        in_text = {word for word in words if _has_word(index, "terms", word, page)}
        if not in_headings or in_headings | in_text != words:
            problems.append(f"a search for {query!r} does not find {page} by a heading")
    return problems


def _has_word(index: dict[str, Any], kind: str, word: str, page: str) -> bool:
    # A word of one page has a number, a word of several pages a list.
    numbers = index[kind].get(word, [])
    numbers = numbers if isinstance(numbers, list) else [numbers]
    return page in index["docnames"] and index["docnames"].index(page) in numbers


def _exists(path: Path, address: str, site: Path) -> bool:
    parts = urlsplit(address)
    if parts.scheme or parts.netloc:
        return True
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if site.resolve() not in target.resolve().parents or not target.is_file():
        return False
    anchor = unquote(parts.fragment)
    return not anchor or target.suffix != ".html" or anchor in read_page(target).anchors


def count_words(text: str) -> int:
    """Returns the words of a Markdown page outside tables, code, comments and pictures."""
    return len(_NOT_PROSE.sub(" ", text).split())


def check_lengths(folder: Path) -> list[str]:
    """Returns the Markdown pages of a folder that have too many words."""
    num_words = {path: count_words(path.read_text("utf-8")) for path in sorted(folder.glob("*.md"))}
    return [
        f"{path.name} has {number:,} words outside its tables, more than {MAX_RESULT_WORDS:,}: "
        "leave out what no conclusion uses"
        for path, number in num_words.items()
        if number > MAX_RESULT_WORDS
    ]


def check_site(site: Path) -> list[str]:
    """Returns everything that is wrong with a built site."""
    names = all_public_names()
    return [
        *check_names(site, names),
        *check_summaries(site, names),
        *check_pages(site),
        *check_search(site),
        *check_lengths(DOCS / "results"),
    ]


def main() -> int:
    """Prints what is wrong, or the number of pages; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("site", type=Path, help="the folder of the built site")
    site = parser.parse_args().site.resolve()
    problems = check_site(site)
    for problem in problems:
        print(problem, file=sys.stderr)
    pages = len([*site.rglob("*.html")])
    sources = len([*(site / "_modules").rglob("*.html")])
    print(
        f"{pages} pages, {len(all_public_names())} of them public names and {sources} sources; "
        f"{len(problems)} problems"
    )
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
