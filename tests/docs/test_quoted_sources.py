"""Shells such as zsh take ? and & of a source without quotes for their own."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNQUOTED = re.compile(r"(?:^|\s)((?:serial|file|sim|wss?):[^\s'\"`]*[?&][^\s'\"`]*)", re.MULTILINE)
TEXTS = [
    ROOT / "README.md",
    *ROOT.glob("docs/**/*.md"),
    *ROOT.glob("packaging/**/*.md"),
    *ROOT.glob("tutorials/**/*.py"),
    *ROOT.glob("tutorials/**/*.ipynb"),
    *ROOT.glob("torch_geometric_tactile/**/*.py"),
]


def test_sources_with_options_are_in_quotes():
    assert len(TEXTS) > 500
    unquoted = {
        str(path.relative_to(ROOT)): found
        for path in TEXTS
        if not {"generated", "build"} & {*path.parts}  # written by the docs
        and (found := UNQUOTED.findall(path.read_text(encoding="utf-8")))
    }
    assert unquoted == {}


def test_a_source_without_quotes_is_found():
    line = "tactile view serial:/dev/ttyACM0?protocol=anyskin --port 1"
    assert UNQUOTED.findall(line) == ["serial:/dev/ttyACM0?protocol=anyskin"]
    assert UNQUOTED.findall('tactile view "serial:/dev/ttyACM0?protocol=lines"') == []
