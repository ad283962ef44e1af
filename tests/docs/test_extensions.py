import base64
import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx")
pytest.importorskip("latex2mathml")

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "docs"), str(ROOT / "docs" / "_ext")]

import check_site  # noqa: E402
from api_pages import all_public_names, inherited_members, own_members, public_names  # noqa: E402
from inventories import inventory  # noqa: E402
from mathml import to_mathml  # noqa: E402
from repository_links import rewrite_links  # noqa: E402
from tutorial_pages import (  # noqa: E402
    gallery,
    shorten,
    site_notebook,
    thumbnail,
    title_and_summary,
)

REPOSITORY = "https://github.com/owner/name"


def rewrite(text: str, folder: str = "docs", page_folder: str = "") -> str:
    return rewrite_links(text, folder, page_folder, REPOSITORY, ROOT)


def test_mathml_block():
    text = to_mathml(r"a &= b \\ c &= d", block=True)
    assert text.startswith("<math")
    assert "mtable" in text


@pytest.mark.parametrize("latex", [r"\nosuchcommand x", r"\frac{a", r"\left( x", r"a & b"])
def test_mathml_refuses(latex):
    with pytest.raises(ValueError, match="formula"):
        to_mathml(latex)


@pytest.mark.parametrize(
    ("link", "target"),
    [
        ("../CONTRIBUTING.md#a-new-layer", "generated/contributing.md#a-new-layer"),
        ("../pyproject.toml", f"{REPOSITORY}/blob/main/pyproject.toml"),
        ("../benchmarks", f"{REPOSITORY}/tree/main/benchmarks"),
        ("live.md#rest", "live.md#rest"),
        ("images/roc.png", "images/roc.png"),
        ("https://pyg.org", "https://pyg.org"),
        ("#sources", "#sources"),
    ],
)
def test_links_outside_docs(link, target):
    assert rewrite(f"see [it]({link}) there") == f"see [it]({target}) there"


def test_links_of_copied_pages():
    text = rewrite("[a](docs/layers.md) [b](LICENSE)", "", "generated")
    assert text == f"[a](../layers.md) [b]({REPOSITORY}/blob/main/LICENSE)"


def test_links_in_code_stay():
    text = "```text\n[a](../LICENSE)\n```\n"
    assert rewrite(text) == text


def test_inventory_is_read_by_sphinx():
    from sphinx.util.inventory import InventoryFile

    content = inventory("torch", "# home\ntorch.nn.LSTM class generated/$.html#$\n")
    found = InventoryFile.loads(content, uri="https://docs")
    uri = found["py:class", "torch.nn.LSTM"].uri
    assert uri == "https://docs/generated/torch.nn.LSTM.html#torch.nn.LSTM"


def test_inventory_bad_line():
    with pytest.raises(ValueError, match=r"a name, a kind, a page \(got 'torch.nn.LSTM class'\)"):
        inventory("torch", "torch.nn.LSTM class\n")


def test_public_names_are_described_once():
    names = [one.full for one in all_public_names()]
    assert len(names) == len(set(names))
    splits = [one.name for one in public_names("data.splits")]
    assert "Fold" in splits
    assert "Protocol" not in splits


def test_members_without_those_of_other_libraries():
    full = "torch_geometric_tactile.nn.models.TaxelNet"
    assert "forward" in own_members(full)
    assert "parameters" not in own_members(full) + inherited_members(full)


def notebook(*cells: dict) -> dict:
    return {"cells": list(cells), "metadata": {}, "nbformat": 4, "nbformat_minor": 5}


def test_site_notebook():
    badge = "[![Colab](https://host/badge.svg)](https://host)\n"
    text = site_notebook(
        notebook(
            {"cell_type": "markdown", "source": f"# T: why?\n\n{badge}First.", "id": "a"},
            {"cell_type": "code", "source": "!pip", "outputs": [], "id": "install"},
        ),
        "01_t",
        REPOSITORY,
        ROOT,
    )
    assert "badge.svg" not in text
    assert "!pip" not in text
    assert "Open in Colab" in text


def test_badges_are_no_question():
    badge = "[![Colab](https://host/badge.svg)](https://host)\n"
    cell = {"cell_type": "markdown", "source": f"# T: why?\n\n{badge}{badge}\nFirst,\nhere.\n\nB"}
    assert title_and_summary(notebook(cell)) == ("T: why?", "First, here.")


