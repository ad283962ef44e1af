"""Every Python and shell block of the pages runs, or says why not and is checked.

Those of the README run in test_readme.py.
"""

import os
import re
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from markdown_pages import (
    ROOT,
    Block,
    all_pages,
    blocks_of,
    check_command,
    commands,
    dangling_markers,
    pages,
    prose_of,
    run_block,
    run_page,
)
from markdown_stages import CHECKS, EXTRAS, FULL, SLOW, STAGES

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.datasets import BioTacSP

BIGS = ROOT / "docs" / "bigs.md"
NEEDS_BTS3 = {"docs/quick_start.md"}


def _page(name):
    marks = [pytest.mark.slow] * (name in SLOW) + [pytest.mark.slow, pytest.mark.full] * (
        name in FULL
    )
    return pytest.param(name, marks=marks)


@pytest.fixture
def bts3_files(private_cache, write_bts3, monkeypatch):
    """The six files of BioTacSP where it looks for them: the published ones, or small ones."""
    shared = ROOT.parent / "shared" / "data"
    folder = os.environ.get("TACTILE_TEST_DATA") or shared / "biotacsp"
    root = Path(os.environ["TACTILE_DATA"], "BioTacSP")
    if not BioTacSP.import_raw(folder, root):
        write_bts3(root / "raw", rows=40)
        monkeypatch.setattr(BioTacSP, "_verify", lambda self: None)


@pytest.mark.parametrize("name", [_page(name) for name in pages() if name != "README.md"])
@pytest.mark.filterwarnings("ignore")
def test_blocks_run(name, request, tmp_path, monkeypatch, capsys):
    for module in EXTRAS.get(name, ()):
        pytest.importorskip(module, reason=f"the page {name} needs it")
    if name in NEEDS_BTS3:
        request.getfixturevalue("bts3_files")
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 (pages draw from it)
    module = ModuleType("page")  # PyG looks for the module of a layer
    monkeypatch.setitem(sys.modules, "page", module)
    names = vars(module)
    if name in STAGES:
        STAGES[name](names)
    run_page(ROOT / name, names)
    if name in CHECKS:
        CHECKS[name](names, capsys.readouterr().out)


@pytest.mark.parametrize("name", pages())
def test_markers_stand_right_before_a_block(name):
    assert not dangling_markers(ROOT / name)


_LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")


def _anchors(page):
    # As GitHub makes them from the headings.
    headings = re.findall(r"^#+ (.+)$", prose_of(page), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).strip().replace(" ", "-") for heading in plain}


def dangling_links(page):
    """Returns the links to missing files or headings, except pages that the site generates."""
    dangling = []
    for link, anchor in _LINK.findall(prose_of(page)):
        target = page.parent / link if link else page
        if "generated/" in link or (target.exists() and not anchor):
            continue
        if target.suffix != ".md" or not target.exists() or anchor not in _anchors(target):
            dangling.append(f"{link}#{anchor}" if anchor else link)
    return dangling


@pytest.mark.parametrize("name", all_pages())
def test_links_lead_to_files_and_headings(name):
    assert not dangling_links(ROOT / name)


@pytest.mark.parametrize("name", all_pages())
def test_no_line_is_a_comment_by_mistake(name):
    # MyST leaves out lines that begin with a percent sign.
    assert not re.findall(r"^\s*%.*", prose_of(ROOT / name), re.MULTILINE)


def test_dangling_links_are_found(tmp_path):
    page, target = tmp_path / "page.md", tmp_path / "target.md"
    target.write_text("# A `name`, and [more](x.md)\n")
    page.write_text(
        "## Here\n[a](target.md#a-name-and-more) [b](#here) [c](target.md) [d](https://x.org#y)\n"
    )
    assert not dangling_links(page)
    page.write_text("[a](target.md#b) [b](#here) [c](missing.md) [d](missing.md#e)\n")
    assert dangling_links(page) == ["target.md#b", "#here", "missing.md", "missing.md#e"]


# Names of other packages, of the reader's own modules, and of topics and messages.
_OUTSIDE = ("torch.", "torch_geometric.", "torch_sparse.", "my_", "observation.", "tactile.")
_OUTSIDE += ("foxglove.",)
_DOTTED_CLASS = re.compile(r"`((?:[a-z_]\w*\.)+[A-Z]\w+)(?:\(|`)")


