"""What all readers of CSV files with a header share."""

import re
from dataclasses import astuple
from typing import NamedTuple

import numpy as np
import pytest

from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_csv, read_biotac_sp_dos_csv
from torch_geometric_tactile.io._named_csv import read_named_csv
from torch_geometric_tactile.io._wide_csv import read_wide_csv
from torch_geometric_tactile.io._xela_log_csv import read_xela_log_csv


class Kind(NamedTuple):
    read: object
    header: list
    rows: list
    more: bool = False  # whether columns of other names are left out


def electrodes(text, fingers=("ff", "mf", "th")):
    return [text.format(finger, i) for finger in fingers for i in range(1, 25)]


DIGITS = [[str(1 + i * j % 7) for j in range(100)] for i in range(2)]
XELA = ["Receive time", "Send time", "Message number", "1X", "1Y", "1Z"]
GRASP = ["object", "slipped", *electrodes("{}_biotac_{}")]
KINDS = {
    "wide": Kind(read_wide_csv, ["time", "taxel_0_x", "taxel_1_x"], [["0", "1", "2"], ["1"] * 3]),
    "named": Kind(read_named_csv, ["time", "a", "b"], [["0", "1", "2"], ["1"] * 3]),
    "XELA": Kind(read_xela_log_csv, XELA, [["0"] * 5 + ["1"], ["1"] * 5 + ["2"]], more=True),
    "grasps": Kind(
        read_biotac_sp_csv,
        GRASP,
        [["cup", "1", *DIGITS[0][:72]], ["box", "0", *DIGITS[1][:72]]],
        True,
    ),
    "slips": Kind(
        read_biotac_sp_dos_csv, electrodes("{}_e{}", ["ff"]), [row[:24] for row in DIGITS]
    ),
}


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


@pytest.fixture
def read(kind, write):
    """Reads lines of cells, or bytes, as a file."""

    def read(content, **style):
        path = write(*content if not isinstance(content, bytes) else (), **style)
        if isinstance(content, bytes):
            path.write_bytes(content)
        return kind.read(path)

    return read


def arrays(found):
    values = astuple(found) if hasattr(found, "tactile") else found
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in values]


@pytest.mark.parametrize(
    "style", [{"end": "\r\n"}, {"end": "\r"}, {"mark": "\ufeff"}, {"mark": "\ufeff\ufeff"}], ids=str
)
def test_every_style_reads_the_same(kind, read, style):
    lines = [kind.header, *kind.rows]
    assert arrays(read(lines, **style)) == arrays(read(lines))
    spaces = [[f" {cell} " for cell in line] for line in lines]
    assert arrays(read(spaces, **style)) == arrays(read(lines))


def test_columns_in_any_order(kind, read):
    order = np.random.default_rng(0).permutation(len(kind.header))
    lines = [kind.header, *kind.rows]
    shuffled = [[line[i] for i in order] for line in lines]
    if kind.read is read_named_csv:  # whose order of the taxels is that of the file
        shuffled = [[line[2], line[0], line[1]] for line in lines]
        lines = [[line[0], line[2], line[1]] for line in lines]
    assert arrays(read(shuffled)) == arrays(read(lines))
    if kind.more:
        with_note = [[*line, "note"] for line in shuffled]
        assert arrays(read(with_note)) == arrays(read(lines))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"' must hold at least one frame \(got an empty file\)"),
        (b"\xef\xbb\xbf", r"' must hold at least one frame \(got no line\)"),
        (b"\n\n", r"', line 1 must not be empty"),
        (b"\xff\xfe\x00\n", r"' cannot be read as CSV"),
        (b"\xe9,1\n", r"' cannot be read as CSV"),
        (b"a" * 200_000 + b"\n", r"' cannot be read as CSV: field larger"),
    ],
    ids=range(6),
)
def test_what_is_no_table(read, content, message):
    with pytest.raises(ValueError, match=r"hand\.csv" + message):
        read(content)


def changed(row, cell):
    return [*row[:-1], cell]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h, a, b: [h], r"' must hold at least one (frame|grasp) \(got a header only"),
        (lambda h, a, b: [h, a, "", b], r"', line 3 must not be empty: delete it, or write"),
        (lambda h, a, b: [h, a, "  ", b], r"', line 3 must not be empty"),
        (lambda h, a, b: [h, a, b, ""], r"', line 4 must not be empty"),
        (
            lambda h, a, b: [h, a, b[:-1]],
            r"', line 3 must have {n} cells \(got {less}\): is th",
        ),
        (lambda h, a, b: [h, a[:1], b], r"', line 2 must have {n} cells \(got 1\)"),
        (lambda h, a, b: [h, a, [*b, "1"]], r"', line 3 must have {n} cells \(got {more}\)"),
        (lambda h, a, b: [h, a, changed(b, "x")], r"{cell} must be a number \(got 'x'\)"),
        (lambda h, a, b: [h, a, changed(b, "1_0")], r"{cell} must be a number \(got '1_0'\)"),
        (lambda h, a, b: [h, a, changed(b, "\u0661")], r"{cell} must be a number"),
        (lambda h, a, b: [h, a, changed(b, "\x1c5")], r"{cell} must be a number"),
        (lambda h, a, b: [h, a, changed(b, "\x1b[31m")], r"{cell} .* \(got '\\x1b\[31m'\)"),
        (lambda h, a, b: [h, a, changed(b, "x" * 999)], r"{cell} .* \(got 'x{{60}}\.\.\.'\)"),
        (
            lambda h, a, b: [h, a, changed(b, "-inf")],
            r"{cell} must be finite.* \(got '-inf'\)",
        ),
        (
            lambda h, a, b: [h, a, changed(b, "1e39")],
            r"{cell} must be finite.* \(got '1e39'\)",
        ),
        (lambda h, a, b: [h, a, changed(b, "9" * 5000)], r"{cell} must be finite"),
        (
            lambda h, a, b: [h, changed(a, '"1'), changed(b, '2"')],
            r"' cannot be read as CSV|line",
        ),
        (
            lambda h, a, b: [h, a, changed(b, '"1')],
            r"' cannot be read as CSV: unexpected end",
        ),
        (
            lambda h, a, b: [[*r, r[-1]] for r in (h, a, b)],
            r"each column once \(got '.*' twice",
        ),
    ],
    ids=range(19),
)
def test_lines_and_cells_refused(kind, read, change, message):
    number, name = len(kind.header), kind.header[-1]
    cell = rf"', line 3, column {number}: '{re.escape(name)}'"
    wanted = message.format(n=number, less=number - 1, more=number + 1, cell=cell)
    with pytest.raises(ValueError, match=rf"hand\.csv.*{wanted}"):
        read(change(kind.header, *kind.rows))


def test_a_file_that_was_cut_has_whole_frames_or_is_refused(kind, read):
    lines = [",".join(line) + "\n" for line in (kind.header, *kind.rows)]
    whole = "".join(lines).encode()
    expected = arrays(read(whole))
    one = arrays(read("".join(lines[:2]).encode()))
    assert one != expected
    for size in range(len(whole)):
        if size == len(whole) - len(lines[2]):
            assert arrays(read(whole[:size])) == one
            continue
        with pytest.raises(ValueError, match=r"hand\.csv'"):
            read(whole[:size])
    with pytest.raises(ValueError, match="line 3 must end with a line break: is the file trunc"):
        read(whole[:-1])