def test_gallery_follows_what_was_run(tmp_path):
    from sphinx.application import Sphinx

    docs, runs = tmp_path / "docs", tmp_path / "runs"
    docs.mkdir()
    runs.mkdir()
    (docs / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT / 'docs' / '_ext')!r})\n"
        "extensions = ['myst_nb', 'sphinx_design', 'tutorial_pages']\nnb_execution_mode = 'off'\n"
        "repository_url = ''\ntutorial_folder = '../runs'\nroot_doc = 'tutorials_index'\n"
        "myst_enable_extensions = ['colon_fence']\n"
        "def setup(app): app.add_config_value('repository_url', '', 'env')\n"
    )
    (docs / "tutorials_index.md").write_text("# All\n\n<!-- gallery -->\n")
    title = {"cell_type": "markdown", "source": "# Why?\n\nSo.", "id": "a", "metadata": {}}
    picture = {"image/png": "iVBORw0KGgo="}
    outputs = [{"output_type": "display_data", "data": picture, "metadata": {}}]
    code = {"cell_type": "code", "source": "1", "id": "b", "metadata": {}, "execution_count": None}
    pages = []
    for outs in ([], outputs):
        content = notebook(title, {**code, "outputs": outs})
        content["metadata"]["processor_seconds"] = 20
        (runs / "01_t.ipynb").write_text(json.dumps(content))
        Sphinx(docs, docs, tmp_path / "html", tmp_path / "trees", "html", status=None).build()
        pages.append((tmp_path / "html" / "tutorials_index.html").read_text())
    assert ["<img" in page for page in pages] == [False, True]
    assert "20 s of processor time" in pages[1]


def test_thumbnail_is_the_tagged_picture_or_the_first():
    def drawing(letter, *tags):
        outputs = [{"data": {}}, {"data": {"image/png": base64.b64encode(letter).decode()}}]
        return {"cell_type": "code", "outputs": outputs, "metadata": {"tags": list(tags)}}

    empty = {"cell_type": "code", "outputs": [], "metadata": {}}
    assert thumbnail(notebook(empty)) is None
    assert thumbnail(notebook(empty, drawing(b"a"), drawing(b"b"))) == b"a"
    assert thumbnail(notebook(drawing(b"a"), drawing(b"b", "figure", "thumbnail"))) == b"b"


def test_gallery():
    assert "toctree" not in gallery([])
    assert shorten("One is long. Two.", size=8) == "One is long."


def test_words_of_a_page():
    table, code = "| a | b |\n|---|---|", "<!-- not run:\nlong -->\n```sh\nls .\n```"
    text = "One [link of](p.md#x) text."
    page = f"# Two words\n\n{table}\n\n{code}\n![a b](c.png)\n\n{text}"
    assert check_site.count_words(page) == 7  # with the '#'


def test_long_page_of_results(tmp_path):
    (tmp_path / "short.md").write_text("word " * 1500 + "\n\n| a cell |\n")
    assert check_site.check_lengths(tmp_path) == []
    (tmp_path / "long.md").write_text("word " * 1501)
    (problem,) = check_site.check_lengths(tmp_path)
    assert problem.startswith("long.md has 1,501 words outside its tables, more than 1,500")


def test_pages_of_results_are_short():
    assert check_site.check_lengths(ROOT / "docs" / "results") == []


def test_check_site_finds_foreign_and_broken(tmp_path):
    (tmp_path / "index.html").write_text(
        '<a href="no.html">a</a><script src="https://cdn.example/x.js"></script>'
        '<a href="#here">b</a><p id="here"></p>'
    )
    problems = check_site.check_pages(tmp_path)
    assert problems == [
        "index.html loads https://cdn.example/x.js",
        "index.html links to no.html, which does not exist",
    ]


@pytest.mark.parametrize(
    ("titles", "terms", "problems"),
    [
        ({"glove": 1, "my": 0}, {"glove": [0, 2]}, 0),
        ({"glove": [0, 2]}, {"glove": 1}, 1),  # in the text of the page only
        ({}, {}, 1),
    ],
)
def test_search_finds_a_page_by_a_heading(tmp_path, monkeypatch, titles, terms, problems):
    monkeypatch.setattr(check_site, "SEARCHES", {"My Glove": "gloves"})
    index = {"docnames": ["a", "gloves", "z"], "titleterms": titles, "terms": terms}
    (tmp_path / "searchindex.js").write_text(f"Search.setIndex({json.dumps(index)})")
    assert len(check_site.check_search(tmp_path)) == problems


def test_wide_tables_have_the_full_width(tmp_path):
    from sphinx.application import Sphinx

    (tmp_path / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT / 'docs' / '_ext')!r})\n"
        "extensions = ['myst_nb', 'wide_tables']\nroot_doc = 'narrow'\n"
    )
    for name, columns in (("narrow", 6), ("wide", 7)):
        rows = ["|" + " a |" * columns, "|" + "---|" * columns, "|" + " b |" * columns]
        (tmp_path / f"{name}.md").write_text("---\norphan: true\n---\n# T\n\n" + "\n".join(rows))
    app = Sphinx(tmp_path, tmp_path, tmp_path / "html", tmp_path / "trees", "html", status=None)
    app.build()
    is_removed = ["html_theme.sidebar_secondary.remove" in app.env.metadata[name]
                  for name in ("narrow", "wide")]  # fmt: skip
    assert is_removed == [False, True]
    assert "wide-table" in (tmp_path / "html" / "wide.html").read_text()