def _is_public(name):
    package, *parts = name.removeprefix("torch_geometric_tactile.").split(".")
    if find_spec(f"torch_geometric_tactile.{package}") is None:
        return False
    value = import_module(f"torch_geometric_tactile.{package}")
    for part in parts:
        value = getattr(value, part, None)
    return value is not None


@pytest.mark.parametrize("name", [n for n in all_pages() if not n.endswith("migration.md")])
def test_classes_named_in_the_text_are_public(name):
    pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    names = _DOTTED_CLASS.findall((ROOT / name).read_text(encoding="utf-8"))
    assert not [n for n in names if not n.startswith(_OUTSIDE) and not _is_public(n)]


def test_a_class_of_another_module_is_no_public_name():
    pytest.importorskip("jsonargparse", reason="needs the extra 'train'")
    text = "`papers.DeadRows`, `experiments.DeadRows` and `studies.Confusion(1)`"
    assert [_is_public(name) for name in _DOTTED_CLASS.findall(text)] == [True, False, False]


def test_blocks_of_a_page_are_found_with_their_markers(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# Page\n\n```python\nx = 1\n```\n\n<!-- not run: needs a port -->\n```sh\ntactile ports\n"
        "```\n\n`a.yaml`:\n\n```yaml\nb: 1\n```\n\n```\nno language\n```\n"
    )
    assert blocks_of(page) == [
        Block("python", "x = 1\n", 4, None, None),
        Block("sh", "tactile ports\n", 9, "needs a port", None),
        Block("yaml", "b: 1\n", 15, None, "a.yaml"),
    ]
    assert not dangling_markers(page)
    page.write_text("<!-- not run: needs a port -->\n\nA sentence.\n\n```sh\ntactile ports\n```\n")
    assert dangling_markers(page) == [1]


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("tactile predikt last.ckpt", "'tactile predikt' does not exist"),
        ("tactile inspect a.h5 --pictures", "is refused"),
        ("tactile convert bigs a.npz out --fields x=y", "is refused"),
        ("python benchmarks/no_such.py", "there is no benchmarks/no_such.py"),
        ("make demonstration", "the targets are"),
        ("pip install -e '.[sims]'", r"no extra \['sims'\]"),
        ("tactil fit", "'tactil' is no command"),
    ],
)
def test_a_block_that_is_not_run_names_what_exists(code, message):
    (words,) = commands(code)
    with pytest.raises(AssertionError, match=message):
        check_command(words)


def test_a_block_that_is_not_run_imports_what_exists():
    block = Block("python", "from torch_geometric_tactile.io import read_all\n", 1, "why", None)
    with pytest.raises(AssertionError, match="has no 'read_all'"):
        run_block("page.md", block, {})


def test_options_of_a_training_are_checked():
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    (words,) = commands("tactile fit --config my.yaml --trainer.max_epochs 3  # a comment")
    check_command(words)
    with pytest.raises(AssertionError, match="most_epochs 3' is refused"):
        check_command([*words[:-2], "--trainer.most_epochs", "3"])


@pytest.mark.filterwarnings("ignore")
def test_a_missing_value_is_named_as_the_page_of_bigs_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    _, log, *_ = [block for block in blocks_of(BIGS) if block.language == "python"]
    convert, *_ = [block for block in blocks_of(BIGS) if block.language == "sh"]
    exec(log.code, {})
    content = dict(np.load("log_2.npz"))
    np.savez("log_2.npz", **{**content, "pac": content["pac"][:-1]})
    (words,) = commands(convert.code)
    assert main(words[1:]) == 1
    out, error = capsys.readouterr()
    assert "2 of 3 grasps are in 'bigs'" in out
    page = BIGS.read_text(encoding="utf-8")
    said = re.search(r"`('pac' must have .*?\(10999, 3\)\))`", page, flags=re.DOTALL)
    assert " ".join(said[1].split()).replace("'pac' must", "must").split("(got")[0] in error
    assert "log_2.npz': 'pac' must have" in error
